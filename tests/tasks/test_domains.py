"""The suite's domains that learned dynamics are measured on."""

from __future__ import annotations

from orbisim import suite
from orbisim.tasks.domains import SUBSTEPS, SUITE_DOMAINS, SUITE_TASKS


def test_each_is_a_task_of_the_suite() -> None:
    for name in SUITE_TASKS:
        domain, task = suite.split_name(name)
        assert SUITE_DOMAINS[domain] == task


def test_one_task_for_each_domain_and_parts_that_divide_its_control_step() -> None:
    assert len(SUITE_DOMAINS) == len(SUITE_TASKS)
    for domain, parts in SUBSTEPS.items():
        environment = suite.load(domain, SUITE_DOMAINS[domain])
        ratio = environment.control_timestep() / environment.physics.timestep() / parts
        assert abs(ratio - round(ratio)) < 1e-6
        assert round(ratio) >= 1
