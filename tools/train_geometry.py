"""Trains the encoder of shapes on the parts of generated mechanisms, and looks for neighbours.

    python tools/train_geometry.py --out checkpoints/geometry --updates 20000 --device cuda

Trained on instances 0 to 19 of seven families; instances 20 to 23, and the families that are held
out, are only looked at. Pretext: signed distance and direction of the surface at points about the
part (Smooth-l1 and cosine). Retrieval: whether the nearest token of another instance belongs to the
same part (`door leaf`) of the same family.
"""

from __future__ import annotations

import argparse
import dataclasses
import json
import time
from pathlib import Path

import numpy as np
import numpy.typing as npt
import torch
import trimesh
from orbisim_world_model.geometry import (
    DistanceHead,
    GeometryEncoder,
    GeometryTokens,
    neighbourhoods,
    save_encoder,
    surface_points,
)

from orbisim.tasks.domains import HELD_OUT_MECHANISMS
from orbisim.tasks.mechanisms.catalogue import FAMILIES, HELD_OUT, INSTANCES, make
from orbisim.tasks.mechanisms.solids import surface

Floats = npt.NDArray[np.float64]
QUERIES = 2048
"""Points about a part."""
ASKED = 512
"""... of which an update sees so many, drawn anew."""
CLOUDS = 4
"""Samples of each part's surface that are trained on; one is drawn anew for each update."""
SPREAD = 0.1
"""Standard deviation of the distance of three in four of them from the surface, by the size."""


@dataclasses.dataclass(frozen=True, eq=False)
class Shape:
    """A part: its label, instance and mesh; samples of its surface [CLOUDS, POINTS, 6], and
    distance and direction at queries."""

    family: str
    label: str
    number: int
    mesh: trimesh.Trimesh
    points: npt.NDArray[np.float32]
    queries: npt.NDArray[np.float32]
    answers: npt.NDArray[np.float32]


def distances(solids: list[trimesh.Trimesh], places: Floats) -> Floats:
    """Signed distance [Q] and direction away from the surface [Q, 3], of a union of convex solids.

    Outside, that of the nearest solid; inside, the depth below the nearest face of the solid that
    the point is deepest in.
    """
    best = np.full(len(places), np.inf)
    away = np.zeros((len(places), 3))
    for mesh in solids:
        over = places @ mesh.face_normals.T - (mesh.face_normals * mesh.triangles[:, 0]).sum(1)
        face, distance = over.argmax(axis=1), over.max(axis=1)
        direction = np.array(mesh.face_normals[face])
        out = distance > 0
        if out.any():
            closest, length, _ = trimesh.proximity.closest_point(mesh, places[out])
            distance[out] = length
            gap = places[out] - closest
            direction[out] = gap / np.maximum(np.linalg.norm(gap, axis=1, keepdims=True), 1e-12)
        nearer = distance < best
        best[nearer], away[nearer] = distance[nearer], direction[nearer]
    return np.concatenate([best[:, None], away], axis=1)


def shapes(families: list[str], numbers: range, seed: int) -> list[Shape]:
    """All parts of some instances."""
    rng, found = np.random.default_rng(seed), list[Shape]()
    for family in families:
        for number in numbers:
            for part in make(family, number).parts:
                mesh = surface(part.solids)
                cloud = surface_points(mesh, seed)
                near = cloud.points[rng.integers(len(cloud.points), size=QUERIES), :3]
                queries = near + SPREAD * rng.standard_normal((QUERIES, 3))
                queries[: QUERIES // 4] = rng.uniform(-1.1, 1.1, (QUERIES // 4, 3))
                solids = [solid.mesh() for solid in part.solids]
                answers = distances(solids, queries * cloud.size + cloud.centre)
                answers[:, 0] /= cloud.size
                rows = (queries.astype(np.float32), answers.astype(np.float32))
                clouds = [cloud, *(surface_points(mesh, seed + k) for k in range(1, CLOUDS))]
                points = np.stack([one.points for one in clouds])
                label = f"{family} {part.name}"
                found.append(Shape(family, label, number, mesh, points, *rows))
    return found


def tensors(some: list[Shape]) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
    """Points, queries and answers, stacked."""
    names = ("points", "queries", "answers")
    points, queries, answers = (
        torch.from_numpy(np.stack([getattr(one, name) for one in some])) for name in names
    )
    return points, queries, answers


def train(
    some: list[Shape], updates: int, seed: int, device: str = "cpu"
) -> tuple[GeometryEncoder, DistanceHead]:
    """Encoder and head after so many updates, on the CPU again."""
    torch.manual_seed(seed)
    encoder, head = GeometryEncoder().to(device), DistanceHead().to(device)
    weights = [*encoder.parameters(), *head.parameters()]
    optimizer = torch.optim.AdamW(weights, lr=2e-3)
    points, queries, answers = (rows.to(device) for rows in tensors(some))
    # what lies about the centres depends on no weight: found once, not in each update
    found = [neighbourhoods(one) for one in points.flatten(0, 1).split(64)]
    around, centres = (
        torch.cat(rows).unflatten(0, (-1, CLOUDS)) for rows in zip(*found, strict=True)
    )
    began = time.monotonic()
    for update in range(updates):
        past = update / updates
        for group in optimizer.param_groups:
            group["lr"] = 2e-3 * 0.5 * (1 + np.cos(np.pi * past)) + 1e-5
        pick = torch.randint(len(points), (24,), device=device)
        cloud = torch.randint(CLOUDS, (24,), device=device)
        asked = torch.randint(QUERIES, (24, ASKED), device=device)
        here, truth = queries[pick[:, None], asked], answers[pick[:, None], asked]
        told = head(encoder.encoded(around[pick, cloud], centres[pick, cloud]), here)
        loss = torch.nn.functional.smooth_l1_loss(told[..., 0], truth[..., 0], beta=0.02)
        cosine = torch.cosine_similarity(told[..., 1:], truth[..., 1:], dim=-1)
        (10 * loss + 0.1 * (1 - cosine).mean()).backward()
        torch.nn.utils.clip_grad_norm_(weights, 1.0)
        optimizer.step()
        optimizer.zero_grad()
        if (update + 1) % 500 == 0:
            line = {"update": update + 1, "distance": float(loss.detach())}
            print(json.dumps({**line, "seconds": round(time.monotonic() - began)}), flush=True)
    return encoder.cpu(), head.cpu()


@torch.no_grad()
def errors(encoder: GeometryEncoder, head: DistanceHead, some: list[Shape]) -> dict[str, float]:
    """Of distances, in units of the size, and of directions, in degrees; median and 90 %."""
    points, queries, answers = tensors(some)
    told = torch.cat(
        [
            head(encoder(p[:, 0]), q)
            for p, q in zip(points.split(32), queries.split(32), strict=True)
        ]
    )
    gap = (told[..., 0] - answers[..., 0]).abs().numpy()
    cosine = torch.cosine_similarity(told[..., 1:], answers[..., 1:], dim=-1).clamp(-1, 1)
    angle = np.degrees(np.arccos(cosine.numpy()))
    rows = {"distance": gap, "direction_deg": angle}
    return {
        f"{name}_{share}": float(np.quantile(values, float(share) / 100))
        for name, values in rows.items()
        for share in ("50", "90")
    }


def retrieval(tokens: GeometryTokens, asked: list[Shape], known: list[Shape]) -> float:
    """Share of parts whose nearest token of another instance is that of the same part."""
    every = np.stack([tokens(one.mesh) for one in known])
    spread = every.std(axis=0) + 1e-6
    right = 0
    for one in asked:
        far = np.linalg.norm((every - tokens(one.mesh)) / spread, axis=1)
        own = [(o.family, o.number) == (one.family, one.number) for o in known]
        far[np.array(own)] = np.inf
        right += known[int(far.argmin())].label == one.label
    return right / len(asked)


def main() -> None:
    """The command."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--updates", type=int, default=2000)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--device", default="cpu")
    options = parser.parse_args()
    seen = [family for family in FAMILIES if family not in HELD_OUT_MECHANISMS]
    first = INSTANCES - HELD_OUT
    sets = {
        "trained on": shapes(seen, range(first), options.seed),
        "unseen instances": shapes(seen, range(first, INSTANCES), options.seed + 1),
        "unseen families": shapes(list(HELD_OUT_MECHANISMS), range(INSTANCES), options.seed + 2),
    }
    encoder, head = train(sets["trained on"], options.updates, options.seed, options.device)
    options.out.mkdir(parents=True, exist_ok=True)
    path = options.out / "geometry.safetensors"
    save_encoder(encoder, path)
    tokens, begun = GeometryTokens(encoder), GeometryTokens(GeometryEncoder())
    every = [*sets["trained on"], *sets["unseen families"]]
    print(json.dumps({"updates": options.updates, "bytes": path.stat().st_size}), flush=True)
    for name, some in sets.items():
        found = errors(encoder, head, some)
        found["retrieval"] = retrieval(tokens, some, every)
        found["retrieval_untrained"] = retrieval(begun, some, every)
        print(json.dumps({"set": name, "parts": len(some), **found}), flush=True)


if __name__ == "__main__":
    main()
