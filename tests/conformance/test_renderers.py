"""Every registered renderer passes the conformance tests."""

from orbisim.testing import RendererConformance


class TestMujoco(RendererConformance):
    renderer = "mujoco"


class TestNull(RendererConformance):
    renderer = "null"
    faithful = False
