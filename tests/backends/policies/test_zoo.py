from __future__ import annotations

from pathlib import Path

import pytest
from orbisim_policies.agent import Agent
from orbisim_policies.checkpoint import MANIFEST, load_policy, read_manifest
from orbisim_policies.problems import make_problem
from orbisim_policies.zoo import FOLDER, names, resolved


def test_a_name_is_the_zoos_unless_such_a_folder_holds_a_policy(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    assert resolved("nothing") == Path("nothing")
    for name in names():
        assert resolved(name) == FOLDER / name
        (tmp_path / name).mkdir()  # of videos, say
        assert resolved(name) == FOLDER / name
        (tmp_path / name / MANIFEST).touch()
        assert resolved(name) == Path(name)


def test_its_policies_are_for_the_scenes_of_now() -> None:
    for name in names():
        manifest = read_manifest(FOLDER / name)
        problem = make_problem(manifest["task"], manifest["steps"])
        assert load_policy(FOLDER / name, problem)


def test_what_was_trained_from_films_sees_nominal_values_wherever_it_acts() -> None:
    nominal = {name for name in names() if Agent.of(Path(name), _task(name)).nominal}
    assert nominal == {"push_pixels"}


def test_what_is_said_of_the_one_from_films_is_of_frames_and_of_true_states() -> None:
    manifest = read_manifest(FOLDER / "push_pixels")
    true, frames = (manifest["evaluation"][key] for key in ("mujoco", "mujoco_stainf"))
    assert (true["observe"], frames["observe"]) == ("nominal", manifest["films"]["observe"])
    assert "states" in frames and "states" not in true  # how far off what it saw was
    for found in (true, frames):
        moved = found["success"]["moved"]
        assert moved["share"] == moved["successes"] / found["episodes"]
    clone, gradients = manifest["commands"]
    assert f"--episodes {manifest['films']['episodes']}" in clone
    assert f"--seed {manifest['training']['seed']} " in gradients


def _task(name: str) -> str:
    return str(read_manifest(FOLDER / name)["task"])
