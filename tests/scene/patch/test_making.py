"""A patch of the user's own MJCF: applied with `patch`, it gives the augmented model."""

from __future__ import annotations

import shutil
import subprocess
from pathlib import Path

import pytest

from orbisim.effects import EffectInstance, add_effects
from orbisim.scene import Scene, load_scene
from orbisim.scene.patch import Patch, patch_of
from orbisim.scene.patch.making import different

ARM = """<mujoco model="arm">
  <!-- degrees, and    spaces as I like them -->
  <compiler autolimits="true"/><option timestep="0.002"/>
  <default><default class="axle"><joint damping="0.1" axis="0 1 0"/></default></default>
  <include file="parts/bodies.xml"/>
  <actuator>
    <motor name="first" joint="shoulder" gear="2"   ctrlrange='-1 1' />  <!-- Maxon -->
    <position name="second" joint="elbow" kp="30"/>
  </actuator>
</mujoco>
"""
BODIES = """<mujocoinclude>
  <worldbody>
    <geom type="plane" size="1 1 .1" name="floor"/>
    <frame pos="0 0 1">
    <body name="upper"><joint name="shoulder" class="axle"
        range="-90 90"/><!-- > in a comment -->
      <geom type="capsule" fromto="0 0 0 0 0 -.3" size=".02"/>
      <body name="lower" pos="0 0 -.3" euler="0 10 0">
        <joint class="axle" name="elbow" damping=".25"/>
        <joint class="axle" type="slide" name="slide" range="0 .1"/>
\t<geom name="rod" type="capsule" fromto="0 0 0 0 0 -.2" size=".02"/>
      </body>
    </body>
    </frame>
  </worldbody>
</mujocoinclude>"""

EFFECTS = {
    "friction": EffectInstance("coulomb_friction", "elbow", {"torque": 0.12}),
    "damping of a class": EffectInstance("viscous_damping", "shoulder", {"coefficient": 0.2}),
    "angle": EffectInstance("joint_spring", "elbow", {"stiffness": 1.5, "rest_position": 0.3}),
    "length": EffectInstance("joint_spring", "slide", {"stiffness": 9.0, "rest_position": 0.02}),
    "shortcut": EffectInstance("actuator_lag", "second", {"time_constant": 0.03}),
    "motor": EffectInstance("torque_saturation", "first", {"limit": 0.7}),
    "inertial": EffectInstance(
        "payload", "lower", {"mass": 0.4, "com_x": 0.01, "com_y": 0.0, "com_z": -0.1}
    ),
    "new joint": EffectInstance("backlash", "elbow", {"width": 0.01}),
    "carried": EffectInstance(
        "joint_coupling", "elbow", {"coefficient": 0.3}, {"other": "shoulder"}
    ),
    "unnamed": EffectInstance("torque_bias", "first", {"offset": 0.05}),
    "contact": EffectInstance("sliding_friction", "rod", {"coefficient": 0.4}),
}


@pytest.fixture
def scene(tmp_path: Path) -> Scene:
    (tmp_path / "mine" / "parts").mkdir(parents=True)
    (tmp_path / "mine" / "arm.xml").write_text(ARM)
    (tmp_path / "mine" / "parts" / "bodies.xml").write_bytes(BODIES.encode())
    return load_scene(tmp_path / "mine" / "arm.xml")


def applied(patch: Patch, scene: Scene, folder: Path) -> Scene:
    """The scene after `patch` was run on a copy of its folder."""
    assert patch.folder is not None
    copied = folder / "copy"
    shutil.copytree(patch.folder, copied)
    run = ["patch", "-p1", "--fuzz=0"]
    done = subprocess.run(run, cwd=copied, input=patch.text, text=True, capture_output=True)
    assert done.returncode == 0, done.stdout + done.stderr
    return load_scene(copied / Path(scene.source).resolve().relative_to(patch.folder))


needs_patch = pytest.mark.skipif(shutil.which("patch") is None, reason="no program `patch`")


@needs_patch
@pytest.mark.parametrize("name", EFFECTS)
def test_patched_files_give_the_same_model(scene: Scene, tmp_path: Path, name: str) -> None:
    augmented = add_effects(scene, [EFFECTS[name]])
    patch = patch_of(scene, augmented)
    assert not patch.problem
    assert different(scene.model, augmented.model)
    again = applied(patch, scene, tmp_path)
    assert not different(again.model, augmented.model)
    assert again.model.names == augmented.model.names


@needs_patch
@pytest.mark.parametrize("seconds", [0.03, 0.0006])
def test_a_lag_is_patched_as_rk4_has_it(tmp_path: Path, seconds: float) -> None:
    folder = tmp_path / "mine"
    (folder / "parts").mkdir(parents=True)
    rk4 = ARM.replace('timestep="0.002"', 'timestep="0.002" integrator="RK4"')
    (folder / "arm.xml").write_text(rk4)
    (folder / "parts" / "bodies.xml").write_text(BODIES)
    scene = load_scene(folder / "arm.xml")
    lag = EffectInstance("actuator_lag", "second", {"time_constant": seconds})
    augmented = add_effects(scene, [lag])
    again = applied(patch_of(scene, augmented), scene, tmp_path)
    assert not different(again.model, augmented.model)
    assert again.model.actuator_actearly.tolist() == [False, seconds < 0.001]


@needs_patch
def test_all_together(scene: Scene, tmp_path: Path) -> None:
    augmented = add_effects(scene, [EFFECTS[n] for n in EFFECTS if n != "length"])
    again = applied(patch_of(scene, augmented), scene, tmp_path)
    assert not different(again.model, augmented.model)


def test_only_what_must_change_does(scene: Scene) -> None:
    friction = [EFFECTS["friction"], EFFECTS["motor"]]
    first, *lines = patch_of(scene, add_effects(scene, friction)).text.splitlines()
    assert first == "Apply in the folder of arm.xml: patch -p1 < THIS_FILE"
    changed = [line for line in lines if line[0] in "+-" and line[:3] not in ("+++", "---")]
    assert changed == [
        '-    <motor name="first" joint="shoulder" gear="2"   ctrlrange=\'-1 1\' />'
        "  <!-- Maxon -->",
        '+    <motor name="first" joint="shoulder" gear="2"   ctrlrange=\'-1 1\' '
        'forcelimited="true" forcerange="-0.7 0.7" />  <!-- Maxon -->',
        '-        <joint class="axle" name="elbow" damping=".25"/>',
        '+        <joint class="axle" name="elbow" damping=".25" frictionloss="0.12"/>',
    ]


def test_numbers_of_fits_are_short(scene: Scene) -> None:
    fitted = EffectInstance("coulomb_friction", "elbow", {"torque": 0.0800020980243468})
    assert 'frictionloss="0.08000209802"' in patch_of(scene, add_effects(scene, [fitted])).text


@needs_patch
@pytest.mark.parametrize("ending", ["\r\n", "no newline at the end"])
def test_line_ends_stay(tmp_path: Path, ending: str) -> None:
    text = ARM.replace('<include file="parts/bodies.xml"/>', BODIES[15:-17].strip())
    text = text.replace("\n", "\r\n") if ending == "\r\n" else text.rstrip()
    path = tmp_path / "mine" / "one.xml"
    path.parent.mkdir()
    path.write_bytes(text.encode())
    scene = load_scene(path)
    augmented = add_effects(scene, [EFFECTS["friction"], EFFECTS["carried"]])
    patch = patch_of(scene, augmented)
    assert ("\r\n+" in patch.text) == (ending == "\r\n")
    copied = tmp_path / "copy"
    shutil.copytree(path.parent, copied)
    run = ["patch", "-p1", "--binary"]
    subprocess.run(run, cwd=copied, input=patch.text.encode(), check=True, capture_output=True)
    assert not different(load_scene(copied / "one.xml").model, augmented.model)


def test_no_patch_says_why(scene: Scene, tmp_path: Path) -> None:
    assert patch_of(scene, scene).problem == "nothing differs"
    text = load_scene("<mujoco><worldbody><body name='b'><joint name='j'/><geom size='1'/></body>"
                      "</worldbody></mujoco>")  # fmt: skip
    friction = [EffectInstance("coulomb_friction", "j", {"torque": 0.1})]
    assert "is no MJCF file" in patch_of(text, add_effects(text, friction)).problem
    made = tmp_path / "made.xml"
    made.write_text(
        "<mujoco><worldbody><replicate count='2' offset='0 1 0'><body name='b'><joint name='j'/>"
        "<geom size='.1'/></body></replicate></worldbody></mujoco>"
    )
    scene = load_scene(made)
    name = scene.model.joint(1).name
    changed = add_effects(scene, [EffectInstance("coulomb_friction", name, {"torque": 0.1})])
    patch = patch_of(scene, changed)
    assert not patch.text
    assert "does not stand in the file" in patch.problem or "another" in patch.problem


def test_a_file_that_was_changed_meanwhile_is_not_patched_wrongly(scene: Scene) -> None:
    augmented = add_effects(scene, [EFFECTS["friction"]])
    path = Path(scene.source)
    path.write_text(path.read_text().replace('kp="30"', 'kp="40"'))
    assert patch_of(scene, augmented).problem == "the changed files give another actuator_biasprm"
