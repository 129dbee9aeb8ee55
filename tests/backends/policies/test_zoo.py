from __future__ import annotations

from pathlib import Path

import pytest
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
