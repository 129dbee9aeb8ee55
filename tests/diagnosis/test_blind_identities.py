"""Effects that the blind trials accept by another name are simulated beside each other."""

from __future__ import annotations

import importlib
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import mjcf_assets
from orbisim import Recording, Scene, load_scene
from orbisim.effects import EffectInstance
from orbisim.testing import inject_effect

ROOT = Path(__file__).resolve().parents[2]
ASSETS = Path(mjcf_assets.__file__).parent
ONE_SLIDE = """
<mujoco model="slide">
  <option timestep="{step}" integrator="implicitfast"/>
  <worldbody>
    <body name="sled">
      <joint name="sled" type="slide" axis="{axis}"/>
      <geom type="box" size="0.1 0.1 0.1" mass="1.5" contype="0" conaffinity="0"/>
    </body>
  </worldbody>
  <actuator><motor name="pull" joint="sled" gear="2"/></actuator>
</mujoco>
"""
ONE_HINGE = """
<mujoco model="hinge">
  <option timestep="{step}" integrator="implicitfast"/>
  <worldbody>
    <body name="rod">
      <joint name="pin" axis="0 1 0"/>
      <geom type="capsule" fromto="0 0 0 0 0 -0.4" size="0.02" mass="0.5"/>
    </body>
  </worldbody>
  <actuator><motor name="turn" joint="pin"/></actuator>
</mujoco>
"""


@pytest.fixture(scope="module", autouse=True)
def _tools_on_path() -> Iterator[None]:
    sys.path.insert(0, str(ROOT / "tools"))
    yield
    sys.path.remove(str(ROOT / "tools"))


def tool(name: str) -> Any:
    return importlib.import_module(f"blind.{name}")


def effect(name: str, target: str, **values: float) -> EffectInstance:
    return EffectInstance(name, target, values)


def push(body: str, x: float, y: float, z: float) -> EffectInstance:
    return tool("identities").force_on(body, np.array([x, y, z]))


def tilt(scene: Scene, degrees: float) -> EffectInstance:
    """In the plane of x and z."""
    gravity = np.array(scene.model.opt.gravity)
    sine, cosine = np.sin(np.radians(degrees)), np.cos(np.radians(degrees))
    turned = np.array([[cosine, 0, sine], [0, 1, 0], [-sine, 0, cosine]]) @ gravity
    return tool("identities").tilt_to(turned, gravity)


def asset(name: str) -> Scene:
    return load_scene(ASSETS / name / "scene.xml", trusted=True)


def slide(axis: str = "1 0 0", step: float = 0.002) -> Scene:
    return load_scene(ONE_SLIDE.format(axis=axis, step=step), trusted=True)


def hinge(step: float = 0.002) -> Scene:
    return load_scene(ONE_HINGE.format(step=step), trusted=True)


def motion(
    scene: Scene, one: EffectInstance | None, starts: np.ndarray | None = None
) -> list[Recording]:
    """Without noise, under controls that do not look at the motion."""
    samples = 101
    time = np.arange(samples)[:, None] * 0.01
    phases = np.arange(scene.model.nu)
    controls = np.sin(2 * np.pi * 0.9 * time + phases) if scene.model.nu else None
    return inject_effect(
        scene, [] if one is None else one, controls=controls, starts=starts,
        duration=1.0, episodes=1, noise=0.0, seed=3,
    )  # fmt: skip


def positions(recordings: list[Recording]) -> np.ndarray:
    one = recordings[0]
    return np.concatenate(
        [one[n].reshape(len(one), -1) for n in sorted(one.signals) if n.startswith("qpos")], axis=1
    )


def apart(scene: Scene, one: EffectInstance, other: EffectInstance) -> float:
    """How far two effects lead apart, over how far the first leads from the scene without it."""
    base, first, second = (positions(motion(scene, e)) for e in (None, one, other))
    return float(np.abs(second - first).max() / np.abs(first - base).max())


# -- forces: the same to rounding ------------------------------------------------------------------


def load(body: str, mass: float, *com: float) -> EffectInstance:
    return effect("payload", body, mass=mass, com_x=com[0], com_y=com[1], com_z=com[2])


EXACT: dict[str, tuple[Callable[[], Scene], Callable[[Scene], EffectInstance]]] = {
    "lift": (
        lambda: asset("bouncing_ball"),
        lambda scene: effect("buoyancy", "ball", displaced_mass=0.02),
    ),
    "lift of a link": (lambda: asset("arm2"), lambda scene: push("forearm", 0, 0, 0.8)),
    "offset": (slide, lambda scene: push("sled", 0.7, 0, 0)),
    "offset, upright": (lambda: slide("0 0 1"), lambda scene: push("sled", 0, 0, 0.7)),
    "offset, aslant": (
        lambda: slide("1 0 1"),
        lambda scene: effect("torque_bias", "pull", offset=0.3),
    ),
    "mass": (lambda: asset("cart_pole"), lambda scene: load("cart", 0.4, 0.05, 0, 0.02)),
    "tilt of a ball": (lambda: asset("bouncing_ball"), lambda scene: tilt(scene, 4.0)),
    "tilt of a pendulum": (lambda: asset("servo_pendulum"), lambda scene: tilt(scene, 4.0)),
}


@pytest.mark.parametrize("case", EXACT)
def test_forces_by_another_name_move_the_scene_alike(case: str) -> None:
    scene = EXACT[case][0]()
    truth = EXACT[case][1](scene)
    others = tool("identities").identical(truth, scene.model)
    assert others
    for other in others:
        assert apart(scene, truth, other) < 1e-6, other
        back = tool("identities").identical(other, scene.model)
        assert any((one.effect, one.target) == (truth.effect, truth.target) for one in back)


def test_a_mass_on_an_upright_slide_is_not_armature() -> None:
    scene = slide("0 0 1")
    more = load("sled", 0.4, 0, 0, 0)
    assert not tool("identities").identical(more, scene.model)
    assert apart(scene, more, effect("armature", "sled", inertia=0.4)) > 0.1


def test_a_force_that_changes_the_size_of_gravity_is_no_tilt() -> None:
    scene = asset("bouncing_ball")
    others = tool("identities").identical(push("ball", 0.2, 0, 0), scene.model)
    assert "gravity_tilt" not in {one.effect for one in others}


# -- drag: the same equations, integrated differently ----------------------------------------------


@pytest.mark.parametrize(
    ("make", "name", "target"),
    [
        (slide, "linear_drag", "sled"),
        (slide, "quadratic_drag", "sled"),
        (hinge, "linear_drag", "rod"),
        (hinge, "quadratic_drag", "rod"),
        (hinge, "quadratic_damping", "pin"),
    ],
)
def test_drag_is_damping_of_the_only_joint_as_timesteps_shrink(
    make: Any, name: str, target: str
) -> None:
    found = []
    for step in (1e-3, 2.5e-4):
        scene = make(step=step)
        truth = effect(name, target, coefficient=1.2 if target != "pin" else 0.05)
        (other,) = tool("identities").identical(truth, scene.model)
        found.append(apart(scene, truth, other))
    assert found[0] < 0.02
    assert found[1] < 0.3 * found[0]  # nothing is left but the timestep's error


def test_drag_of_a_body_behind_two_joints_is_no_damping() -> None:
    drag = effect("quadratic_drag", "forearm", coefficient=1.0)
    assert not tool("identities").identical(drag, asset("arm2").model)


def test_drag_and_damping_of_another_power_are_not_the_same() -> None:
    drag, model = effect("linear_drag", "sled", coefficient=1.0), slide().model
    assert {one.effect for one in tool("identities").identical(drag, model)} == {"viscous_damping"}


# -- measurements ----------------------------------------------------------------------------------


def read_alike(
    scene: Scene, bias: EffectInstance, start: np.ndarray, other: EffectInstance, seen: np.ndarray
) -> bool:
    """Whether an encoder's offset from one start reads as another effect does from where it seems
    to start."""
    one, two = motion(scene, bias, start), motion(scene, other, seen)
    none = motion(scene, None, seen)
    moved = np.abs(positions(one) - positions(none)).max()
    return bool(np.abs(positions(one) - positions(two)).max() < 1e-9 * moved + 1e-12)


def test_an_encoder_offset_that_carries_the_arm_is_a_turn_of_gravity() -> None:
    scene, offset = asset("arm2"), 0.06
    bias = effect("sensor_bias", "shoulder", offset=offset)
    (turn,) = tool("identities").identical(bias, scene.model)
    assert turn.effect == "gravity_tilt"
    assert turn.values["angle"] == pytest.approx(np.degrees(offset))
    start = np.array([0.4, -0.3, 0.2, 0.1])
    seen = start + np.array([offset, 0, 0, 0])
    assert read_alike(scene, bias, start, turn, seen)
    (back,) = (
        e for e in tool("identities").identical(turn, scene.model) if e.effect == "sensor_bias"
    )
    assert back.values["offset"] == pytest.approx(offset)


def test_an_encoder_offset_at_an_upright_servo_is_one_of_its_motor() -> None:
    scene, offset = asset("arm6"), 0.03
    bias = effect("sensor_bias", "axis1", offset=offset)
    (push,) = tool("identities").identical(bias, scene.model)
    assert (push.effect, push.target) == ("torque_bias", "servo1")
    start = np.zeros(2 * scene.model.nv)
    start[:2] = 0.4, -0.3
    seen = start.copy()
    seen[0] += offset
    assert read_alike(scene, bias, start, push, seen)
    (back,) = tool("identities").identical(push, scene.model)
    assert back.values["offset"] == pytest.approx(offset)


@pytest.mark.parametrize(
    ("name", "joint"),
    [("arm2", "elbow"), ("cart_pole", "pole"), ("servo_pendulum", "servo"), ("arm6", "axis2")],
)
def test_other_encoder_offsets_are_nothing_else(name: str, joint: str) -> None:
    bias = effect("sensor_bias", joint, offset=0.05)
    assert not tool("identities").identical(bias, asset(name).model)


def test_one_joint_late_is_one_control_late() -> None:
    scene, delay = asset("servo_pendulum"), 0.04
    late = effect("actuator_delay", "servo", delay=delay)
    (other,) = tool("identities").identical(late, scene.model)
    assert (other.effect, other.target) == ("sensor_delay", "servo")
    start = np.array([0.3, 0.2])
    one = motion(scene, late, start)[0]
    rows = round(delay / 0.01)  # what the delay line held at first is over: the same from here on
    then = np.array([one["qpos/servo"][rows], one["qvel/servo"][rows]])
    two = motion(scene, other, then)[0]
    count = len(two) - 1
    first, second = one["qpos/servo"][rows : rows + count], two["qpos/servo"][:count]
    assert np.abs(first - second).max() < 1e-9
    assert not tool("identities").identical(
        effect("sensor_delay", "cart", delay=delay), asset("cart_pole").model
    )


# -- when a name is right --------------------------------------------------------------------------


def said(one: EffectInstance) -> dict[str, Any]:
    return one.to_json()


def test_an_identity_needs_the_right_numbers() -> None:
    matching, scene = tool("matching"), asset("bouncing_ball")
    truth = effect("buoyancy", "ball", displaced_mass=0.02)
    weight = 0.02 * 9.81
    assert matching.equivalent(said(push("ball", 0, 0, weight)), said(truth), scene.model)
    assert matching.equivalent(
        said(push("ball", 0.05 * weight, 0, weight)), said(truth), scene.model
    )
    assert not matching.equivalent(said(push("ball", 0, 0, 2 * weight)), said(truth), scene.model)
    assert not matching.equivalent(
        said(push("ball", 0.5 * weight, 0, weight)), said(truth), scene.model
    )


def test_what_cannot_be_felt_does_not_count() -> None:
    matching, scene = tool("matching"), asset("arm2")
    truth = effect("buoyancy", "forearm", displaced_mass=0.1)
    assert matching.equivalent(said(push("forearm", 0, 3.0, 0.981)), said(truth), scene.model)
