"""What PhyInf says of recordings, and of which scenes it says nothing."""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from orbisim_diffusion.checkpoint import PHYSICS, add_part
from orbisim_diffusion.estimate_physics import (
    Reach,
    guesses,
    has_physics,
    infer_physics,
    load_physics,
    windows_of,
)
from orbisim_diffusion.physics import FRAMES, PhysicsInference, Posterior, Window

from orbisim import Recording, load_scene
from orbisim.errors import InputError, RecordingError, UnsupportedSceneError
from orbisim.scene import Scene
from orbisim.tasks.registry import make
from tests.backends.diffusion.tiny import arm, save_tiny

JOINTS = ("shoulder_pan", "shoulder_lift", "elbow", "wrist_1", "wrist_2", "wrist_3",
          "left_finger", "right_finger")  # fmt: skip
REACH = Reach(JOINTS, "tcp", "table", 0.05, (0.02, 0.032), "push", "0" * 64)


def network() -> PhysicsInference:
    torch.manual_seed(0)
    model = PhysicsInference().eval().requires_grad_(False)
    model.know(torch.tensor([0.2, 0.3, 0.6]), torch.tensor([150.0, 400.0, 900.0]))
    torch.nn.init.normal_(model.head.weight, std=0.5)
    model.head.bias[2:] = 5.0  # readings weigh about as much as the prior
    return model


@pytest.fixture(scope="module")
def scene() -> Scene:
    return make("push").scene("push", 0)


def recording(scene: Scene, frames: int, step: float = 0.05) -> Recording:
    """The first cube goes along y."""
    qpos = np.tile(scene.model.key_qpos[0], (frames, 1))
    qpos[:, 9] += 0.004 * np.arange(frames) * step / 0.05
    return Recording(np.arange(frames) * step, {"qpos": qpos})


def test_a_checkpoint_holds_it_with_what_it_suits(tmp_path: Path, scene: Scene) -> None:
    folder = save_tiny(tmp_path / "look", scene)
    assert not has_physics(folder)
    with pytest.raises(InputError, match="no physics inference"):
        load_physics(folder)
    model = network()
    add_part(folder, PHYSICS, model, {"windows": 3}, dataclasses.asdict(REACH))
    assert has_physics(folder)
    found, reach = load_physics(folder)
    assert reach == REACH
    for name, value in model.state_dict().items():
        torch.testing.assert_close(found.state_dict()[name], value, atol=5e-3, rtol=1e-3)
    (folder / "physics.safetensors").write_bytes(b"damaged")
    with pytest.raises(InputError, match="sha256"):
        load_physics(folder)


@pytest.mark.parametrize(
    ("name", "value"), [("high", 900.0), ("width", 0.0), ("widen", 0.0), ("low", 9.0)]
)
def test_draws_that_make_no_sense_are_refused(
    tmp_path: Path, scene: Scene, name: str, value: float
) -> None:
    folder, model = save_tiny(tmp_path / "look", scene), network()
    getattr(model, name)[0] = value
    add_part(folder, PHYSICS, model, {}, dataclasses.asdict(REACH))
    with pytest.raises(InputError, match="make no sense"):
        load_physics(folder)


def test_what_is_no_number_is_said_by_no_one(scene: Scene) -> None:
    model = network()
    model.head.bias[0] = float("nan")
    with pytest.raises(InputError, match="no number"):
        infer_physics(scene, [recording(scene, 70)], model, REACH)


@pytest.mark.parametrize("reach", [[], None, "push"])
def test_a_manifest_without_a_reach_is_refused(tmp_path: Path, scene: Scene, reach: Any) -> None:
    folder = save_tiny(tmp_path / "look", scene)
    add_part(folder, PHYSICS, network(), {}, dataclasses.asdict(REACH))
    path = folder / "manifest.json"
    path.write_text(json.dumps({**json.loads(path.read_text()), "reach": reach}))
    with pytest.raises(InputError, match="reach"):
        load_physics(folder)


def test_another_scene_is_refused(scene: Scene) -> None:
    one = recording(scene, 70)
    assert REACH.problem(scene) == ""
    cases: list[tuple[Scene, Reach, str]] = [
        (arm(), REACH, "joints"),
        (scene, dataclasses.replace(REACH, surface="floor_of_another"), "geom"),
        (scene, dataclasses.replace(REACH, hand="palm"), "site"),
        (scene, dataclasses.replace(REACH, half=(0.1, 0.2)), "half sizes"),
    ]
    for other, reach, reason in cases:
        with pytest.raises(UnsupportedSceneError, match=reason):
            infer_physics(other, [one], network(), reach)
    spec = scene.spec
    spec.geom("cube1").type = 2  # a sphere
    ball = load_scene(Scene.from_spec(spec, source="ball").spec.to_xml())
    with pytest.raises(UnsupportedSceneError, match="no box"):
        infer_physics(ball, [one], network(), REACH)


def test_each_number_is_said_with_an_interval_within_what_was_drawn(scene: Scene) -> None:
    said = infer_physics(scene, [recording(scene, 90)], network(), REACH)
    assert list(said) == ["friction:table", "density:cube1", "density:cube2"]
    for name, one in said.items():
        low, high = (0.2, 0.6) if name.startswith("friction") else (150.0, 900.0)
        assert low * 0.999 <= one.low < one.value < one.high <= high * 1.001
        assert 0 < one.spread <= one.prior
    assert said["density:cube1"].unit == "kg/m^3" and said["friction:table"].unit == "1"
    assert guesses(said)["friction:table"] == (
        said["friction:table"].value, said["friction:table"].spread,
    )  # fmt: skip


def test_the_window_that_is_surest_says_it(scene: Scene) -> None:
    class Told(PhysicsInference):
        """Of the third window it is sure of the table, of the second of the second cube."""

        def said(self, window: Window) -> Posterior:
            count = len(window.pos)
            mean = torch.arange(count, dtype=torch.float32)[:, None].expand(count, 3)
            spread = torch.full((count, 3), 0.3)
            spread[2, 0] = spread[1, 2] = 0.1
            return Posterior(mean, spread)

    model = Told()
    model.low[:], model.high[:] = -9.0, 9.0
    said = infer_physics(scene, [recording(scene, 90)], model, REACH)
    assert np.log(said["friction:table"].value) == pytest.approx(2.0, abs=1e-5)
    assert np.log(said["density:cube2"].value) == pytest.approx(1.0, abs=1e-5)


def test_windows_have_the_frames_of_the_training(scene: Scene) -> None:
    model = scene.model

    def cut(one: Recording, qpos: Any = None) -> Window | None:
        return windows_of(scene, one.time, one["qpos"] if qpos is None else qpos, "tcp", 0.05)

    fast, slow = (cut(recording(scene, n, step)) for n, step in ((64 * 5, 0.01), (64, 0.05)))
    assert fast is not None and slow is not None
    for a, b in zip(fast, slow, strict=True):  # 100 frames a second, and 20
        torch.testing.assert_close(a[:1], b[:1], atol=1e-4, rtol=0)
    torch.testing.assert_close(slow.half[0, 0].numpy(), model.geom("cube1").size.astype(np.float32))
    short = cut(recording(scene, 30))
    assert short is not None and short.pos.shape[1] == FRAMES
    assert int(short.known[0, :, 0].sum()) == int(short.hand_known.sum()) == 30
    one = recording(scene, 64)
    qpos = np.array(one["qpos"])
    qpos[10:20, 15:22] = np.nan
    hidden = cut(one, qpos)
    assert hidden is not None
    assert 9 <= int((hidden.known[0, :, 1] == 0).sum()) <= 12 and bool(hidden.pos.isfinite().all())
    assert int((hidden.known[0, :, 0] == 0).sum()) == 0
    qpos[5:, 8:] = np.nan
    assert cut(one, qpos) is None
    with pytest.raises(RecordingError, match="object is seen in 12 frames"):
        infer_physics(scene, [Recording(one.time, {"qpos": qpos})], network(), REACH)
