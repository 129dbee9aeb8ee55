"""One model of the whole suite: beside separate models, and on bodies that it has never seen.

    python tools/eval_one_model.py --checkpoint CHECKPOINT --data DATA --work DIR
        [--zoo ZOO] [--only domains,bodies] [--seconds 60] [--workers 16] [--json FILE]

DATA has the suite's `*_test` files (or packs) of tools/collect_all.py, ZOO a checkpoint for each
domain. DIR keeps scenes, episodes and finished rows, so that a run that was stopped goes on.

- domains: for each domain the normalised error (root mean square over joints and steps, in units of
  each coordinate's spread) after 10, 50 and 100 of the suite's control steps, median, 90 % and
  worst over the held-out episodes; of the separate model, of the one model, of what is known
  without learning, of constant velocity; and `ratio`, of medians.
- bodies: made of the suite by MJCF (limbs 20 % longer, 20 % heavier, a hopper with another link),
  a pendulum of three links and an arm of three joints with servos. The same error on episodes of C
  MuJoCo: `before` any training on them, `after` so many processor seconds of training on one core
  on `--episodes` episodes, and as much training from `nothing` and of a `separate` model from
  nothing; `known` is what follows without learning, `untrained` the start of `nothing`.
"""

from __future__ import annotations

import argparse
import concurrent.futures
import functools
import importlib
import json
import multiprocessing
import sys
import time
import warnings
import xml.etree.ElementTree as ElementTree
from collections.abc import Callable
from pathlib import Path
from typing import Any

import mujoco
import torch

ROOT = Path(__file__).resolve().parent.parent
sys.path[:0] = [str(ROOT), str(ROOT / "backends"), str(ROOT / "tools")]

import train_all  # noqa: E402  (needs the path above)
from orbisim_world_model.schedule import Clock  # noqa: E402

from orbisim.tasks.domains import SUBSTEPS, SUITE_DOMAINS  # noqa: E402

MARKS = (10, 50, 100)
"""Of the suite's control steps."""
LONGER = HEAVIER = 1.2
TEST_SEED, TRAIN_SEED, TESTS, STEPS = 1, 0, 40, 500
CONTROL = 0.02
"""s, of bodies that are not of the suite: between its control steps of 10 and 25 ms."""
STAGES = {"limbs": "0.5x1x256,0.5x8x64ar", "default": "0.5x1x1024,0.5x8x256ar"}
"""For a core of a CPU; a limb's step takes several times that of a robot's token."""

LINKS = """
<mujoco model="three links">
  <option timestep="0.01"><flag contact="disable"/></option>
  <default>
    <joint type="hinge" axis="0 1 0" damping="0.05"/>
    <geom type="capsule" fromto="0 0 0 0 0 -.4" size="0.03" mass="0.5"/>
    <motor ctrlrange="-1 1" ctrllimited="true"/>
  </default>
  <worldbody>
    <body name="one" pos="0 0 1.5"><joint name="one"/><geom/>
      <body name="two" pos="0 0 -.4"><joint name="two"/><geom/>
        <body name="three" pos="0 0 -.4"><joint name="three"/><geom/></body>
      </body>
    </body>
  </worldbody>
  <actuator><motor joint="one" gear="2"/><motor joint="two" gear="1"/></actuator>
</mujoco>
"""
ARM = """
<mujoco model="arm of three joints">
  <option timestep="0.005"/>
  <default>
    <joint type="hinge" damping="0.5" armature="0.02" frictionloss="0.2" limited="true"/>
    <geom type="capsule" friction="0.6 0.1 0.1"/>
  </default>
  <worldbody>
    <geom name="floor" type="plane" size="2 2 .1"/>
    <body name="base" pos="0 0 .15">
      <joint name="yaw" axis="0 0 1" range="-160 160"/>
      <geom fromto="0 0 0 0 0 .1" size="0.05" mass="2" contype="0" conaffinity="0"/>
      <body name="upper" pos="0 0 .1">
        <joint name="shoulder" axis="0 1 0" range="-100 100"/>
        <geom fromto="0 0 0 .3 0 0" size="0.03" mass="1.2"/>
        <body name="fore" pos=".3 0 0">
          <joint name="elbow" axis="0 1 0" range="-140 140"/>
          <geom fromto="0 0 0 .25 0 0" size="0.025" mass="0.8"/>
        </body>
      </body>
    </body>
  </worldbody>
  <actuator>
    <position joint="yaw" kp="40" kv="4" ctrlrange="-2.5 2.5" forcerange="-20 20"/>
    <position joint="shoulder" kp="60" kv="6" ctrlrange="-1.5 1.5" forcerange="-30 30"/>
    <position joint="elbow" kp="30" kv="3" ctrlrange="-2.2 2.2" forcerange="-15 15"/>
  </actuator>
</mujoco>
"""


def main() -> int:
    """Measures what is not there yet; prints lines of JSON, and tables of all there is."""
    options = _parser().parse_args()
    warnings.simplefilter("ignore")
    options.work.mkdir(parents=True, exist_ok=True)
    chosen = options.names.split(",") if options.names else None
    jobs = [
        (part, name, column)
        for part in options.only.split(",")
        for column in columns_of(part, options)
        for name in PARTS[part][0]
        if chosen is None or name in chosen
    ]
    jobs = [job for job in jobs if not _kept(job, options)]
    bodies = list(dict.fromkeys(name for part, name, _ in jobs if part == "bodies"))
    context = multiprocessing.get_context("spawn")
    with concurrent.futures.ProcessPoolExecutor(options.workers, mp_context=context) as pool:
        first = [pool.submit(measured, *job, options) for job in jobs if job[0] != "bodies"]
        # one process collects a body's episodes, which several then read
        list(pool.map(prepared, bodies, [options] * len(bodies)))
        rest = [pool.submit(measured, *job, options) for job in jobs if job[0] == "bodies"]
        for future in concurrent.futures.as_completed(first + rest):
            part, name, column, row = future.result()
            print(json.dumps({part: {name: {column: row}}}), flush=True)
    found = {part: rows(part, options) for part in options.only.split(",")}
    if options.json:
        options.json.write_text(json.dumps(found, indent=1))
    print("\n".join(tables(found, options.tails)))
    return 0


def measured(part: str, name: str, column: str, options: Any) -> tuple[str, str, str, Any]:
    """One column of a row, which is kept, behind its names."""
    warnings.simplefilter("ignore")
    torch.set_num_threads(1)
    found = PARTS[part][1](name, column, options)
    _kept_at((part, name, column), options).write_text(json.dumps(found))
    return part, name, column, found


def rows(part: str, options: Any) -> dict[str, Any]:
    """All columns that are kept, by row."""
    table: dict[str, Any] = {}
    for name in PARTS[part][0]:
        row = {
            column: found
            for column in COLUMNS[part]
            if (found := _kept((part, name, column), options)) is not None
        }
        if part == "domains" and {"one", "separate"} <= set(row):
            pairs = zip(row["one"], row["separate"], strict=True)
            row["ratio"] = [one[0] / max(apart[0], 1e-12) for one, apart in pairs]
        if row:
            table[name] = row
    return table


def _kept_at(job: tuple[str, str, str], options: Any) -> Path:
    part, name, column = job
    found: Path = options.work / f"{part}_{name}_{column.replace(' ', '_')}.json"
    return found


def _kept(job: tuple[str, str, str], options: Any) -> Any:
    path = _kept_at(job, options)
    return json.loads(path.read_text()) if path.exists() else None


def columns_of(part: str, options: Any) -> list[str]:
    """Those that are asked for; without a checkpoint those that need none."""
    wanted = options.columns.split(",") if options.columns else COLUMNS[part]
    lacking = () if options.checkpoint else NEEDING[part]
    return [c for c in COLUMNS[part] if c in wanted and c not in lacking]


# -- domains -------------------------------------------------------------------------------------


def domain(name: str, column: str, options: Any) -> Any:
    """Errors of one of the models on one of the suite's domains; None where there is none."""
    from orbisim_world_model.checkpoint import load_for
    from orbisim_world_model.packing import with_limbs

    (pack,) = train_all.read_named(options.data, (f"suite_{name}_test",))
    marks = [SUBSTEPS.get(name, 1) * mark for mark in MARKS]
    if column == "constant velocity":
        return still(pack, marks)
    if column == "separate":
        if not (options.zoo / name).exists():
            return None
        return errors(load_for(options.zoo / name, pack.layout).model, pack, marks)
    limbs = with_limbs(pack)
    one = load_for(options.checkpoint, limbs.layout).model
    return errors(unlearned(one) if column == "known" else one, limbs, marks)


def errors(model: Any, pack: Any, marks: list[int]) -> list[list[float]]:
    """[mark, (median, 90 %, worst)] of the normalised error."""
    from orbisim_world_model.evaluate import evaluate

    found = evaluate(model, pack, marks, burn=0, limit=TESTS)
    rows = [found[str(mark)]["normalised"] for mark in marks]
    return [[row["median"], row["p90"], row["worst"]] for row in rows]


def still(pack: Any, marks: list[int]) -> list[list[float]]:
    """The same of constant velocity."""
    from orbisim_world_model.evaluate import constant_velocity
    from orbisim_world_model.presets import preset

    return errors(constant_velocity(pack, preset("default").model), pack, marks)


def unlearned(model: Any) -> Any:
    """The model whose network gives no impulses at contacts and limits: what is left is known."""
    import copy

    from orbisim_world_model.articulation import silenced

    found = copy.deepcopy(model)
    silenced(found.network.f_dec.parts[-1])
    return found


# -- bodies --------------------------------------------------------------------------------------


def prepared(name: str, options: Any) -> tuple[Path, dict[str, Path], float, float]:
    """A body's scene and episodes, made where they lack; and durations of its model's step and of a
    control step, s."""
    from orbisim_world_model.reading_articulation import natural_step

    warnings.simplefilter("ignore")
    text, control = BODIES[name]()
    scene = options.work / f"{name}.xml"
    if not scene.exists():
        scene.write_text(text)
    step = natural_step(mujoco.MjModel.from_xml_path(str(scene)))
    sets = (("train", options.episodes, TRAIN_SEED), ("test", TESTS, options.test_seed))
    files = {kind: _episodes(scene, kind, count, seed, step) for kind, count, seed in sets}
    return scene, files, step, control


def body(name: str, column: str, options: Any) -> Any:
    """Errors of one of the models on a body that the one model was not trained on."""
    from orbisim_world_model.checkpoint import load_for
    from orbisim_world_model.packing import read_data, with_limbs

    scene, files, step, control = prepared(name, options)
    packs = {kind: read_data([path], scene=str(scene)) for kind, path in files.items()}
    marks = [round(control / step) * mark for mark in MARKS]
    marks = [mark for mark in marks if mark <= int(packs["test"].length.max())]
    if column == "constant velocity":
        return still(packs["test"], marks)
    if column == "separate":
        return errors(_trained(packs, "default", None, options), packs["test"], marks)
    limbs = {kind: with_limbs(pack, str(scene)) for kind, pack in packs.items()}
    if column == "before":
        return errors(
            load_for(options.checkpoint, limbs["test"].layout).model, limbs["test"], marks
        )
    if column in ("known", "untrained"):
        model = _started(limbs["train"], "limbs", None)[0]
        return errors(unlearned(model) if column == "known" else model, limbs["test"], marks)
    start = options.checkpoint if column == "after" else None
    return errors(_trained(limbs, "limbs", start, options), limbs["test"], marks)


def _episodes(scene: Path, kind: str, count: int, seed: int, step: float) -> Path:
    from orbisim.cli.common import quiet_engine
    from orbisim.tasks.collect import collect

    path = scene.with_name(f"{scene.stem}_{kind}.h5")
    if not path.exists():
        changes = {"control_timestep": step, "steps": STEPS}
        with quiet_engine():
            collect(str(scene), path, episodes=count, seed=seed, workers=1, changes=changes)
    return path


def _started(pack: Any, kind: str, start: Path | None) -> tuple[Any, Any]:
    """A model to train, and its configuration: the job's; a separate one is as the suite's legs."""
    from orbisim_world_model.checkpoint import load_for
    from orbisim_world_model.config import replaced
    from orbisim_world_model.presets import preset
    from orbisim_world_model.trainer import new_model

    if kind == "limbs":
        settings = {**dict(train_all.JOBS["suite_one"].settings), "train.stages": STAGES[kind]}
    else:
        settings = {**dict(train_all._LEGS), "train.stages": STAGES[kind]}
    config = replaced(preset(kind), settings)
    if start is not None:
        return load_for(start, pack.layout).model, config
    return new_model(pack, config, 0), config


class ProcessorClock(Clock):
    """Counts processor seconds: how long a training takes does not depend on what else runs."""

    def __post_init__(self) -> None:
        self._since = time.process_time()

    @property
    def elapsed(self) -> float:
        """Of this training."""
        return time.process_time() - self._since


def _trained(data: dict[str, Any], kind: str, start: Path | None, options: Any) -> Any:
    """A model after `--seconds` of one processor, compiling and reading not counted."""
    from orbisim_world_model.config import replaced
    from orbisim_world_model.trainer import Trainer

    model, config = _started(data["train"], kind, start)
    if start is not None:
        config = replaced(config, {"train.rate": options.rate})
    clock = ProcessorClock(None, options.seconds)
    trainer = Trainer(data["train"], config, clock, models=[model])
    while clock.progress < 1.0:
        trainer.step()
    return model.eval()


def _suite(name: str) -> str:
    """A domain's MJCF in one text, as dm_control has it."""
    module = importlib.import_module(f"dm_control.suite.{name}")
    text, assets = module.get_model_and_assets()
    plain = text.decode() if isinstance(text, bytes) else text
    parts = {path.removeprefix("./"): part for path, part in assets.items()}
    spec = mujoco.MjSpec.from_string(plain, include=parts)
    spec.compile()
    return str(spec.to_xml())


def longer(name: str) -> tuple[str, float]:
    """A domain whose limbs are 20 % longer, and no thicker."""
    spec = mujoco.MjSpec.from_string(_suite(name))
    for one in spec.bodies[1:]:
        one.pos = one.pos * LONGER
        for geom in one.geoms:
            geom.pos = geom.pos * LONGER
            if geom.type == mujoco.mjtGeom.mjGEOM_CAPSULE:
                geom.fromto = geom.fromto * LONGER  # NaN where it has none
                geom.size = [geom.size[0], geom.size[1] * LONGER, geom.size[2]]
        for part in (*one.joints, *one.sites):
            part.pos = part.pos * LONGER
    spec.compile()
    return str(spec.to_xml()), _control(name)


def heavier(name: str) -> tuple[str, float]:
    """A domain that is 20 % heavier."""
    spec = mujoco.MjSpec.from_string(_suite(name))
    if spec.compiler.settotalmass > 0:
        spec.compiler.settotalmass *= HEAVIER
    for geom in spec.geoms:
        geom.density *= HEAVIER
        geom.mass *= HEAVIER  # NaN where the density counts
    for one in spec.bodies:
        if one.explicitinertial:
            one.mass *= HEAVIER
            one.inertia = one.inertia * HEAVIER
            one.fullinertia = one.fullinertia * HEAVIER
    spec.compile()
    return str(spec.to_xml()), _control(name)


def another_link() -> tuple[str, float]:
    """The hopper with a driven link between its calf and its foot."""
    root = ElementTree.fromstring(_suite("hopper"))
    calf = next(b for b in root.iter("body") if b.get("name") == "calf")
    foot = next(b for b in calf.findall("body") if b.get("name") == "foot")
    ends = [float(v) for v in (foot.get("pos") or "").split()]
    calf.remove(foot)
    shank = ElementTree.SubElement(calf, "body", name="shank", pos=_text(ends))
    joint = next(j for j in calf.findall("joint") if j.get("name") == "knee")
    more = {**joint.attrib, "name": "shin", "range": _text((-30.0, 30.0))}
    if "angle" in root.find("compiler").attrib and root.find("compiler").get("angle") == "radian":  # type: ignore[union-attr]
        more["range"] = _text((-0.5236, 0.5236))
    ElementTree.SubElement(shank, "joint", more)
    geom = next(g for g in calf.findall("geom") if g.get("name") == "calf")
    ElementTree.SubElement(shank, "geom", {**geom.attrib, "name": "shank"})
    shank.append(foot)
    actuators = root.find("actuator")
    assert actuators is not None
    knee = next(a for a in actuators if a.get("joint") == "knee")
    ElementTree.SubElement(actuators, knee.tag, {**knee.attrib, "name": "shin", "joint": "shin"})
    torso = next(b for b in root.iter("body") if b.get("name") == "torso")
    place = [float(v) for v in (torso.get("pos") or "0 0 0").split()]
    torso.set("pos", _text((*place[:2], place[2] - ends[2])))  # as high above its foot
    return ElementTree.tostring(root, encoding="unicode"), _control("hopper")


def _text(numbers: Any) -> str:
    return " ".join(f"{number:g}" for number in numbers)


def _control(name: str) -> float:
    """Duration of a control step of the suite's task, s."""
    from orbisim import suite

    return float(suite.load(name, SUITE_DOMAINS[name]).control_timestep())


BODIES: dict[str, Callable[[], tuple[str, float]]] = {
    **{f"{n}_longer": functools.partial(longer, n) for n in ("hopper", "walker", "cheetah")},
    **{f"{n}_heavier": functools.partial(heavier, n) for n in ("hopper", "walker", "cheetah")},
    "hopper_link": another_link,
    "three_links": lambda: (LINKS, CONTROL),
    "arm": lambda: (ARM, CONTROL),
}
COLUMNS = {
    "domains": ("constant velocity", "separate", "known", "one"),
    "bodies": (
        *("constant velocity", "known", "untrained", "separate", "nothing", "before", "after"),
    ),
}
NEEDING = {"domains": ("known", "one"), "bodies": ("before", "after")}
"""Columns that need the checkpoint."""
PARTS: dict[str, tuple[Any, Callable[[str, str, Any], Any]]] = {
    "domains": (tuple(SUITE_DOMAINS), domain),
    "bodies": (tuple(BODIES), body),
}


def tables(found: dict[str, Any], tails: bool = False) -> list[str]:
    """Medians as Markdown, for docs/benchmarks.md; with `tails` median / 90 % / worst."""
    lines = []
    for part, rows in found.items():
        columns = [c for c in (*COLUMNS[part], "ratio") if any(c in row for row in rows.values())]
        lines += [f"| {part} | {' | '.join(columns)} |", "| --- " * (1 + len(columns)) + "|"]
        for name, row in sorted(rows.items()):
            cells = [_cell(row.get(column, ()), tails) for column in columns]
            lines.append(f"| {name} | {' | '.join(cells)} |")
    return lines


def _cell(marks: Any, tails: bool) -> str:
    rows = [[mark] if isinstance(mark, float) else mark[: 3 if tails else 1] for mark in marks]
    return ", ".join(" / ".join(f"{value:.2g}" for value in row) for row in rows)


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--checkpoint", type=Path)
    parser.add_argument("--data", type=Path, default=Path())
    parser.add_argument("--work", type=Path, required=True)
    zoo = ROOT / "backends" / "orbisim_world_model" / "zoo"
    parser.add_argument("--zoo", type=Path, default=zoo, help="of separate models")
    parser.add_argument("--only", default=",".join(PARTS))
    parser.add_argument("--columns", help="only these, separated by commas")
    parser.add_argument("--names", help="only these domains or bodies")
    parser.add_argument("--seconds", type=float, default=60.0, help="of training, `bodies`")
    parser.add_argument("--rate", type=float, default=3e-4, help="of training that goes on")
    parser.add_argument("--episodes", type=int, default=60, help="to train on, `bodies`")
    parser.add_argument("--test-seed", type=int, default=TEST_SEED, help="of episodes, `bodies`")
    parser.add_argument("--workers", type=int, default=1)
    parser.add_argument("--tails", action="store_true", help="90 %% and worst in the tables, too")
    parser.add_argument("--json", type=Path)
    return parser


if __name__ == "__main__":
    sys.exit(main())
