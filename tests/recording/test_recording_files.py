"""Recordings written and read back, and files that are no recordings."""

from __future__ import annotations

import json
import logging
import pickle
import subprocess
import sys

import numpy as np
import pyarrow
import pyarrow.parquet
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from orbisim import Recording
from orbisim.errors import RecordingError
from orbisim.recording.files import opened

from ..clock import Stopwatch
from .test_names import signals as named_widths

FORMATS = (".npz", ".csv", ".parquet")
numbers = st.floats(allow_infinity=False, width=64)
quick = settings(
    deadline=None, max_examples=40, suppress_health_check=[HealthCheck.function_scoped_fixture]
)


@st.composite
def recordings(draw):
    count = draw(st.integers(1, 6))
    gaps = draw(hnp.arrays(np.float64, count, elements=st.floats(1e-6, 1e3)))
    time_ = np.unique(draw(st.floats(-1e3, 1e3)) + np.cumsum(gaps))
    found = {}
    for name, width in draw(st.lists(named_widths, unique_by=lambda s: s[0], max_size=5)):
        if ".npy" in name:
            continue
        shape = (len(time_),) if width is None else (len(time_), width)
        found[name] = draw(hnp.arrays(np.float64, shape, elements=numbers))
    return Recording(time_, found)


@pytest.mark.parametrize("suffix", FORMATS)
@quick
@given(recording=recordings())
def test_round_trip(tmp_path, suffix, recording):
    path = tmp_path / f"a{suffix}"
    recording.save(path)
    again = Recording.load(path)
    assert again == recording
    assert again.source == str(path)
    assert again.notes == ()


@pytest.mark.parametrize("suffix", (".npz", ".parquet"))
def test_units_and_metadata_are_kept(tmp_path, suffix):
    recording = Recording(
        [0, 1], {"qpos/a": [1, 2]}, units={"qpos/a": "rad"}, metadata={"lab": "ö", "run": [1, None]}
    )
    recording.save(tmp_path / f"a{suffix}")
    again = Recording.load(tmp_path / f"a{suffix}")
    assert dict(again.units) == {"qpos/a": "rad"}
    assert dict(again.metadata) == {"lab": "ö", "run": [1, None]}


def test_metadata_that_are_no_json(tmp_path):
    with pytest.raises(RecordingError, match="metadata cannot be saved"):
        Recording([0.0], {}, metadata={"x": object()}).save(tmp_path / "a.npz")


def test_unknown_keys_are_ignored_with_a_note(tmp_path, caplog):
    path = tmp_path / "a.npz"
    np.savez(
        path, time=[0.0, 1.0], tau=[1, 2], xpos=np.zeros((2, 3)), header="x", **{"qpos/a": [1, 2]}
    )
    with caplog.at_level(logging.WARNING, "orbisim"):
        recording = Recording.load(path)
    assert set(recording.signals) == {"qpos/a"}
    assert len(recording.notes) == 3
    assert "ignored 'tau': not the name of a signal" in recording.notes
    assert "ignored 'xpos': a signal is named xpos/<body>" in recording.notes
    assert "ignored 'tau'" in caplog.text


def test_whole_arrays_of_one_column_may_be_vectors(tmp_path):
    np.savez(tmp_path / "a.npz", time=[0.0, 1.0], ctrl=[1, 2], qpos=np.ones((2, 1), np.float32))
    recording = Recording.load(tmp_path / "a.npz")
    assert recording["ctrl"].shape == (2, 1)
    assert recording["qpos"].dtype == np.float64


def test_csv_as_people_write_it(tmp_path):
    path = tmp_path / "a.csv"
    path.write_bytes(
        b'\xef\xbb\xbftime,"qpos/left, ""big""",xpos/a/x,xpos/a/y,xpos/a/z,comment\r\n'
        b"0,1e-3,1,2,3,hello\r\n0.5,,NaN,nan,4,\r\n"
    )
    recording = Recording.load(path)
    np.testing.assert_array_equal(recording['qpos/left, "big"'], [1e-3, np.nan])
    np.testing.assert_array_equal(recording["xpos/a"], [[1, 2, 3], [np.nan, np.nan, 4]])
    assert recording.notes == ("ignored 'comment': not the name of a signal",)


def test_csv_of_a_scene_with_one_joint(tmp_path):
    (tmp_path / "a.csv").write_text("time,qpos,ctrl\n0,1,2\n1,3,4\n")
    recording = Recording.load(tmp_path / "a.csv")
    np.testing.assert_array_equal(recording["qpos"], [[1], [3]])
    np.testing.assert_array_equal(recording["ctrl"], [[2], [4]])


def test_parquet_of_other_types(tmp_path):
    table = pyarrow.table(
        {"time": pyarrow.array([0, 1], pyarrow.int32()), "qpos/a": pyarrow.array([None, 1.5])}
    )
    pyarrow.parquet.write_table(table, tmp_path / "a.parquet")
    np.testing.assert_array_equal(Recording.load(tmp_path / "a.parquet")["qpos/a"], [np.nan, 1.5])


def npz(**arrays):
    return lambda path: np.savez(path, **arrays)


def text(content):
    return lambda path: path.write_bytes(content)


def parquet(columns):
    return lambda path: pyarrow.parquet.write_table(pyarrow.table(columns), path)


T = [0.0, 1.0, 2.0]
BAD = {
    "empty.npz": (text(b""), "the file is empty"),
    "text.npz": (text(b"time,qpos/a\n0,1\n"), "is not an .npz file"),
    "cut.npz": (text(b"PK\x03\x04" + bytes(30)), "is not an .npz file"),
    "no_time.npz": (npz(qpos=np.zeros((3, 1))), "has no 'time'"),
    "none.npz": (npz(time=[]), "'time': has no samples"),
    "matrix.npz": (npz(time=np.zeros((3, 2))), r"must be a vector \[T\]; got shape \(3, 2\)"),
    "back.npz": (npz(time=[0, 1, 0.5, 2]), "row 2 is 0.5 after 1.0"),
    "twice.npz": (npz(time=[0, 1, 1]), "row 2 is 1.0 after 1.0"),
    "nan.npz": (npz(time=[0, np.nan]), "row 1 is nan"),
    "short.npz": (
        npz(time=T, **{"qpos/a": [1, 2]}),
        r"'qpos/a': needs a row for each of the 3 times; got shape \(2,\)",
    ),
    "scalar.npz": (npz(time=T, **{"qpos/a": 3.0}), r"got shape \(\)"),
    "cube.npz": (npz(time=T, **{"qpos/a": np.zeros((3, 1, 1))}), r"got shape \(3, 1, 1\)"),
    "inf.npz": (npz(time=T, **{"qpos/a": [1, np.inf, 2]}), "row 1 is infinite"),
    "words.npz": (npz(time=T, **{"qpos/a": ["a", "b", "c"]}), "must hold numbers"),
    "complex.npz": (npz(time=T, **{"qpos/a": [1j, 2, 3]}), "must hold numbers; got complex128"),
    "headless.csv": (text(b"0,1\n1,2\n"), "has no 'time'"),
    "word.csv": (text(b"time,qpos/a\n0,1\n1,two\n"), "column 'qpos/a'.*'two'"),
    "ragged.csv": (text(b"time,qpos/a\n0,1\n1\n"), "Expected 2 columns, got 1"),
    "binary.csv": (text(bytes(range(256))), "is not a table"),
    "no_rows.csv": (text(b"time,qpos/a\n"), "has no samples"),
    "twice.csv": (text(b"time,qpos/a,qpos/a\n0,1,2\n"), "'qpos/a': stands in two columns"),
    "vector.csv": (text(b"time,xquat/a/w\n0,1\n"), "needs the columns xquat/a/w, xquat/a/x"),
    "back.csv": (text(b"time\n0\n2\n1\n"), "row 2 is 1.0 after 2.0"),
    "text.parquet": (text(b"hello"), "is not a .parquet file"),
    "stamps.parquet": (
        parquet({"time": pyarrow.array([0, None], pyarrow.timestamp("ms"))}),
        "'time': has rows without a time",
    ),
    "lists.parquet": (
        parquet({"time": [0.0, 1.0], "qpos/a": [[1.0], [2.0, 3.0]]}),
        "'qpos/a': must hold lists of equal length",
    ),
    "words.parquet": (parquet({"time": [0.0], "qpos/a": ["a"]}), "must hold numbers; got string"),
}  # fmt: skip


@pytest.mark.parametrize("name", BAD)
def test_what_is_wrong_is_said_in_one_line(tmp_path, name):
    make, problem = BAD[name]
    path = tmp_path / name
    make(path)
    with pytest.raises(RecordingError, match=problem) as caught:
        Recording.load(path)
    assert str(caught.value).startswith(str(path))
    assert "\n" not in str(caught.value)
    assert caught.value.exit_status == 2


def test_missing_files_and_other_suffixes(tmp_path):
    with pytest.raises(RecordingError, match="no such file"):
        Recording.load(tmp_path / "a.npz")
    with pytest.raises(RecordingError, match="is not a file"):
        (tmp_path / "folder.npz").mkdir()
        Recording.load(tmp_path / "folder.npz")
    with pytest.raises(RecordingError, match=r"suffixes .*\.csv.*got '\.mat'"):
        Recording.load(tmp_path / "a.mat")
    with pytest.raises(RecordingError, match="suffixes"):
        Recording([0.0], {}).save(tmp_path / "a.pkl")
    with pytest.raises(RecordingError, match="cannot be written"):
        Recording([0.0], {}).save(tmp_path / "nowhere" / "a.npz")


class Bomb:
    def __reduce__(self):
        return (exec, ("raise SystemExit('executed')",))


def test_pickles_are_not_executed(tmp_path):
    path = tmp_path / "a.npz"
    np.savez(path, time=[0.0], **{"qpos/a": np.array([Bomb()], object)})
    with pytest.raises(RecordingError, match=r"'qpos/a' cannot be read.*Python objects"):
        Recording.load(path)
    path.write_bytes(pickle.dumps(Bomb()))
    with pytest.raises(RecordingError, match=r"not an \.npz"):
        Recording.load(path)


def test_a_huge_array_in_a_small_file_is_refused(tmp_path):
    import zipfile

    header = b"{'descr': '<f8', 'fortran_order': False, 'shape': (1000000000000000,), }"
    header += b" " * (117 - len(header)) + b"\n"
    npy = b"\x93NUMPY\x01\x00" + len(header).to_bytes(2, "little") + header + bytes(64)
    with zipfile.ZipFile(tmp_path / "a.npz", "w") as archive:
        archive.writestr("time.npy", npy)
    with pytest.raises(RecordingError, match="'time' cannot be read"):
        Recording.load(tmp_path / "a.npz")


@quick
@given(junk=st.binary(max_size=200), suffix=st.sampled_from(FORMATS))
def test_junk_never_escapes(tmp_path, junk, suffix):
    path = tmp_path / f"junk{suffix}"
    path.write_bytes(junk)
    try:
        assert len(Recording.load(path)) >= 1
    except RecordingError as error:
        assert "\n" not in str(error)


@quick
@given(data=st.data(), suffix=st.sampled_from(FORMATS))
def test_damaged_files_never_escape(tmp_path, data, suffix):
    path = tmp_path / f"a{suffix}"
    Recording(np.arange(20.0), {"qpos/a": np.sin(np.arange(20.0))}).save(path)
    content = bytearray(path.read_bytes())
    for _ in range(data.draw(st.integers(1, 4))):
        content[data.draw(st.integers(0, len(content) - 1))] = data.draw(st.integers(0, 255))
    path.write_bytes(content)
    try:
        assert len(Recording.load(path)) >= 1
    except RecordingError as error:
        assert "\n" not in str(error)


@pytest.mark.parametrize("suffix", FORMATS)
def test_a_million_rows(tmp_path, suffix):
    rng = np.random.default_rng(0)
    recording = Recording(
        np.arange(1e6) * 1e-3,
        {"qpos/a": rng.standard_normal(1_000_000), "xpos/b": rng.standard_normal((1_000_000, 3))},
    )
    watch = Stopwatch()
    recording.save(tmp_path / f"a{suffix}")
    assert Recording.load(tmp_path / f"a{suffix}") == recording
    assert watch.seconds < 30


def test_header_is_plain_json(tmp_path):
    Recording([0.0], {}).save(tmp_path / "a.npz")
    with np.load(tmp_path / "a.npz", allow_pickle=False) as file:
        assert json.loads(str(file["header"]))["schema"] == "orbisim.recording/1"


def test_ten_million_rows_take_little_more_memory_than_their_numbers(tmp_path):
    path, rows = tmp_path / "long.npz", 10_000_000
    time_ = 1e-3 * np.arange(rows)
    np.savez(path, time=time_, **{"qpos/a": np.sin(time_), "ctrl/a": np.cos(time_)})
    script = (
        "import resource, sys, numpy\n"
        "from orbisim import Recording\n"
        "peak = lambda: resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024\n"
        "before = peak()\n"
        "recording = Recording.load(sys.argv[1])\n"
        "print(len(recording), peak() - before)\n"
    )
    done = subprocess.run(
        [sys.executable, "-c", script, str(path)], capture_output=True, text=True, check=True
    )
    count, taken = map(int, done.stdout.split())
    path.unlink()
    assert count == rows
    assert taken < 2 * (3 * 8 * rows)


@pytest.mark.parametrize(
    ("header", "message"),
    [
        ('{"schema": "orbisim.recording/1", "units": {"qpos/a": 1}}', "units must be text"),
        ('{"schema": "orbisim.recording/1", "units": ' + "[" * 100_000, "header cannot be read"),
    ],
)
def test_headers_that_are_none(tmp_path, header, message):
    np.savez(tmp_path / "a.npz", time=[0.0], **{"qpos/a": [0.0], "header": np.array(header)})
    with pytest.raises(RecordingError, match=message):
        Recording.load(tmp_path / "a.npz")


def test_a_table_with_very_many_columns_is_read_in_time(tmp_path):
    names = [f"qpos/j{i}" for i in range(100_000)]
    (tmp_path / "a.csv").write_text(",".join([*names, names[0]]) + "\n")
    watch = Stopwatch()
    with pytest.raises(RecordingError, match="stands in two columns"):
        Recording.load(tmp_path / "a.csv")
    assert watch.seconds < 20.0  # it was minutes


def test_a_column_that_stands_twice_is_named_wherever_it_is_read(tmp_path):
    (tmp_path / "a.csv").write_text("time,t,t\n0,1,2\n1,2,3\n")
    log = opened(tmp_path / "a.csv")
    with pytest.raises(RecordingError, match="'t' stands in two columns"):
        log.read(["time", "t"])


def test_a_table_of_zeros_without_end_is_refused(tmp_path):
    """A few kilobytes that stand for gigabytes of numbers."""
    rows = 40_000_000
    zeros = pyarrow.array(np.zeros(rows, np.int8)).dictionary_encode().cast(pyarrow.int8())
    table = pyarrow.table({"time": zeros, "qpos/a": zeros, "qpos/b": zeros, "qpos/c": zeros})
    pyarrow.parquet.write_table(table, tmp_path / "a.parquet", compression="gzip")
    assert (tmp_path / "a.parquet").stat().st_size < 2**20
    with pytest.raises(RecordingError, match="out of proportion"):
        Recording.load(tmp_path / "a.parquet")


def test_a_component_that_is_no_number_is_named(tmp_path):
    columns = {"time": [0.0, 1.0], "qpos[0]": [1.0, 2.0], "qpos[1]": np.zeros(2, "M8[ns]")}
    pyarrow.parquet.write_table(pyarrow.table(columns), tmp_path / "a.parquet")
    with pytest.raises(RecordingError, match=r"'qpos\[1\]': must hold numbers; got datetime"):
        Recording.load(tmp_path / "a.parquet")
