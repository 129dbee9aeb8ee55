from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from orbisim_policies import workflows
from orbisim_policies.agent import Agent
from orbisim_policies.apg import ApgConfig
from orbisim_policies.cloning import CloneConfig
from orbisim_policies.films import SCHEMA, Films
from orbisim_policies.push import PushProblem
from orbisim_policies.run import Run, train_apg, train_clone
from safetensors.numpy import save_file
from safetensors.torch import load_file

from orbisim.errors import InputError


def test_films_come_back_and_damaged_ones_are_refused(
    push: PushProblem, films: Films, tmp_path: Path
) -> None:
    path = tmp_path / "films.safetensors"
    films.save(path)
    again = Films.load(path, push)
    assert again.notes == films.notes and again.digest == films.digest
    for name, values in films.arrays.items():
        np.testing.assert_array_equal(getattr(again, name), values)
    with pytest.raises(InputError, match="4 steps"):
        Films.load(path, PushProblem(steps=4))
    dataclasses.replace(films, ctrl=films.ctrl[:, :-1]).save(path)
    with pytest.raises(InputError, match="ctrl has shape"):
        Films.load(path, push)
    path.write_bytes(b"no films")
    with pytest.raises(InputError, match="damaged"):
        Films.load(path, push)


@pytest.mark.parametrize("errors", [True, False])
def test_a_training_from_films_goes_on_exactly(
    push: PushProblem, films: Films, tmp_path: Path, errors: bool
) -> None:
    films = dataclasses.replace(films, notes={**films.notes, "asked": len(films)})
    own: dict[str, Any] = {"films": films, "errors": errors, "check": 2, "nthread": 1}
    clone = train_clone(push, CloneConfig(batch=8), Run(tmp_path / "bc", steps=3, **own))
    assert clone["true_steps"] == len(films) * push.steps
    assert clone["films"]["digest"] == films.digest and clone["films"]["errors"] is errors
    config = ApgConfig(batch=2)
    begun: dict[str, Any] = {**own, "start": tmp_path / "bc"}
    whole = train_apg(push, config, Run(tmp_path / "whole", steps=2, **begun))
    train_apg(push, config, Run(tmp_path / "parts", steps=1, **begun))
    parts = train_apg(push, config, Run(tmp_path / "parts", steps=2, resume=True, **begun))
    # the films' steps are counted once: the clone has seen the same
    assert whole["true_steps"] == parts["true_steps"] > len(films) * push.steps
    # it has never seen other densities than the nominal ones, and is evaluated so
    judged = workflows.evaluate(
        tmp_path / "whole", None, randomize=None, episodes=1, seeds=[0], model="learned",
        threads=1, device="cpu",
    )  # fmt: skip
    assert judged["observe"] == "nominal" and "model" not in judged
    assert Agent.of(tmp_path / "whole", push.name).nominal
    one, other = ((tmp_path / n / "training.safetensors") for n in ("whole", "parts"))
    for name, tensor in load_file(str(one)).items():
        assert torch.equal(tensor, load_file(str(other))[name]), name


@pytest.mark.parametrize("notes", ["null", "[]", "[" * 5000])
def test_films_whose_notes_are_no_notes_are_refused(
    push: PushProblem, films: Films, tmp_path: Path, notes: str
) -> None:
    path = tmp_path / "films.safetensors"
    save_file(dict(films.arrays), str(path), {"schema": SCHEMA, "notes": notes})
    with pytest.raises(InputError, match=r"films\.safetensors"):
        Films.load(path, push)


def test_films_that_say_of_other_bodies_whether_they_were_seen_are_refused(
    push: PushProblem, films: Films, tmp_path: Path
) -> None:
    path = tmp_path / "films.safetensors"
    dataclasses.replace(films, seen=films.seen[..., :1]).save(path)
    with pytest.raises(InputError, match="seen has shape"):
        Films.load(path, push)
