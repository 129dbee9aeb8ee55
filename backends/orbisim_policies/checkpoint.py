"""A policy on disk: safetensors with a JSON manifest; nothing is pickled."""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path
from typing import Any

import torch
from orbisim_world_model.plain import checked
from safetensors import SafetensorError
from safetensors.torch import load_file, save_file

from orbisim.errors import InputError
from orbisim.files.reading import read_json, size_of
from orbisim.files.writing import make_folder, writing
from orbisim.scene import Scene
from orbisim_policies.latent import LatentConfig, LatentPolicy
from orbisim_policies.network import NetworkConfig, Policy
from orbisim_policies.problem import Problem

AnyPolicy = Policy | LatentPolicy

SCHEMA = "orbisim.policy/1"
MANIFEST, WEIGHTS = "manifest.json", "policy.safetensors"


@dataclasses.dataclass(frozen=True)
class Known:
    """What a manifest must say of a policy.

    Either `network`, of one that remembers nothing, or `latent` (DreamerV3).
    """

    task: str
    scene_hash: str
    observations: int
    actions: int
    steps: int
    network: NetworkConfig | None = None
    latent: LatentConfig | None = None


def save_policy(folder: Path, policy: AnyPolicy, problem: Problem, notes: dict[str, Any]) -> None:
    """Writes a policy; a reader never sees half of one.

    Args:
      folder: where to. policy, problem: what to write, and what it is for.
      notes: more of the manifest: method, training, evaluation.
    """
    make_folder(folder)
    known = Known(
        problem.name,
        problem.scene.fingerprint,
        problem.observations,
        problem.actions,
        problem.steps,
        policy.config if isinstance(policy, Policy) else None,
        policy.config if isinstance(policy, LatentPolicy) else None,
    )
    fields = {name: value for name, value in dataclasses.asdict(known).items() if value is not None}
    header = {"schema": SCHEMA, **fields, **notes}
    tensors = {n: t.detach().float().cpu().contiguous() for n, t in policy.state_dict().items()}
    with (
        writing(folder / MANIFEST, announce=False) as manifest,
        writing(folder / WEIGHTS, announce=False) as weights,  # the first to appear
    ):
        save_file(tensors, str(weights))
        manifest.write_text(json.dumps(header, indent=1))


def read_manifest(folder: str | Path) -> dict[str, Any]:
    """The manifest of a policy.

    Raises:
      InputError: there is none, or it is of something else.
    """
    path = Path(folder) / MANIFEST
    try:
        manifest = read_json(path)
    except InputError as error:
        raise InputError(f"{folder}: not a policy ({error})") from None
    if manifest.get("schema") != SCHEMA:
        raise InputError(f"{path}: not the manifest of a policy ({SCHEMA})")
    return manifest


def load_policy(folder: str | Path, problem: Problem) -> AnyPolicy:
    """Reads a policy for a problem.

    Raises:
      InputError: it is damaged, or for another task or scene.
    """
    manifest = read_manifest(folder)
    path = f"{Path(folder) / MANIFEST}"
    fields = {f.name: manifest[f.name] for f in dataclasses.fields(Known) if f.name in manifest}
    known = checked(Known, fields, path)
    _check_scene(folder, known, problem)
    sizes = (known.observations, known.actions)
    if sizes != (problem.observations, problem.actions):
        raise InputError(
            f"{path}: a policy from {sizes[0]} observations to {sizes[1]} actions; {problem.name} "
            f"has {problem.observations} and {problem.actions}"
        )
    if (known.network is None) == (known.latent is None):
        raise InputError(f"{path}: a policy has either a 'network' or a 'latent' entry")
    policy: AnyPolicy
    if known.latent is not None:
        policy = LatentPolicy(*sizes, known.latent)
    else:
        assert known.network is not None
        policy = Policy(*sizes, known.network)
    weights = Path(folder) / WEIGHTS
    try:
        size_of(weights)
        tensors = load_file(str(weights))
        if not all(torch.isfinite(tensor).all() for tensor in tensors.values()):
            raise ValueError("its weights are not finite")
        policy.load_state_dict(tensors)
    except (OSError, SafetensorError, ValueError, RuntimeError) as error:
        reason = " ".join(str(error).split())[:200]
        raise InputError(f"{weights}: damaged ({reason})") from None
    return policy.eval()


def _check_scene(folder: str | Path, known: Known, problem: Problem) -> None:
    if known.task != problem.name:
        raise InputError(f"{folder}: a policy for {known.task}; got {problem.name}")
    check_scene(folder, known.scene_hash, problem.scene)


def check_scene(folder: str | Path, scene_hash: str, scene: Scene) -> None:
    """Refuses a policy for another scene.

    Raises:
      InputError: its scene's hash is another.
    """
    if scene_hash != scene.fingerprint:
        raise InputError(
            f"{folder}: was trained for another scene than {scene.name!r} (hash "
            f"{scene_hash[:12]}, this one has {scene.fingerprint[:12]}); train it on this one: "
            "orbisim train policy"
        )
