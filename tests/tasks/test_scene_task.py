"""Episodes of a scene from a file."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from orbisim import load_scene, make_backend
from orbisim.effects import EffectInstance, add_effects
from orbisim.effects.residual_network import Input, Network, with_rest
from orbisim.errors import InputError, SceneError, UnknownNameError
from orbisim.tasks.collect import collect
from orbisim.tasks.dataset import EpisodeFile
from orbisim.tasks.registry import make

ARM = Path(__file__).parents[2] / "mjcf_assets" / "arm2" / "scene.xml"
BALL = """<mujoco><worldbody><geom type="plane" size="3 3 1"/><body name="ball" pos="0 0 1">
<freejoint name="ball"/><geom size="0.1"/></body></worldbody></mujoco>"""
CARRIED = EffectInstance("joint_coupling", "elbow", {"coefficient": 0.4}, {"other": "shoulder"})
PLAY = EffectInstance("joint_flexibility", "elbow", {"stiffness": 60.0, "damping": 0.1})


@pytest.fixture
def augmented(tmp_path: Path) -> str:
    return str(add_effects(load_scene(ARM), [CARRIED, PLAY]).save(tmp_path / "augmented"))


def test_an_episode_is_what_the_backend_simulates(augmented: str) -> None:
    trials = make(augmented, steps=40).trials(2, seed=3, subtask="smooth")
    scene, step = trials.scene, 0.02
    engine = make_backend("mujoco", scene, nworld=2, nthread=1)
    controls = trials.controls(trials.horizon, step, 0)
    found = engine.rollout(trials.initial, controls, nstep=round(step / scene.model.opt.timestep))
    episode = make(augmented, steps=40).episode("smooth", 3)
    qpos = np.asarray(episode.arrays["qpos"])
    assert np.allclose(qpos[1:], found.qpos[0], rtol=0, atol=1e-9)
    assert np.abs(np.diff(qpos, axis=0)).max() > 1e-3


def test_joints_that_effects_have_added_start_at_rest(augmented: str) -> None:
    task = make(augmented, steps=2, spread=1.0)
    model = task.scene().model
    place = int(model.joint("elbow_flexibility").qposadr[0])
    starts = task.trials(5, seed=0).initial.qpos
    assert not starts[:, place].any() and np.ptp(starts[:, 0]) > 0.1


def test_what_nothing_drives_is_let_go(tmp_path: Path) -> None:
    (tmp_path / "ball.xml").write_text(BALL)
    task = make(str(tmp_path / "ball.xml"), steps=10)
    assert list(task.subtasks) == ["free"]
    speeds = task.trials(3, seed=1).initial.qvel
    assert (np.abs(speeds) > 0).all() and not np.allclose(speeds[0], speeds[1])


def test_a_collection_knows_another_scene_of_the_same_name(tmp_path: Path) -> None:
    path = tmp_path / "ball.xml"
    path.write_text(BALL)
    before = make(str(path)).identity
    path.write_text(BALL.replace('size="0.1"', 'size="0.2"'))
    assert make(str(path)).identity != before
    collect(str(path), tmp_path / "out.h5", episodes=2, workers=1, changes={"steps": 5})
    with EpisodeFile(tmp_path / "out.h5") as file:
        assert len(file) == 2


def test_what_cannot_be_collected_is_refused(tmp_path: Path) -> None:
    with pytest.raises(SceneError, match="no such file"):
        make(str(tmp_path / "nothing.xml"))
    (tmp_path / "still.xml").write_text("<mujoco><worldbody><geom size='1'/></worldbody></mujoco>")
    with pytest.raises(InputError, match="nothing in the scene moves"):
        make(str(tmp_path / "still.xml"))
    with pytest.raises(UnknownNameError):
        make(str(ARM)).scene("free")
    one = np.ones(1)
    network = Network(
        joint="elbow", inputs=(Input("velocity", "elbow"),), centre=0 * one, scale=one, low=-one,
        high=one, layers=((np.eye(1), 0 * one),),
    )  # fmt: skip
    path = with_rest(load_scene(ARM), [network]).save(tmp_path / "rest")
    with pytest.raises(InputError, match="learned residual force"):
        make(str(path))
