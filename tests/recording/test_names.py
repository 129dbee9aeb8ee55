"""Names of signals and their columns."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from orbisim.recording import names

targets = st.text(st.characters(exclude_categories=("Cs", "Cc")), min_size=1, max_size=12)
signals = st.one_of(
    st.sampled_from(names.WHOLE).map(lambda name: (name, 3)),
    st.tuples(st.sampled_from(("xpos",)), targets).map(lambda p: ("/".join(p), 3)),
    st.tuples(st.sampled_from(("xquat",)), targets).map(lambda p: ("/".join(p), 4)),
    st.tuples(
        st.tuples(st.sampled_from(("qpos", "qvel", "ctrl", "torque", "sensor")), targets).map(
            "/".join
        ),
        st.sampled_from((None, 3, 4, 7)),
    ),
)


@given(st.lists(signals, unique_by=lambda s: s[0], max_size=8))
def test_columns_gather_into_the_signals_they_came_from(some):
    table = {name: names.columns(name, width) for name, width in some}
    headers = [column for columns in table.values() for column in columns]
    assert len(set(headers)) == len(headers)
    assert names.gather(["time", "other", *headers]) == table


@pytest.mark.parametrize(
    ("headers", "problem"),
    [
        (["xpos/a/x", "xpos/a/z"], "needs the columns xpos/a/x, xpos/a/y, xpos/a/z"),
        (["qpos[0]", "qpos[2]"], "needs the columns"),
        (["xpos/a"], "is a vector"),
        (["qpos/a", "qpos/a[0]"], "same component"),
    ],
)
def test_incomplete_vectors_are_errors(headers, problem):
    with pytest.raises(ValueError, match=problem.replace("[", r"\[")):
        names.gather(headers)


@pytest.mark.parametrize("name", ["qpos", "qpos/a", "xquat/a/b", "sensor/ö [2]"])
def test_signal_names(name):
    assert names.is_signal(name)


@pytest.mark.parametrize("name", ["xpos", "torque", "sensor", "qpos/", "qacc/a", "time", "", "/a"])
def test_other_names(name):
    assert not names.is_signal(name)
