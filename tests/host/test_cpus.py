"""Processors that this process may use, not those that the machine has."""

from __future__ import annotations

import os

import mujoco
import pytest

from orbisim.host.cpus import threads_for, usable_cpus


@pytest.mark.skipif(not hasattr(os, "sched_setaffinity"), reason="no affinity on this system")
def test_only_processors_that_this_process_may_use_count() -> None:
    before = os.sched_getaffinity(0)
    assert usable_cpus() == len(before)
    os.sched_setaffinity(0, {min(before)})
    try:
        assert usable_cpus() == 1
    finally:
        os.sched_setaffinity(0, before)


def test_where_affinity_is_not_known(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delattr(os, "sched_getaffinity", raising=False)
    monkeypatch.setattr(os, "cpu_count", lambda: 7)
    assert usable_cpus() == 7
    monkeypatch.setattr(os, "cpu_count", lambda: None)
    assert usable_cpus() == 1


def test_threads_by_what_they_do_until_they_wait(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delattr(os, "sched_getaffinity", raising=False)
    monkeypatch.setattr(os, "cpu_count", lambda: 8)
    joint = "<body><joint/><geom size='.1'/></body>"
    model = mujoco.MjModel.from_xml_string(f"<mujoco><worldbody>{joint}</worldbody></mujoco>")
    assert threads_for(model, worlds=24, steps=1) == 1
    assert threads_for(model, worlds=24, steps=200) == 8
    assert threads_for(model, worlds=3, steps=2000) == 3  # no more than worlds
    alone = threads_for(model, worlds=60, steps=1)
    model.opt.integrator = mujoco.mjtIntegrator.mjINT_RK4
    assert threads_for(model, worlds=60, steps=1) > alone  # evaluates the dynamics more often
