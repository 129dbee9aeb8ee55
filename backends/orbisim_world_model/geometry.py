"""Learned features of a part's shape: surface points with normals to a token of fixed size.

Paper, appendix B.4, uses a pretrained Sonata / Point Transformer V3; here a small encoder in the
manner of PointNet++ (Qi et al. 2017) is trained by `tools/train_geometry.py` to tell the signed
distance and direction of the surface at points about the part, which is what contact needs.
"""

from __future__ import annotations

import dataclasses
import hashlib
from pathlib import Path

import numpy as np
import numpy.typing as npt
import torch
import trimesh
from safetensors.torch import load_file, save_file
from torch import Tensor, nn

from orbisim_world_model.parts import TOKEN

Floats = npt.NDArray[np.float64]
POINTS = 1024
"""Samples of a surface."""
CENTRES, NEIGHBOURS = 64, 24
"""Places at which the first layer looks, and how many points each sees."""
_OWN = 4  # of a token beside the shape's features: the logarithm of its size and its centre


@dataclasses.dataclass(frozen=True, eq=False)
class Cloud:
    """A part's surface.

    Attributes:
      points: [POINTS, 6] places, by `size` about `centre`, and outward normals, both in the part's
        frame. centre: [3], m. size: greatest distance of a vertex from the centre, m.
    """

    points: npt.NDArray[np.float32]
    centre: Floats
    size: float


def surface_points(mesh: trimesh.Trimesh, seed: int = 0) -> Cloud:
    """Samples a surface uniformly by area; the same mesh and seed give the same points.

    Raises:
      ValueError: the mesh has no area.
    """
    if not mesh.area > 0:
        raise ValueError(f"a mesh with a surface is needed; got one of {len(mesh.faces)} faces")
    places, faces = trimesh.sample.sample_surface(mesh, POINTS, seed=seed)
    centre = np.asarray(mesh.bounds.mean(axis=0), np.float64)
    size = float(np.linalg.norm(mesh.vertices - centre, axis=1).max())
    rows = np.concatenate([(places - centre) / size, mesh.face_normals[faces]], axis=1)
    return Cloud(rows.astype(np.float32), centre, size)


def farthest(places: Tensor, count: int) -> Tensor:
    """Numbers [B, count] of points that lie far apart, the first one first; places [B, P, 3]."""
    batch = torch.arange(len(places), device=places.device)
    chosen = torch.zeros(len(places), count, dtype=torch.long, device=places.device)
    gap = torch.full(places.shape[:2], torch.inf, device=places.device)
    for k in range(1, count):
        last = places[batch, chosen[:, k - 1]]
        gap = torch.minimum(gap, (places - last[:, None]).square().sum(-1))
        chosen[:, k] = gap.argmax(dim=1)
    return chosen


class GeometryEncoder(nn.Module):
    """Points with normals [B, POINTS, 6] to features [B, TOKEN - 4].

    Two set abstractions: neighbourhoods of centres that lie far apart, then all centres.
    """

    def __init__(self, width: int = 64) -> None:
        super().__init__()
        self.near = nn.Sequential(
            nn.Linear(9, width),
            nn.GELU(),
            nn.Linear(width, width),
            nn.GELU(),
            nn.Linear(width, width),
        )
        self.far = nn.Sequential(
            nn.Linear(width + 3, 2 * width), nn.GELU(), nn.Linear(2 * width, 2 * width)
        )
        self.out = nn.Linear(2 * width, TOKEN - _OWN)

    def forward(self, points: Tensor) -> Tensor:
        """[B, TOKEN - 4] from points with normals [B, POINTS, 6], as `Cloud` has them."""
        return self.encoded(*neighbourhoods(points))

    def encoded(self, around: Tensor, centres: Tensor) -> Tensor:
        """[B, TOKEN - 4] from what `neighbourhoods` gives, which no weight changes."""
        seen = self.near(around).amax(dim=2)
        features: Tensor = self.out(self.far(torch.cat([seen, centres], dim=-1)).amax(dim=1))
        return features


def neighbourhoods(points: Tensor) -> tuple[Tensor, Tensor]:
    """What centres see: points about them [B, CENTRES, NEIGHBOURS, 9], and centres [B, CENTRES, 3].

    Args:
      points: [B, POINTS, 6], as `Cloud` has them.
    """
    places = points[..., :3]
    batch = torch.arange(len(points), device=points.device)[:, None]
    centres = places[batch, farthest(places, CENTRES)]
    near = torch.cdist(centres, places).topk(NEIGHBOURS, largest=False).indices
    group = points[batch[..., None], near]
    return torch.cat([group[..., :3] - centres[:, :, None], group], dim=-1), centres


class DistanceHead(nn.Module):
    """Signed distance and direction away from the surface, [B, Q, 4], at places [B, Q, 3] beside
    features [B, TOKEN - 4]; in the normalised part's frame."""

    def __init__(self, width: int = 128) -> None:
        super().__init__()
        self.net = nn.Sequential(
            nn.Linear(TOKEN - _OWN + 3, width),
            nn.GELU(),
            nn.Linear(width, width),
            nn.GELU(),
            nn.Linear(width, 4),
        )

    def forward(self, features: Tensor, places: Tensor) -> Tensor:
        """[B, Q, 4]: distance in units of the part's size, and direction (not normalised)."""
        wide = features[:, None].expand(-1, places.shape[1], -1)
        found: Tensor = self.net(torch.cat([wide, places], dim=-1))
        return found


class GeometryTokens:
    """Tokens of parts, each computed once: the cache's key is a hash of the mesh.

    Args:
      encoder: trained.
    """

    def __init__(self, encoder: GeometryEncoder) -> None:
        self._encoder, self._known = encoder.eval(), dict[str, npt.NDArray[np.float32]]()

    def __call__(self, mesh: trimesh.Trimesh) -> npt.NDArray[np.float32]:
        """[TOKEN]: features, log of the size in m, and centre in m."""
        key = mesh_hash(mesh)
        if key not in self._known:
            cloud = surface_points(mesh)
            with torch.no_grad():
                features = self._encoder(torch.from_numpy(cloud.points)[None])[0].numpy()
            own = np.array([np.log(cloud.size), *cloud.centre], np.float32)
            self._known[key] = np.concatenate([features, own])
        return self._known[key]

    def __len__(self) -> int:
        return len(self._known)


def mesh_hash(mesh: trimesh.Trimesh) -> str:
    """Of vertices and faces, in their order."""
    vertices = np.ascontiguousarray(mesh.vertices, np.float64).tobytes()
    return hashlib.sha256(
        vertices + np.ascontiguousarray(mesh.faces, np.int64).tobytes()
    ).hexdigest()


def save_encoder(encoder: GeometryEncoder, path: Path) -> None:
    """Writes the weights in half precision (safetensors)."""
    save_file({name: w.half().contiguous() for name, w in encoder.state_dict().items()}, path)


def load_encoder(path: Path) -> GeometryEncoder:
    """Reads what `save_encoder` wrote.

    Raises:
      RuntimeError: the weights are another network's.
    """
    encoder = GeometryEncoder()
    encoder.load_state_dict({name: w.float() for name, w in load_file(path).items()})
    return encoder
