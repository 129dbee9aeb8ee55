"""Maps: what is in them, and what is wrong with them."""

from __future__ import annotations

from pathlib import Path

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from orbisim.errors import RecordingError
from orbisim.recording.mapping import Entry, SignalMap


def load(folder: Path, text: str | bytes) -> SignalMap:
    path = folder / "map.yaml"
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    return SignalMap.load(path)


def test_a_map(tmp_path: Path) -> None:
    found = load(
        tmp_path,
        """
        clock: a
        columns:
          "t [ms]": time
          a: {signal: qpos/yaw, unit: deg, sign: -1, offset: 12, scale: 0.5}
          "pose[3]": xquat/cube/w
          b: {signal: "qpos[0]", sign: "-"}
        """,
    )
    assert found.clock == "a"
    assert found.entries == (
        Entry("t [ms]", "time"),
        Entry("a", "qpos/yaw", "deg", -1, 12.0, 0.5),
        Entry("pose[3]", "xquat/cube/w"),
        Entry("b", "qpos[0]", None, -1),
    )


WRONG = {
    "": "is not a map; a map looks like this",
    "[1, 2]": "is not a map",
    "{": "is not YAML",
    "columns: {a: time": "is not YAML",
    "signals: {a: time}": "unknown key 'signals'; known: clock, columns",
    "clock: a": "has no columns",
    "columns: {}": "has no columns",
    "columns: {a: time, a: qpos/b}": "the key 'a' stands twice",
    "columns: {1: time}": "column '1': is no name",
    "columns: {a: 3}": "column 'a': must be the name of a signal",
    "columns: {a: {unit: deg}}": "must be the name of a signal, or have a 'signal'",
    "columns: {a: yaw}": "'yaw' is not the name of a signal; signals are time, qpos/<joint>",
    "columns: {a: {signal: qpos/b, units: deg}}": "unknown key 'units'; did you mean 'unit'",
    "columns: {a: {signal: qpos/b, unit: ticks}}": "unit 'ticks' is not known.*scale",
    "columns: {a: {signal: qpos/b, sign: 2}}": "sign must be 1 or -1; got '2'",
    "columns: {a: {signal: qpos/b, sign: true}}": "sign must be 1 or -1",
    "columns: {a: {signal: qpos/b, sign: [1]}}": "sign must be 1 or -1",
    "columns: {a: {signal: qpos/b, offset: x}}": "offset must be a finite number; got 'x'",
    "columns: {a: {signal: qpos/b, scale: .inf}}": "scale must be a finite number",
    "columns: {a: {signal: qpos/b, scale: 0}}": "scale must not be 0",
    "columns: {a: {signal: time, sign: -1}}": "time must not run backwards",
    "columns: {a: time}\nclock: 3": "'clock': must name a column",
    "a: !!python/object/apply:os.system [ls]": "is not YAML",
    "columns: {? [a] : time}": "is not YAML",
    "columns: {a: {signal: qpos/b, scale: 1" + "0" * 400 + "}}": "scale must be a finite number",
}


@pytest.mark.parametrize("text", WRONG)
def test_what_is_wrong_is_said_in_one_line(tmp_path: Path, text: str) -> None:
    with pytest.raises(RecordingError, match=WRONG[text]) as caught:
        load(tmp_path, text)
    assert str(caught.value).startswith(str(tmp_path / "map.yaml"))
    assert "\n" not in str(caught.value)


def test_files_that_are_no_maps(tmp_path: Path) -> None:
    with pytest.raises(RecordingError, match="no such file"):
        SignalMap.load(tmp_path / "none.yaml")
    with pytest.raises(RecordingError, match=r"has .* bytes; at most"):
        load(tmp_path, b"#" * (2**18 + 1))
    with pytest.raises(RecordingError, match="is not YAML"):
        load(tmp_path, "[" * 100_000)


@settings(deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(st.one_of(st.binary(max_size=80), st.text(max_size=80).map(str.encode)))
def test_junk_never_escapes(tmp_path: Path, text: bytes) -> None:
    try:
        load(tmp_path, text)
    except RecordingError as error:
        assert "\n" not in str(error)


values = st.recursive(
    st.one_of(st.none(), st.booleans(), st.integers(), st.floats(), st.text(max_size=8)),
    lambda inner: st.one_of(
        st.lists(inner, max_size=3), st.dictionaries(st.text(max_size=8), inner, max_size=3)
    ),
    max_leaves=6,
)


@settings(deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    st.dictionaries(
        st.text(max_size=6),
        st.one_of(
            values,
            st.fixed_dictionaries(
                {"signal": st.sampled_from(["qpos/a", "time", "x"])},
                optional=dict.fromkeys(("unit", "sign", "offset", "scale"), values),
            ),
        ),
        max_size=3,
    )
)
def test_any_plain_data_is_a_map_or_an_error(tmp_path: Path, columns: dict) -> None:
    import yaml

    try:
        found = load(tmp_path, yaml.safe_dump({"columns": columns}))
    except RecordingError as error:
        assert "\n" not in str(error)
    else:
        assert [entry.column for entry in found.entries] == sorted(columns)
