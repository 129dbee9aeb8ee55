"""`Guard`: notices, at every step, worlds that diverge and entities outside the training data."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, NamedTuple, TypeVar

import mujoco
import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor

from orbisim_world_model.entities import Entities
from orbisim_world_model.layout import Layout

_FAR = 1e4
"""m or rad: no scene of a learned model is that large."""
_FASTEST = 100.0
"""Times the largest speed in training, where a rollout itself began beyond `_FAST` of it."""
_FAST, _LIFTED = 10.0, 12.0
"""Times the largest speed in training, and the largest energy that such a speed and the heights in
training make together, that no physical state reaches: contacts and gravity only hand on what
motors gave, and the motors are those of the training data."""
_PAST = 0.1
"""Share of a joint's range by which its soft limits can be passed, and then some."""
_PUSHED = 0.3
"""The same of robots of limbs, whose data are of many robots: how far motors push joints of the
suite past their limits in C MuJoCo at most (walker's ankles: 0.29 of their range)."""
_BEYOND, _SLACK, _TINY = 2.0, 0.05, 1e-3
"""Times the largest speed in training, share of a range, and SI units, beyond which a state lies
outside the training data: a density thins out, it has no edge."""
_GRAVITY = 9.81  # m/s^2, MuJoCo's default, of checkpoints that were trained with no other

States = TypeVar("States", bound=tuple[Tensor, ...])


class Notice(NamedTuple):
    """What was noticed of a rollout [T, B, K entities].

    Attributes:
      diverged_at: [B] first step whose result is no state, -1 for none.
      entity: [B] the entity that gave it away.
      outside_at: [B, K] first step at which an entity lies outside the training data, -1 for none.
    """

    diverged_at: npt.NDArray[np.int64]
    entity: npt.NDArray[np.int64]
    outside_at: npt.NDArray[np.int64]


class Guard:
    """Bounds from the ranges in a checkpoint's manifest, and from a scene's joint limits.

    Entities are the robot, if there is one, and the objects.

    Args:
      manifest: of the checkpoint. layout: of the scene.
      model: of the scene; without it joints have no limits.
    """

    def __init__(
        self, manifest: dict[str, Any], layout: Layout, model: mujoco.MjModel | None = None
    ) -> None:
        self.ranges, self.layout = manifest["ranges"], layout
        self.names = (("robot",) if layout.has_robot else ()) + layout.objects
        self.joint_limits = _joint_limits(layout, self.ranges, model)
        self.speeds = {
            name: float(self.ranges[name])
            for name in ("joint_speed", "object_speed", "object_turning")
        }
        low, high = self.ranges["object_position"].get("z", (0.0, 0.0))
        self.gravity, self.floor = _gravity(self.ranges), low
        speed = max(self.speeds["object_speed"], 1.0)
        # J/kg; a height of at least a box's
        self.energy = _LIFTED * (self.gravity * max(high - low, 0.05) + 0.5 * speed**2)
        self._low, self._high = self._row_bounds()
        self._on: dict[torch.device, tuple[Tensor, Tensor, Tensor]] = {}

    # -- a whole rollout -----------------------------------------------------------------------

    @torch.no_grad()  # type: ignore[untyped-decorator]
    def watch(self, states: Entities, start: Entities) -> Notice:
        """What there is to say of states [T, B, ...] that follow from `start` [B, ...]."""
        lost, outside = self.lost(states, start), self.outside(states)
        first = first_marked(lost.any(-1))
        which = lost[first.clamp_min(0), torch.arange(lost.shape[1], device=lost.device)]
        entity = which.to(torch.int8).argmax(-1)
        found = torch.cat([first[:, None], entity[:, None], first_marked(outside)], dim=1)
        host = np.asarray(found.cpu().numpy(), np.int64)  # one transfer
        return Notice(host[:, 0], host[:, 1], host[:, 2:])

    def lost(self, x: Entities, start: Entities) -> Tensor:
        """[..., K]: entities in states that are none: not finite, or past what physics allows.

        An entity that began beyond a bound may stay there, but not go on from there.
        """
        robot = _all(x.v.abs() < self._fast("joint_speed", start.v)[..., None])
        robot = robot & self._in_limits(x.q) & _all(x.act.abs() < _FAR)
        parts = [robot[..., None]] if self.layout.has_robot else []
        if self.layout.objects:
            good = (x.pos.abs() < _FAR).all(-1) & torch.isfinite(x.quat).all(-1)
            good &= (x.vel.abs() < self._fast("object_speed", start.vel)[..., None]).all(-1)
            good &= (x.ang.abs() < self._fast("object_turning", start.ang)[..., None]).all(-1)
            good &= self._energy(x) <= self._energy(start).mul(1.05).clamp_min(self.energy)
            parts.append(good)
        return ~torch.cat(parts, dim=-1)

    def outside(self, x: Entities) -> Tensor:
        """[..., K]: entities whose state lies outside the training data."""
        low, high, _ = self._tensors(x.pos.device)
        q, v, pos, vel, ang = (x.q, x.v, x.pos, x.vel, x.ang)
        j = q.shape[-1]
        parts = []
        if self.layout.has_robot:
            inside = _all((q >= low[:j]) & (q <= high[:j]))
            parts.append((inside & _all(v.abs() <= self._speed("joint_speed")))[..., None])
        if self.layout.objects:
            inside = ((pos >= low[j:]) & (pos <= high[j:])).all(-1)
            inside &= (vel.abs() <= self._speed("object_speed")).all(-1)
            inside &= (ang.abs() <= self._speed("object_turning")).all(-1)
            parts.append(inside)
        return ~torch.cat(parts, dim=-1)

    # -- one world, as NumPy rows ----------------------------------------------------------------

    def calm(self, qpos: Any, qvel: Any, act: Any) -> bool:
        """Whether one world's coordinates [1, nq], [1, nv], [1, na] are well within all bounds.

        Never true where `lost` or `outside` would be; those say what is the matter.
        """
        row = np.concatenate([qpos[0], qvel[0], act[0]])
        return bool(((row >= self._low) & (row <= self._high)).all())  # of NaN this is false

    # -- in words ------------------------------------------------------------------------------

    def concerns(self, x: Entities) -> list[str]:
        """What of the states [B, ...] lies outside the training data, one line each."""
        return [*self._of_robot(x.q, x.v), *self._of_objects(x.pos, x.vel, x.ang)]

    def concern(self, x: Entities, world: int, entity: int) -> str:
        """What is the matter with one entity of one world of states [B, ...]."""
        first = int(self.layout.has_robot)
        if entity < first:
            said = self._of_robot(*(f[world : world + 1] for f in (x.q, x.v)))
        else:
            said = self._of_objects(*(f[world, entity - first] for f in (x.pos, x.vel, x.ang)))
        return "; ".join(said) or "its state is no number"

    def _of_robot(self, q: Tensor, v: Tensor) -> Iterator[str]:
        for index, name in enumerate(self.layout.joints):
            if self.layout.bounded[index] and index not in self.layout.parts:
                yield from _described(f"joint {name!r}", q[:, index], self.ranges["joints"][name])
        yield from self._too_fast("joint_speed", v)

    def _of_objects(self, pos: Tensor, vel: Tensor, ang: Tensor) -> Iterator[str]:
        for axis, bounds in self.ranges["object_position"].items():
            if axis == "z" or not self.layout.invariant:
                yield from _described(f"an object's {axis}", pos[..., "xyz".index(axis)], bounds)
        yield from self._too_fast("object_speed", vel)
        yield from self._too_fast("object_turning", ang)

    def _too_fast(self, name: str, values: Tensor) -> Iterator[str]:
        largest = float(values.abs().max()) if values.numel() else 0.0
        if largest > self._speed(name):
            what = name.replace("_", " ")
            yield f"{what} is {largest:.3g} (trained up to {self.ranges[name]:.3g})"

    # -- bounds --------------------------------------------------------------------------------

    def _speed(self, name: str) -> float:
        """The speed from which on a state lies outside the training data."""
        return _BEYOND * self.speeds[name] + _TINY

    def _fast(self, name: str, start: Tensor) -> Tensor:
        """[...]: the speed that no state of a rollout reaches, by what it started with."""
        bound = max(self.speeds[name], 1.0)
        began = (
            1.05 * start.abs().amax(-1) if start.shape[-1] else start.new_zeros(start.shape[:-1])
        )
        return began.clamp(_FAST * bound, _FASTEST * bound)

    def _in_limits(self, q: Tensor) -> Tensor:
        _, _, limits = self._tensors(q.device)
        return _all((q > limits[0]) & (q < limits[1]))

    def _energy(self, x: Entities) -> Tensor:
        """[..., N]: potential and kinetic energy of an object's centre, J/kg."""
        return self.gravity * (x.pos[..., 2] - self.floor) + 0.5 * x.vel.square().sum(-1)

    def _tensors(self, device: torch.device) -> tuple[Tensor, Tensor, Tensor]:
        """On a device: `_boxes` and the limits of joints."""
        if device not in self._on:
            parts = (*self._boxes(), self.joint_limits)
            low, high, limits = (torch.tensor(p, dtype=torch.float32).to(device) for p in parts)
            self._on[device] = low, high, limits
        return self._on[device]

    def _boxes(self) -> tuple[tuple[float, ...], tuple[float, ...]]:
        """Lowest and highest joint coordinates and positions [J + 3] of the training data."""
        parts = set(self.layout.parts)  # their ranges are their own, not those of the data
        joints = [
            _widened(self.ranges["joints"][name]) if bounded and j not in parts else (-_FAR, _FAR)
            for j, (name, bounded) in enumerate(
                zip(self.layout.joints, self.layout.bounded, strict=True)
            )
        ]
        axes = [
            _widened(self.ranges["object_position"][axis])
            if self.layout.objects and (axis == "z" or not self.layout.invariant)
            else (-_FAR, _FAR)
            for axis in "xyz"
        ]
        low, high = zip(*joints, *axes, strict=True)
        return low, high

    def _row_bounds(self) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.float64]]:
        """Bounds of the row (qpos, qvel, act) of a world of which there is nothing to say.

        Narrower than those of `outside`, since angular velocities are in bodies' frames here.
        """
        layout = self.layout
        low, high = map(np.asarray, self._boxes())
        joints = len(layout.joints)
        least, most = np.full(layout.nq + layout.nv, -2.0), np.full(layout.nq + layout.nv, 2.0)
        q, v = list(layout.joint_q), [layout.nq + a for a in layout.joint_v]
        limits = np.asarray(self.joint_limits)
        least[q], most[q] = (
            np.maximum(low[:joints], limits[0]),
            np.minimum(high[:joints], limits[1]),
        )
        most[v] = self._speed("joint_speed")
        for at_q, at_v in zip(layout.object_q, layout.object_v, strict=True):
            least[at_q : at_q + 3], most[at_q : at_q + 3] = low[joints:], high[joints:]
            first = layout.nq + at_v
            most[first : first + 3] = self._speed("object_speed")
            most[first + 3 : first + 6] = self._speed("object_turning") / 3**0.5
        least[layout.nq :] = -most[layout.nq :]
        acts = np.full(layout.na, 0.5 * _FAR)
        return np.concatenate([least, -acts]), np.concatenate([most, acts])


def blanked(states: States, diverged_at: npt.NDArray[np.int64]) -> States:
    """States [T, B, ...], a named tuple, with NaN from where a world diverged."""
    if not (diverged_at >= 0).any():
        return states
    device = states[0].device
    first = torch.as_tensor(diverged_at, device=device)
    steps = torch.arange(len(states[0]), device=device)
    gone = (first >= 0) & (steps[:, None] >= first)  # [T, B]

    def blank(field: Tensor) -> Tensor:
        return field.masked_fill(gone.reshape(*gone.shape, *([1] * (field.dim() - 2))), torch.nan)

    return type(states)(*map(blank, states))


def _joint_limits(
    layout: Layout, ranges: dict[str, Any], model: mujoco.MjModel | None
) -> npt.NDArray[np.float64]:
    """[2, J]: coordinates that no joint reaches, rad or m.

    Limits are soft: how far strong motors push past them, the training data know.
    """
    limits = np.array([[-_FAR], [_FAR]]) * np.ones(len(layout.joints))
    for index, name in enumerate(layout.joints):
        if model is not None and model.joint(name).limited[0]:
            low, high = model.joint(name).range
            room = _PAST * (high - low) + 10 * _TINY
            pushed = _PUSHED * (high - low) * layout.articulated
            least, most = low - pushed, high + pushed
            if index not in layout.parts:
                least, most = ranges["joints"][name]
            limits[:, index] = min(low, least) - room, max(high, most) + room
    return limits


def _described(what: str, values: Tensor, bounds: list[float]) -> Iterator[str]:
    if not values.numel():
        return
    low, high = _widened(bounds)
    least, most = float(values.min()), float(values.max())
    if not (low <= least and most <= high):
        value = most if low <= least else least
        yield f"{what} is at {value:.3g} (trained on {bounds[0]:.3g} to {bounds[1]:.3g})"


def _widened(bounds: list[float]) -> tuple[float, float]:
    low, high = bounds
    slack = _SLACK * (high - low) + _TINY
    return low - slack, high + slack


def _gravity(ranges: dict[str, Any]) -> float:
    """The largest downward gravity in training, m/s^2."""
    known = ranges.get("settings", {}).get("gravity_z")
    return max(0.0, -known[0]) if known else _GRAVITY


def first_marked(marks: Tensor) -> Tensor:
    """[...] of marks [T, ...]: the first step that is marked, -1 for none."""
    return torch.where(marks.any(0), marks.to(torch.int8).argmax(0), -1)


def _all(marks: Tensor) -> Tensor:
    return marks.all(-1)
