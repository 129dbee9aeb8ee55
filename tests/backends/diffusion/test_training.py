"""Trainings learn, go on after a stop as if nothing had happened, and leave a checkpoint."""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path

import pytest
import torch
from orbisim_diffusion.autoencoder import to_bytes, to_float
from orbisim_diffusion.conditions import CONTROLS
from orbisim_diffusion.config import TrainConfig, preset
from orbisim_diffusion.inference import errors, robots, truth
from orbisim_diffusion.loop import Loop
from orbisim_diffusion.train_inference import inference_errors, train_inference
from orbisim_diffusion.training import (
    Run,
    encoded,
    train_autoencoder,
    train_denoiser,
    train_one_step,
)
from safetensors.torch import load_file, save_file

from orbisim.errors import InputError
from tests.backends.diffusion.tiny import arm, store_of

TINY = preset("tiny")


def _store() -> object:
    """Frames of one colour each, so that there is something to learn in seconds."""
    store = store_of(arm(), frames=8, episodes=2)
    shade = torch.arange(len(store)) * 12
    return dataclasses.replace(
        store, frames=shade[:, None, None, None].expand(-1, 32, 32, 3).byte()
    )


@pytest.mark.parametrize("name", ["default", pytest.param("paper", marks=pytest.mark.slow)])
def test_each_part_learns(name: str) -> None:
    store = _store()
    denoiser = preset(name).denoiser
    config = dataclasses.replace(
        TINY,
        train_autoencoder=TrainConfig(batch=8, rate=1e-2, warmup=5, average=0.9),
        denoiser=dataclasses.replace(
            TINY.denoiser, maps=denoiser.maps, noisy_context=denoiser.noisy_context
        ),
    )
    lines: list[str] = []
    vae, loop = train_autoencoder(config, Run(200, 150), store, lines.append)
    assert loop.step == 150
    error = (vae.decode(vae.encode(to_float(store.frames))) - to_float(store.frames)).abs().mean()
    assert float(error) < 0.3  # of a range of 2; an untrained one has 0.5
    store = encoded(vae, store)
    assert float(store.latents.float().std()) == pytest.approx(1.0, abs=0.35)
    model, loop = train_denoiser(config, Run(100, 3), store, lines.append)
    one, loop = train_one_step(config, Run(100, 2), store, vae, model, lines.append)
    assert loop.history[-1]["loss"] > 0
    assert any((a != b).any() for a, b in zip(one.parameters(), model.parameters(), strict=True))


@pytest.mark.parametrize(
    "name",
    [
        *("no_decoupling", "no_random_sampling", "no_object_centric"),
        *("no_colour", "no_normals", "no_depth", "no_instance", "no_light"),
    ],
)
def test_each_ablation_trains_and_leaves_out_one_thing(name: str) -> None:
    store = _store()
    store = dataclasses.replace(store, controls=torch.randn(len(store), CONTROLS))
    ours, full = preset(name).denoiser, preset("default").denoiser
    left_out = {
        f.name for f in dataclasses.fields(ours) if getattr(ours, f.name) != getattr(full, f.name)
    }
    assert left_out == {
        "no_decoupling": {"maps", "tokens", "consecutive"},  # steps left out have controls, too
        "no_random_sampling": {"consecutive"},
        "no_object_centric": {"tokens"},
    }.get(name, {"left_out"})
    assert ours.left_out in ((), (name.removeprefix("no_"),))
    changes = {field: getattr(ours, field) for field in left_out}
    config = dataclasses.replace(TINY, denoiser=dataclasses.replace(TINY.denoiser, **changes))
    store = encoded(train_autoencoder(config, Run(100, 1), store)[0], store)
    _, loop = train_denoiser(config, Run(100, 2), store, lambda _: None)
    assert loop.history[-1]["loss"] > 0


def test_a_training_that_was_stopped_goes_on(tmp_path: Path) -> None:
    def run(path: Path, count: int) -> torch.Tensor:
        torch.manual_seed(1)
        layer = torch.nn.Linear(3, 2)
        loop = Loop(layer, TrainConfig(warmup=1), 1e6, path, count)
        loop._rate_share = lambda: 0.5  # type: ignore[method-assign]
        loop.run(lambda step: (layer(torch.full((4, 3), float(step))) ** 2).mean())
        return loop.average.weight

    whole = run(tmp_path / "a", 8)
    run(tmp_path / "b", 3)
    torch.testing.assert_close(run(tmp_path / "b", 8), whole)
    content = load_file(tmp_path / "b")
    notes = {"step": 8, "seconds": 1.0, "history": []}
    moment = "optimizer.0.exp_avg"
    for changed, said in (
        (content, {**notes, "step": -1}),
        (content, {**notes, "seconds": -1.0}),
        (content, {**notes, "history": [["x"]]}),
        ({**content, moment: content[moment].T.contiguous()}, notes),
        ({n: t for n, t in content.items() if n != moment}, notes),
        ({**content, moment: content[moment] * torch.nan}, notes),
        ({n.replace("weight", "weigh4"): t for n, t in content.items()}, notes),
    ):
        save_file(changed, tmp_path / "c", metadata={"notes": json.dumps(said)})
        with pytest.raises(InputError) as caught:
            run(tmp_path / "c", 9)
        assert "\n" not in str(caught.value)
    (tmp_path / "b").write_bytes(b"nonsense")
    with pytest.raises(InputError, match="damaged"):
        run(tmp_path / "b", 8)


def test_a_loss_that_is_not_finite_ends_the_training() -> None:
    layer = torch.nn.Linear(1, 1)
    loop = Loop(layer, TrainConfig(), 1e6, None, 2)
    with pytest.raises(InputError, match="lower the rate"):
        loop.run(lambda _: layer(torch.full((1, 1), torch.nan)).sum())


def test_state_inference_learns_and_measures_in_the_papers_units() -> None:
    store = encoded(train_autoencoder(TINY, Run(100, 2), _store())[0], _store())
    model, _ = train_inference(TINY, Run(100, 3), store)
    found = inference_errors(model, store, 8)
    assert json.dumps(found)
    assert found["object_position_mm"] > 0
    index = torch.arange(4)
    true = truth(store, robots(store), index)
    guess = model(store.latents[index].float())
    exact = guess._replace(
        hand_pos=true.hand_pos,
        hand_rot=true.hand_rot,
        joints=true.joints,
        present=torch.where(true.there, 9.0, -9.0),
        pos=true.pos,
        rot=true.rot,
        size=true.size,
        colour=true.colour,
    )
    perfect = errors(exact, true)
    assert perfect.pop("count_right_percent") == 100.0
    assert max(perfect.values()) < 1e-3


def test_bytes_and_floats_there_and_back() -> None:
    images = torch.randint(0, 256, (2, 4, 5, 3), dtype=torch.uint8)
    assert torch.equal(to_bytes(to_float(images)), images)
