"""Training: resuming, many processes, learning something."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import mujoco
import pytest
import torch
from orbisim_world_model.checkpoint import load_checkpoint
from orbisim_world_model.config import Config
from orbisim_world_model.evaluate import constant_velocity, evaluate
from orbisim_world_model.network.objects import ObjectCentricNetwork
from orbisim_world_model.pack import Pack, joined
from orbisim_world_model.packing import as_limbs
from orbisim_world_model.presets import PRESETS
from orbisim_world_model.run import Run, train
from orbisim_world_model.schedule import Clock
from orbisim_world_model.trainer import Trainer
from orbisim_world_model.unroll import moment_loss
from safetensors.torch import load_file, save_file

from orbisim.errors import InputError, OrbiSimError
from tests.backends.world_model.conftest import toy
from tests.backends.world_model.robots import CRAWLER
from tests.backends.world_model.synthetic import BOX, PENDULUM, TABLE, simulate

ROOT = Path(__file__).parents[3]
STAGES = "0.5x2x16,0.5x3x8ar"


def _weights(folder: Path) -> dict[str, torch.Tensor]:
    found: dict[str, torch.Tensor] = load_file(str(folder / "training.safetensors"))
    return found


@pytest.mark.parametrize("name", ["default", "paper", "dreamer"])
def test_a_killed_training_goes_on_exactly_where_it_was(name: str, tmp_path: Path) -> None:
    pack = simulate(TABLE, 4, 20, 4)
    config = toy(name, STAGES)
    train(pack, config, Run(out=tmp_path / "whole", steps=12, log_every=4))

    class Killed(Exception):
        pass

    def kill(line: dict[str, float]) -> None:
        if line["step"] == 8:
            raise Killed

    run = Run(out=tmp_path / "parts", steps=12, log_every=4, save_every=0.0)
    with pytest.raises(Killed):
        train(pack, config, run, kill)
    with (run.out / "metrics.jsonl").open("a") as file:  # what cannot be drawn is left out
        file.write('{"step": 7}\n{"step": "x"}\n[]\n{"step": 8, "loss": 1')
    train(pack, config, Run(out=tmp_path / "parts", steps=12, log_every=4, resume=True))
    whole, parts = _weights(tmp_path / "whole"), _weights(tmp_path / "parts")
    assert whole.keys() == parts.keys()
    for tensor_name, tensor in whole.items():
        assert torch.equal(tensor, parts[tensor_name]), tensor_name


def test_a_training_is_not_resumed_with_other_settings(tmp_path: Path) -> None:
    pack = simulate(PENDULUM, 4, 20, 2)
    train(pack, toy(), Run(out=tmp_path, steps=2))
    with pytest.raises(InputError, match="another configuration"):
        train(pack, toy("no_noise"), Run(out=tmp_path, steps=4, resume=True))
    with pytest.raises(InputError, match="--seed 0, not 1"):
        train(pack, toy(), Run(out=tmp_path, steps=4, resume=True, seed=1))
    with pytest.raises(InputError, match="budget"):
        train(pack, toy(), Run(out=tmp_path))


_WORKER = """
import sys
from pathlib import Path
import torch
torch.set_num_threads(1)
from orbisim_world_model.pack import Pack
from orbisim_world_model.run import Run, train
from tests.backends.world_model.conftest import toy
pack = Pack.load(sys.argv[1])
train(pack, toy("default", "1x2x16"), Run(out=Path(sys.argv[2]), steps=5))
"""


@pytest.mark.slow  # three programs that load torch
def test_two_processes_train_as_one(tmp_path: Path) -> None:
    simulate(TABLE, 4, 20, 4).save(tmp_path / "data.pack")
    script = tmp_path / "worker.py"
    script.write_text(_WORKER)
    paths = f"{ROOT}{os.pathsep}{ROOT / 'backends'}"
    environment = {**os.environ, "PYTHONPATH": paths, "OMP_NUM_THREADS": "1"}
    alone = [sys.executable, str(script)]
    pair = [sys.executable, "-m", "torch.distributed.run", "--nproc-per-node=2", "--standalone"]
    for command, out in ((alone, "one"), ([*pair, str(script)], "two")):
        arguments = [*command, str(tmp_path / "data.pack"), str(tmp_path / out)]
        done = subprocess.run(arguments, env=environment, capture_output=True, text=True)
        assert done.returncode == 0, done.stderr[-2000:]
    one, two = _weights(tmp_path / "one"), _weights(tmp_path / "two")
    for name, tensor in one.items():  # sums in another order, which Adam amplifies
        assert (two[name] - tensor).norm() < 1e-2 * tensor.norm() + 1e-12, name
    manifest = json.loads((tmp_path / "two" / "manifest.json").read_text())
    assert manifest["training"]["processes"] == 2


@pytest.mark.parametrize("xml", [PENDULUM, pytest.param(BOX, marks=pytest.mark.slow)])
def test_a_toy_model_beats_constant_velocity(xml: str, tmp_path: Path) -> None:
    pack = simulate(xml, 24, 40, 2)
    config = toy("default", "0.8x1x256,0.2x4x32ar", train__rate="3e-3")
    train(pack, config, Run(out=tmp_path, steps=150, horizons=(10,)))
    held = simulate(xml, 8, 40, 2, seed=9)
    model = load_checkpoint(tmp_path).model
    ours = evaluate(model, held, (10,))["10"]
    theirs = evaluate(constant_velocity(held, config.model), held, (10,))["10"]
    assert ours["trajerr"]["median"] < 0.5 * theirs["trajerr"]["median"]


def test_a_time_limit_ends_with_the_whole_schedule(tmp_path: Path) -> None:
    pack = simulate(PENDULUM, 4, 20, 2)
    train(pack, toy("default", STAGES), Run(out=tmp_path, limit=2.0, log_every=1))
    lines = [json.loads(line) for line in (tmp_path / "metrics.jsonl").read_text().splitlines()]
    assert lines[-1]["rate"] < 0.1 * max(line["rate"] for line in lines)
    assert lines[-1]["ratio"] > 0.8
    manifest = json.loads((tmp_path / "manifest.json").read_text())
    assert manifest["training"]["finished"]
    assert manifest["training"]["seconds"] >= 1.8  # a tenth is kept for measuring it


@pytest.mark.parametrize("name", sorted(PRESETS))
def test_every_configuration_trains(name: str) -> None:
    if name == "constant_velocity":
        return
    pack = simulate(TABLE, 3, 12, 4)
    if name == "hybrid":
        pack = _with_predictions(pack)
    if name == "limbs":  # knows no objects
        model = mujoco.MjModel.from_xml_string(CRAWLER)
        pack = as_limbs(simulate(CRAWLER, 3, 12, 1), model)
    config = toy(name, "1x1x8" if name == "hybrid" else "1x2x8ar")
    trainer = Trainer(pack, config, Clock(2, None))
    before = trainer.optimizer.values.clone()
    for _ in range(2):
        trainer.step()
    losses = trainer.losses()
    assert losses["skipped"] == 0
    assert losses["state_loss"] > 0
    assert not torch.equal(before, trainer.optimizer.values)
    assert Config.from_dict(json.loads(json.dumps(config.to_dict()))) == config


def _with_predictions(pack: Pack) -> Pack:
    import dataclasses

    return dataclasses.replace(pack, base=torch.cat([pack.qpos, pack.qvel, pack.act], dim=1))


def test_packs_of_scenes_with_fewer_objects_are_joined(tmp_path: Path) -> None:
    large = simulate(TABLE, 2, 10, 4)
    start = TABLE.index('<body name="two"')
    small = simulate(TABLE[:start] + TABLE[TABLE.index("</worldbody>") :], 2, 10, 4)
    both = joined([small, large])
    assert both.mask.tolist() == [[1, 0], [1, 0], [1, 1], [1, 1]]
    x = both.states(torch.arange(5))
    expected = small.states(torch.arange(5))
    torch.testing.assert_close(x.pos[:, :1], expected.pos)
    torch.testing.assert_close(x.q, expected.q)
    both.save(tmp_path / "both.pack")
    again = Pack.load(tmp_path / "both.pack")
    torch.testing.assert_close(again.hand, both.hand, atol=1e-6, rtol=0)
    assert again.layout == both.layout


def test_a_training_is_not_written_over(tmp_path: Path) -> None:
    pack = simulate(PENDULUM, 4, 20, 2)
    train(pack, toy(), Run(out=tmp_path, steps=2))
    before = {path.name: path.read_bytes() for path in tmp_path.iterdir()}
    with pytest.raises(InputError, match="holds a training already"):
        train(pack, toy(), Run(out=tmp_path, steps=2, seed=5))
    assert {path.name: path.read_bytes() for path in tmp_path.iterdir()} == before
    (tmp_path / "file").write_text("")
    with pytest.raises(InputError, match="is not a folder"):
        train(pack, toy(), Run(out=tmp_path / "file", steps=2))


def test_two_trainings_do_not_share_a_folder(tmp_path: Path) -> None:
    pack = simulate(PENDULUM, 4, 20, 2)

    def second(_: dict[str, float]) -> None:
        with pytest.raises(InputError, match="another training is at work"):
            train(pack, toy(), Run(out=tmp_path, steps=2, resume=True))

    train(pack, toy(), Run(out=tmp_path, steps=2, log_every=1), second)


def test_a_training_whose_losses_are_not_finite_fails(tmp_path: Path) -> None:
    pack = simulate(PENDULUM, 4, 20, 2)
    pack.qvel[pack.qvel.shape[0] // 2 :] = torch.nan
    with pytest.raises(OrbiSimError, match="diverged"):
        train(pack, toy(), Run(out=tmp_path, steps=4, log_every=2))
    assert not (tmp_path / "model.safetensors").exists()


def test_metrics_of_a_killed_training_go_on_without_gaps_or_repeats(tmp_path: Path) -> None:
    pack = simulate(PENDULUM, 4, 20, 2)
    train(pack, toy(), Run(out=tmp_path, steps=4, log_every=1))
    path = tmp_path / "metrics.jsonl"
    path.write_text(path.read_text() + '{"step": 5, "seconds": 1.0}\n{"step": 6, "sec')
    train(pack, toy(), Run(out=tmp_path, steps=8, log_every=1, resume=True))
    lines = [json.loads(line) for line in path.read_text().splitlines()]
    assert [line["step"] for line in lines] == list(range(1, 9))
    assert all("loss" in line for line in lines)


@pytest.mark.parametrize(
    "damage",
    [
        lambda path: path.write_bytes(path.read_bytes()[:-100]),
        lambda path: path.write_bytes(b""),
        lambda path: save_file({"values": torch.zeros(3)}, str(path)),
        lambda path: save_file({"values": torch.zeros(3)}, str(path), {"notes": "[" * 100_000}),
        lambda path: save_file(
            {"values": torch.full((3,), torch.nan)},
            str(path),
            {"notes": '{"seed": 0, "step": 1, "seconds": 0.0, "config": {}}'},
        ),
    ],
)
def test_damaged_progress_is_not_gone_on_with(tmp_path: Path, damage: Any) -> None:
    pack = simulate(PENDULUM, 4, 20, 2)
    train(pack, toy(), Run(out=tmp_path, steps=2))
    damage(tmp_path / "training.safetensors")
    with pytest.raises(InputError, match=r"training\.safetensors"):
        train(pack, toy(), Run(out=tmp_path, steps=4, resume=True))


def test_manifests_say_in_what_precision_was_trained(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    seen = set()
    forward = ObjectCentricNetwork.forward

    def watched(self: ObjectCentricNetwork, inputs: Any, *rest: Any) -> Any:
        out = forward(self, inputs, *rest)
        seen.add((out.latent.dtype, torch.is_autocast_enabled("cpu")))
        return out

    monkeypatch.setattr(ObjectCentricNetwork, "forward", watched)
    manifest = train(simulate(TABLE, 4, 12, 4), toy(), Run(out=tmp_path, steps=2))
    assert seen == {(torch.float32, False)}
    assert manifest["training"]["precision"] == "fp32"
    assert Config.from_dict(manifest["config"]).train.precision == "tf32"  # on a GPU it would be


def test_what_a_manifest_says_is_true(tmp_path: Path) -> None:
    """Of the data, and the figures when they are recomputed from the checkpoint as it is stored."""
    pack, held = simulate(TABLE, 4, 20, 4), simulate(TABLE, 3, 20, 4, seed=1)
    run = Run(out=tmp_path, steps=12, horizons=(2, 6), burn=3)
    manifest = train(pack, toy(), run, held=[held])
    checkpoint = load_checkpoint(tmp_path)
    assert manifest["parameters"] == sum(p.numel() for p in checkpoint.model.parameters())
    assert manifest["training"]["steps"] == 12
    assert manifest["data"]["episodes"] == 4
    assert manifest["data"]["control_steps"] == int(pack.length.sum())
    low, high = manifest["ranges"]["joints"][pack.layout.joints[0]]
    column = pack.qpos[:, pack.layout.joint_q[0]]
    assert (low, high) == pytest.approx((float(column.min()), float(column.max())))
    metrics = manifest["metrics"]
    assert (metrics["held_out_episodes"], metrics["burn"]) == (3, 3)
    again = evaluate(checkpoint.model, held, (2, 6), burn=3)
    assert metrics["model"].keys() == again.keys() == {"2", "6"}
    for horizon, quantities in again.items():
        for name, row in quantities.items():
            assert metrics["model"][horizon][name] == pytest.approx(row, rel=1e-6), name
    still = evaluate(constant_velocity(held, toy().model), held, (6,), burn=3)
    assert metrics["constant_velocity"]["6"] == {
        name: pytest.approx(row, rel=1e-6) for name, row in still["6"].items()
    }


def test_gradients_are_cut_where_a_stage_says_so() -> None:
    pack = simulate(TABLE, 3, 20, 4)
    config = toy(stages="1x6x8arf/2", train__noise=0.0)
    assert config.train.stages[0].reach == 2
    trainer = Trainer(pack, config, Clock(1, None), seed=0)
    cut = []

    def each(objective: Any, moment: Any, context: Any) -> Any:
        given = moment.predicted
        cut.append(given is not None and not given.pos.requires_grad)
        return moment_loss(objective, moment, context)

    trainer._each = each
    trainer._prepare(0)
    cut.clear()
    trainer.step()
    assert cut == [False, False, True, False, True, False]
