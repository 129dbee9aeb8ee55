"""Bodies that no model was trained on, and the tables."""

from __future__ import annotations

import argparse
import concurrent.futures
import json
import sys
import time
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest
from orbisim_world_model.reading_articulation import limb_concerns, limb_rows

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "tools"))
import eval_one_model

pytestmark = pytest.mark.filterwarnings("ignore:.*settotalmass")


def model_of(name: str) -> mujoco.MjModel:
    return mujoco.MjModel.from_xml_string(eval_one_model.BODIES[name]()[0])


@pytest.mark.parametrize("name", eval_one_model.BODIES)
def test_every_body_is_made_of_limbs_and_differs_from_the_suites(name: str) -> None:
    model = model_of(name)
    assert limb_concerns(model) == []
    rows = limb_rows(model, name)
    assert len(rows) == model.njnt
    domain = name.partition("_")[0]
    if domain in eval_one_model.SUITE_DOMAINS:
        plain = limb_rows(mujoco.MjModel.from_xml_string(eval_one_model._suite(domain)), domain)
        assert len(rows) == len(plain) + (name == "hopper_link")
        assert rows.shape != plain.shape or np.abs(rows - plain).max() > 1e-3


def test_limbs_are_longer_and_heavier_by_a_fifth() -> None:
    plain = mujoco.MjModel.from_xml_string(eval_one_model._suite("walker"))
    longer, heavier = model_of("walker_longer"), model_of("walker_heavier")
    leg = plain.geom("right_leg").id
    np.testing.assert_allclose(longer.geom_size[leg, 1], 1.2 * plain.geom_size[leg, 1])
    np.testing.assert_allclose(longer.geom_size[leg, 0], plain.geom_size[leg, 0])
    np.testing.assert_allclose(longer.body("left_leg").pos, 1.2 * plain.body("left_leg").pos)
    np.testing.assert_allclose(heavier.body_mass, 1.2 * plain.body_mass)
    np.testing.assert_allclose(model_of("cheetah_heavier").body_mass.sum(), 1.2 * 14.0, rtol=1e-5)


def test_another_link_hangs_between_calf_and_foot() -> None:
    model = model_of("hopper_link")
    assert model.body(model.body("foot").parentid[0]).name == "shank"
    assert model.body(model.body("shank").parentid[0]).name == "calf"
    assert model.nu == 5
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    suite = mujoco.MjModel.from_xml_string(eval_one_model._suite("hopper"))
    there = mujoco.MjData(suite)
    mujoco.mj_forward(suite, there)
    assert data.body("foot").xpos[2] == pytest.approx(there.body("foot").xpos[2])


def test_what_is_kept_is_not_measured_again(tmp_path: Path) -> None:
    options = argparse.Namespace(work=tmp_path, columns=None, checkpoint=None)
    assert "after" not in eval_one_model.columns_of("bodies", options)
    options.checkpoint = tmp_path
    assert "after" in eval_one_model.columns_of("bodies", options)
    for column, median in (("separate", 0.2), ("one", 0.1)):
        path = tmp_path / f"domains_walker_{column}.json"
        path.write_text(json.dumps([[median, 1.0, 2.0]] * 3))
    row = eval_one_model.rows("domains", options)["walker"]
    assert row["ratio"] == [0.5] * 3
    table = eval_one_model.tables({"domains": {"walker": row}})
    assert table[0] == "| domains | separate | one | ratio |"
    assert table[2] == "| walker | 0.2, 0.2, 0.2 | 0.1, 0.1, 0.1 | 0.5, 0.5, 0.5 |"
    tails = eval_one_model.tables({"domains": {"walker": {"one": row["one"][:1]}}}, tails=True)
    assert tails[2] == "| walker | 0.1 / 1 / 2 |"


def test_a_bodys_episodes_are_collected_once_for_all_columns(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    made: list[str] = []

    def collect(scene: str, path: Path, **settings: Any) -> None:
        made.append(path.name)
        time.sleep(0.02)  # in which another one would find no file yet
        path.touch()

    def row(name: str, column: str, options: Any) -> list[list[float]]:
        assert all(path.exists() for path in eval_one_model.prepared(name, options)[1].values())
        return [[float(len(column)), 0.0, 0.0]]

    bodies, columns = ("three_links", "arm"), ("constant velocity", "known", "separate")
    threads = concurrent.futures.ThreadPoolExecutor
    monkeypatch.setattr(
        concurrent.futures, "ProcessPoolExecutor", lambda workers, mp_context: threads(workers)
    )
    monkeypatch.setattr("orbisim.tasks.collect.collect", collect)
    monkeypatch.setattr(eval_one_model.torch, "set_num_threads", lambda number: None)
    monkeypatch.setitem(eval_one_model.PARTS, "bodies", (bodies, row))
    words = ["--work", tmp_path, "--only", "bodies", "--workers", "8"]
    words += ["--columns", ",".join(columns), "--json", tmp_path / "all.json"]
    monkeypatch.setattr(sys, "argv", ["eval_one_model.py", *map(str, words)])
    assert eval_one_model.main() == 0
    assert sorted(made) == sorted(f"{b}_{kind}.h5" for b in bodies for kind in ("train", "test"))
    found = json.loads((tmp_path / "all.json").read_text())["bodies"]
    assert found["arm"]["known"] == [[5.0, 0.0, 0.0]] and found["arm"].keys() == set(columns)


def test_a_training_ends_by_processor_time() -> None:
    clock = eval_one_model.ProcessorClock(None, 0.02)
    assert clock.progress < 1.0
    total = 0.0
    while clock.progress < 1.0:
        total += sum(range(1000))
    assert clock.elapsed >= 0.02
