from __future__ import annotations

import pytest
from orbisim_policies.problems import available, make_problem

from orbisim.errors import UnknownNameError


def test_problems_have_short_and_long_names() -> None:
    assert make_problem("push", 5).steps == 5
    assert make_problem("task:push").name == "task:push"
    assert make_problem("pendulum-swingup").steps == 1000
    assert all(make_problem(name, 2).name == name for name in available())


def test_others_are_refused_by_name() -> None:
    for name in ("task:toss", "suite:push", "task:cartpole-swingup"):
        with pytest.raises(UnknownNameError, match="task for policies"):
            make_problem(name)
