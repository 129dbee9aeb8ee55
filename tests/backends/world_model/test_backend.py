"""What the learned backend does beyond the conformance tests."""

from __future__ import annotations

import warnings
from pathlib import Path

import numpy as np
import pytest
import torch
from orbisim_world_model.backend import LearnedBackend, OutsideTrainingWarning
from orbisim_world_model.baseline import with_baseline
from orbisim_world_model.checkpoint import load_checkpoint
from orbisim_world_model.engine import SETTINGS
from orbisim_world_model.entities import Context
from orbisim_world_model.pack import Pack
from orbisim_world_model.run import Run, train
from orbisim_world_model.stepping import MEMORY

from orbisim import Physics, load_scene, make_backend
from orbisim.errors import InputError, UnsupportedSceneError
from orbisim.state import State
from orbisim.tasks.registry import make
from orbisim.testing import BackendConformance, scenes
from tests.backends.world_model.conftest import toy
from tests.backends.world_model.synthetic import BOX, PENDULUM, TABLE, simulate


@pytest.fixture(scope="module")
def table(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("table")
    train(simulate(TABLE, 6, 30, 4), toy("recurrent", "1x3x32"), Run(out=folder, steps=30))
    return folder


def _quiet(folder: Path, xml: str, **config: object) -> LearnedBackend:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", OutsideTrainingWarning)
        backend = make_backend(f"learned:{folder}", load_scene(xml), **config)
    assert isinstance(backend, LearnedBackend)
    return backend


def test_a_checkpoint_of_another_scene_is_refused(table: Path) -> None:
    with pytest.raises(UnsupportedSceneError, match="joints"):
        make_backend(f"learned:{table}", load_scene(PENDULUM))
    odd = TABLE.replace('timestep="0.005"', 'timestep="0.003"')
    with pytest.raises(UnsupportedSceneError, match=r"control step is 0\.02 s"):
        make_backend(f"learned:{table}", load_scene(odd))
    with pytest.raises(InputError, match="not a checkpoint"):
        make_backend("learned:/nowhere", load_scene(TABLE))


@pytest.mark.usefixtures("toy_zoo")
def test_the_zoo_says_what_it_has() -> None:
    with pytest.raises(UnsupportedSceneError, match="no checkpoint of the zoo fits it") as refused:
        make_backend("learned", load_scene(TABLE))
    assert "free_body:" not in str(refused.value)  # why those made for others do not fit
    backend = make_backend("learned", load_scene(scenes.CARTPOLE))
    assert backend.checkpoint.path.name == "cartpole"  # type: ignore[attr-defined]


def test_what_lies_outside_the_training_data_is_named(table: Path) -> None:
    heavy = TABLE.replace('mass="0.2"', 'mass="2"')
    with pytest.warns(OutsideTrainingWarning, match="mass of object 'one' is 2 "):
        make_backend(f"learned:{table}", load_scene(heavy), native=False)
    third = TABLE.replace(
        "</worldbody>",
        '<body name="three" pos="0.3 0.3 0.04"><freejoint/>'
        '<geom type="box" size="0.04 0.04 0.04" mass="0.2"/></body></worldbody>',
    )
    with pytest.warns(OutsideTrainingWarning, match=r"3 objects \(trained on 2 to 2\)"):
        backend = make_backend(f"learned:{table}", load_scene(third), native=False)
    assert backend.step(backend.reset(1)).finite.all()
    weak = TABLE.replace('kp="100"', 'kp="50"')
    with pytest.warns(OutsideTrainingWarning, match="the scene's gain differs"):
        make_backend(f"learned:{table}", load_scene(weak), native=False)
    backend = _quiet(table, TABLE, native=False)
    state = backend.reset(1)
    with pytest.warns(OutsideTrainingWarning, match="object speed is 99"):
        backend.step(state.replace(qvel=np.r_[0, 0, 99.0, np.zeros(11)][None]))


def test_the_papers_state_cannot_drive_a_simulator(tmp_path: Path) -> None:
    train(simulate(TABLE, 4, 12, 4), toy("paper", "1x2x8"), Run(out=tmp_path, steps=2))
    with pytest.raises(InputError, match="the paper's state"):
        make_backend(f"learned:{tmp_path}", load_scene(TABLE))


def test_damaged_checkpoints_are_refused(table: Path, tmp_path: Path) -> None:
    for name in ("manifest.json", "model.safetensors"):
        (tmp_path / name).write_bytes((table / name).read_bytes())
    assert load_checkpoint(tmp_path).manifest["parameters"] > 0
    weights = (tmp_path / "model.safetensors").read_bytes()
    (tmp_path / "model.safetensors").write_bytes(weights[: len(weights) // 2])
    with pytest.raises(InputError, match="damaged"):
        load_checkpoint(tmp_path)
    (tmp_path / "manifest.json").write_text("[]")
    with pytest.raises(InputError, match="manifest"):
        load_checkpoint(tmp_path)


def test_gradients_reach_state_control_and_descriptors(table: Path) -> None:
    backend = _quiet(table, TABLE)
    bare = backend.reset(2)
    given = {
        "qpos": torch.tensor(bare.qpos, requires_grad=True),
        "qvel": torch.tensor(bare.qvel + 0.1, requires_grad=True),
    }
    attributes = torch.zeros(2, 2, len(backend.engine.layout.attributes))
    attributes += torch.tensor(backend.engine._attributes)
    attributes.requires_grad_(True)
    control = torch.zeros(2, 2, requires_grad=True)
    state = State(bare.time, given["qpos"], given["qvel"], torch.zeros(2, 0))
    state = backend.with_descriptors(state, attributes=attributes)
    for _ in range(2):
        state = backend.step(state, control)
    (state.qpos.square().sum() + state.qvel.square().sum()).backward()
    for name, tensor in {**given, "control": control, "attributes": attributes}.items():
        assert tensor.grad is not None and tensor.grad.abs().sum() > 0, name
    with pytest.raises(InputError, match="expected"):
        backend.with_descriptors(bare, attributes=np.zeros((1, 2, 3)))


def test_descriptors_of_their_own_for_each_world(table: Path) -> None:
    backend = _quiet(table, TABLE)
    state = backend.reset(2)
    settings = np.repeat(backend.engine._settings.numpy(), 2, axis=0)
    same = backend.step(backend.with_descriptors(state, settings=settings))
    np.testing.assert_allclose(same.qpos, backend.step(state).qpos, atol=1e-6)
    settings[1, -5] += 1.0
    other = backend.step(backend.with_descriptors(state, settings=settings))
    np.testing.assert_allclose(other.qpos[0], same.qpos[0], atol=1e-6)
    assert np.abs(other.qvel[1] - same.qvel[1]).max() > 1e-7


def test_descriptors_are_made_once_for_so_many_worlds(table: Path) -> None:
    """The scene's: for steps and rollouts alike; those of a state anew."""
    engine = _quiet(table, TABLE).engine
    made: list[int] = []

    def described(context: Context) -> Context:
        made.append(len(context.attributes))
        return context

    engine.stepper.described = described  # type: ignore[method-assign]
    two, three, control = engine_state(2), engine_state(3), np.zeros((3, 4, 2))
    for _ in range(2):
        engine.run(two, control[:2], 2)
        assert engine.context(two) is engine.described(two)
    engine.run(three, control, 1)
    assert made == [2, 3]
    own = two.with_memory(**{SETTINGS: np.repeat(engine._settings.numpy(), 2, axis=0)})
    for _ in range(2):
        engine.run(own, control[:2], 2)
    assert made == [2, 3, 2, 2]  # once a call, not once a step


def engine_state(nworld: int) -> State:
    """At rest."""
    return make_backend("mujoco", load_scene(TABLE)).reset(nworld)


def test_memory_is_burnt_in_from_the_past(table: Path) -> None:
    backend = _quiet(table, TABLE)
    classical = make_backend("mujoco", load_scene(TABLE))
    past = classical.rollout(classical.reset(2), np.full((5, 2), 0.2), nstep=4)
    state = backend.burn_in(past)
    np.testing.assert_array_equal(state.qpos, past.final.qpos)
    fresh = backend.engine.stepper.initial_memory(2).numpy()
    assert np.abs(state.memory[MEMORY] - fresh).max() > 1e-3
    assert np.abs(backend.step(state).qvel - backend.step(past.final).qvel).max() > 1e-8


def test_switching_in_the_middle_of_an_episode(table: Path) -> None:
    physics = Physics.from_xml_string(TABLE)
    physics.step(8)
    physics.use_backend(_quiet(table, TABLE))
    time = physics.data.time
    physics.step(4)
    assert physics.data.time == pytest.approx(time + 0.02)
    with pytest.raises(InputError, match="not a multiple"):
        physics.step(3)
    saved = physics.snapshot()
    physics.step(4)
    after = physics.get_state()
    physics.restore(saved)
    physics.step(4)
    np.testing.assert_array_equal(physics.get_state(), after)


def test_unknown_devices() -> None:
    with pytest.raises(InputError, match="device"):
        LearnedBackend(device="cuda:7")
    with pytest.raises(InputError, match="device"):
        LearnedBackend(device="toaster")


# -- hybrid ------------------------------------------------------------------------------------

DAMPED = PENDULUM.replace('damping="0.05"', 'damping="0.4"')


@pytest.fixture(scope="module")
def corrected(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A correction of the pendulum as declared towards one with eight times the damping."""
    folder = tmp_path_factory.mktemp("hybrid")
    (folder / "declared.xml").write_text(PENDULUM)
    pack = with_baseline(simulate(DAMPED, 20, 40, 2), str(folder / "declared.xml"))
    config = toy("hybrid", "1x1x256", train__rate="3e-3")
    train(pack, config, Run(out=folder, steps=200, horizons=(1,), burn=0))
    return folder


def test_a_correction_closes_the_gap(corrected: Path) -> None:
    truth = make_backend("mujoco", load_scene(DAMPED))
    declared = make_backend("mujoco", load_scene(PENDULUM))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", OutsideTrainingWarning)
        hybrid = make_backend(f"hybrid:{corrected}", load_scene(PENDULUM))
        start = State(
            np.zeros(4), np.linspace(-1, 1, 4)[:, None], np.zeros((4, 1)), np.zeros((4, 0))
        )
        controls = np.full((25, 1), 0.3)
        expected = truth.rollout(start, controls, nstep=2).qpos
        before = np.abs(declared.rollout(start, controls, nstep=2).qpos - expected).mean()
        after = np.abs(hybrid.rollout(start, controls).qpos - expected).mean()
    assert after < 0.3 * before


@pytest.mark.filterwarnings("ignore::orbisim_world_model.backend.OutsideTrainingWarning")
def test_threads_may_share_a_corrected_engine(corrected: Path) -> None:
    suite = BackendConformance()
    suite.tolerance = 2e-5  # float32
    suite.test_threads_may_share_one_object(
        [make_backend(f"hybrid:{corrected}", load_scene(PENDULUM))]
    )


def test_each_backend_refuses_the_others_checkpoint(corrected: Path, table: Path) -> None:
    with pytest.raises(InputError, match="backend 'hybrid'"):
        make_backend(f"learned:{corrected}", load_scene(PENDULUM))
    with pytest.raises(InputError, match="backend 'learned'"):
        make_backend(f"hybrid:{table}", load_scene(TABLE))


def test_a_box_at_rest_needs_no_robot(tmp_path: Path) -> None:
    pack: Pack = simulate(BOX, 4, 20, 2)
    train(pack, toy(), Run(out=tmp_path, steps=10))
    backend = _quiet(tmp_path, BOX)
    trajectory = backend.rollout(backend.reset(2), np.zeros((5, 0)))
    assert trajectory.qpos.shape == (2, 5, 7)


@pytest.mark.slow
@pytest.mark.skipif(not torch.cuda.is_available(), reason="no GPU")
def test_on_a_gpu_scenes_may_follow_each_other_in_a_process() -> None:
    """Processes that did so with `push` ended in an illegal memory access (see `spread_kernel`)."""
    scenes_follow_each_other("cuda")


def scenes_follow_each_other(device: str) -> None:
    """A backend for each scene, as predictions of episodes make them; the CPU is the reference."""
    for seed in range(6):
        scene = make("push").scene("to_hit", seed)
        backend, reference = (
            make_backend("learned", scene, device=name, native=False) for name in (device, "cpu")
        )
        state = reference.reset(1)
        controls = np.tile(scene.model.key_ctrl[0], (1, 40, 1))
        found = backend.rollout(state, controls, sensors=False)
        wanted = reference.rollout(state, controls, sensors=False)
        np.testing.assert_allclose(found.qpos, wanted.qpos, atol=backend.perturbation)
