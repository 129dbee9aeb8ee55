"""Problems by name."""

from __future__ import annotations

from orbisim.errors import UnknownNameError
from orbisim_policies.problem import Problem
from orbisim_policies.push import PushProblem
from orbisim_policies.suite import SUITE, SuiteProblem


def available() -> tuple[str, ...]:
    """Names of the problems."""
    return ("task:push", *(f"suite:{name}" for name in SUITE))


def make_problem(name: str, steps: int | None = None) -> Problem:
    """A problem by name: `push`, `task:push`, `suite:cartpole-swingup`.

    Args:
      name: of the task. steps: of an episode; the problem's own if None.

    Raises:
      UnknownNameError: policies cannot be trained for it.
    """
    prefix, _, rest = name.rpartition(":")
    if rest in SUITE and prefix in ("suite", ""):
        return SuiteProblem(rest, steps)
    if rest == "push" and prefix in ("task", ""):
        return PushProblem() if steps is None else PushProblem(steps)
    raise UnknownNameError("task for policies", name, available())
