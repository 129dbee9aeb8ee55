"""Every registered backend passes the conformance tests."""

from __future__ import annotations

from importlib.util import find_spec

import pytest

from orbisim.testing import BackendConformance


class TestMujoco(BackendConformance):
    backend = "mujoco"


@pytest.mark.skipif(not find_spec("mujoco_warp"), reason="MuJoCo-Warp is not installed")
class TestWarp(BackendConformance):
    backend = "warp"
    tolerance = 2e-5  # float32
    law_tolerance = 5e-3
