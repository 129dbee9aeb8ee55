"""Sizes and colours of bodies, fitted to a frame together with where they are."""

from __future__ import annotations

import copy
import dataclasses
from collections.abc import Sequence
from typing import NamedTuple

import mujoco
import numpy as np
import numpy.typing as npt
import torch
from scipy.optimize import linear_sum_assignment

from orbisim.errors import UnsupportedSceneError
from orbisim_diffusion.estimate import SURE
from orbisim_diffusion.levenberg import Prior, fit
from orbisim_diffusion.likeness import unlikeness
from orbisim_diffusion.refine import ALIKE, NOISE, Frame, Refiner
from orbisim_diffusion.resting import Body, at_rest, directions, window
from orbisim_diffusion.solids import Solids, View
from orbisim_diffusion.synthesis import Eye
from orbisim_diffusion.tracking import Reading

Floats = npt.NDArray[np.float64]

_SCALE = 0.15
"""Prior of a size's logarithm about a first guess, as a standard deviation. It is wide: it keeps
what a frame does not show from running away."""
_STEPS, _ROUNDS = 12, 2
"""Steps of a fit; every body is fitted anew with the others' new looks."""
_DULL = 0.02
"""Darkest colour: the search for a body by its colour divides by it."""
_INSIDE, _BRIGHT, _FEW = 0.98, 0.985, 3
"""A pixel tells a colour where a body has so much of it and the channel is not at its end; so many
have to."""
_LIT = 0.1
"""Of the light that falls on a pixel; with less it says nothing of a colour."""
_TEST = 0.2
"""Colour that a body is drawn in to see how light falls on it; bright enough, and never cut off."""
_TINT = 0.006
"""Standard deviation of colours that stays however many pixels there are: 0.005 in the mean and
0.016 at most where 36 cubes of MuJoCo's images were read at their true places, for drawing is not
quite MuJoCo's."""


class Look(NamedTuple):
    """What a body looks like.

    Attributes:
      half: [3] half sizes of its bounding box, m. colour: [3], 0 to 1.
      half_std, colour_std: [3] standard deviations; infinite where it is not seen.
    """

    half: Floats
    colour: Floats
    half_std: Floats
    colour_std: Floats


class ScaledEye(Eye):
    """An eye whose states [nq + 1] go on with the logarithm of the scale of one body.

    Args:
      eye: of the scene. body: of one geom, which is scaled.
    """

    def __init__(self, eye: Eye, body: Body) -> None:
        self.__dict__.update(eye.__dict__)
        self._plain, self._body, self._nq, self._nv = eye, body, eye.model.nq, eye.model.nv

    def placed(self, qpos: Floats) -> tuple[Solids, View]:
        """Geoms and camera of states [B, nq + 1]."""
        solids, view = super().placed(qpos[:, : self._nq])
        size, geom = solids.size.clone(), int(self._body.geoms[0])
        size[:, geom] = size[:, geom] * torch.as_tensor(qpos[:, self._nq :]).float().exp()
        return solids._replace(size=size), view

    def moved(self, qpos: Floats, change: Floats) -> Floats:
        """States [..., nq + 1] after changes [..., nv + 1]."""
        pose = super().moved(qpos[..., : self._nq], change[..., : self._nv])
        scale = qpos[..., self._nq :] + change[..., self._nv :]
        after: Floats = np.concatenate([pose, scale], axis=-1)
        return after

    def speeds(self, qpos: Floats, directions: Floats) -> Floats:
        """[B, k] pixels by which the fastest outline moves for one unit of each [B, nv + 1, k]."""
        found = self._plain.speeds(qpos[:, : self._nq], directions[:, : self._nv])
        solids, view = self.placed(qpos)
        depth = (view.pos - solids.pos[:, int(self._body.geoms[0])]).norm(dim=-1).clamp_min(0.05)
        half = float(np.linalg.norm(self._body.half))
        reach = (self.size * view.focal[:, 1] * half / depth).numpy()
        fastest: Floats = np.maximum(found, np.abs(directions[:, self._nv]) * reach[:, None])
        return fastest


class LookFitter:
    """Finds looks of a scene's free bodies in frames, from what a network reads.

    A body's proportions stay as they are declared; its scale and its colour are free. Where both
    are, nothing tells which body is which: they are the objects that the network is surest of.

    Args:
      refiner: of the scene and the camera; its bodies get the looks. sizes, colours: what is free.

    Raises:
      UnsupportedSceneError: a free body is not one geom about the body's origin.
    """

    def __init__(self, refiner: Refiner, sizes: bool, colours: bool) -> None:
        self.refiner, self.sizes, self.colours = refiner, sizes, colours
        eye = refiner.eye
        eye.model = refiner.model = copy.copy(eye.model)  # sizes are written into it
        eye._data = mujoco.MjData(eye.model)
        self.declared = refiner.bodies
        for body in refiner.bodies:
            if len(body.geoms) != 1 or np.abs(body.centre).max() > 1e-6:
                raise UnsupportedSceneError(
                    eye.model.body(int(eye.model.geom_bodyid[self._geom(body)])).name,
                    "sizes and colours are fitted for bodies of one geom about their origin",
                )

    def _geom(self, body: Body) -> int:
        return int(self.refiner.eye.rows[int(body.geoms[0]), 8])

    def set_look(self, number: int, scale: float, colour: Floats) -> None:
        """Gives a body a size, as a multiple of the declared one, and a colour [3]."""
        refiner, body = self.refiner, self.declared[number]
        eye, place, geom = refiner.eye, int(body.geoms[0]), self._geom(self.declared[number])
        size = scale * eye.rows[place, 1:4]
        eye._rows[place, 1:4] = torch.as_tensor(size).float()
        eye._rows[place, 4:7] = torch.as_tensor(colour).float()
        eye.model.geom_size[geom] = size
        eye.model.geom_aabb[geom, 3:] = scale * body.half
        eye.model.geom_rbound[geom] = float(np.linalg.norm(scale * body.half))
        changed = dataclasses.replace(body, half=scale * body.half, colour=np.array(colour))
        bodies = list(refiner.bodies)
        bodies[number] = changed
        refiner.bodies = tuple(bodies)

    def first(
        self,
        frame: npt.NDArray[np.uint8],
        read: Reading,
        t: int,
        before: Sequence[Look] | None = None,
    ) -> tuple[Frame, tuple[Look, ...]]:
        """What frame t shows by itself, and the looks of its bodies.

        Args:
          frame: [H, W, 3]. read: what a network reads off frames. t: which of them this one is.
          before: looks found in another frame, to start from and to tell bodies apart.
        """
        places: list[list[Floats]] = [[] for _ in self.declared]
        for i, slot in enumerate(self.slots(read, t, before)):
            if slot is None:
                continue
            body = self.declared[i]
            half, colour = read.sizes[t, slot], read.colours[t, slot]
            if before is not None:
                half, colour = before[i].half, before[i].colour
            scale = float(np.exp(np.log(half / body.half).mean())) if self.sizes else 1.0
            self.set_look(i, scale, colour.clip(_DULL, 1.0) if self.colours else body.colour)
            places[i] = [read.places[t, slot]]
        found = self.refiner.first(frame, read.joints[t], places, read.joints[t])
        looks = [self._unseen(i) for i in range(len(self.declared))]
        for k in range(_ROUNDS):
            for i, pose in enumerate(found.objects):
                if pose.seen:
                    if self.colours:
                        looks[i] = self._shaded(frame, found, i, looks[i])
                    if self.sizes:
                        found, looks[i] = self._sized(frame, found, i, looks[i], wide=not k)
        # poses once more with the looks that were found
        places = [[pose.qpos] for pose in found.objects]
        joints = found.qpos[self.refiner.scalar.qpos]
        return self.refiner.first(frame, joints, places, read.joints[t]), tuple(looks)

    def slots(
        self, read: Reading, t: int, before: Sequence[Look] | None = None
    ) -> list[int | None]:
        """Which of the objects that a network sees in frame t each body is.

        By what is declared of sizes and colours or was found before, and by how sure it is.
        """
        known = [before[i].half if before else b.half for i, b in enumerate(self.declared)]
        shades = [before[i].colour if before else b.colour for i, b in enumerate(self.declared)]
        sizes, colours = read.sizes[t], read.colours[t]
        told, count = before is not None, len(sizes)
        cost = np.zeros((len(known), count))
        for i in range(len(known)):
            cost[i] = unlikeness(
                read.places[t, :, :3],
                sizes if told or not self.sizes else np.tile(known[i], (count, 1)),
                colours if told or not self.colours else np.tile(shades[i], (count, 1)),
                np.full((1, 3), np.nan),
                known[i][None],
                shades[i][None],
            )[0]
        cost -= np.minimum(read.present[t], SURE)
        found: list[int | None] = [None] * len(known)
        for i, slot in zip(*linear_sum_assignment(cost), strict=True):
            found[int(i)] = int(slot)
        return found

    def _unseen(self, number: int) -> Look:
        body, none = self.refiner.bodies[number], np.full(3, np.inf)
        return Look(body.half, body.colour, none, none)

    def _shaded(self, frame: npt.NDArray[np.uint8], found: Frame, number: int, look: Look) -> Look:
        """The colour of a body: a pixel's is linear in it, given the light that falls there.

        The median over the pixels that the body fills, weighted by their light: a few that lie in
        a shadow whose edge is drawn a little elsewhere do not count.
        """
        refiner, body = self.refiner, self.refiner.bodies[number]
        eye, place = refiner.eye, int(body.geoms[0])
        geoms = refiner.shown([i for i, pose in enumerate(found.objects) if pose.seen])
        pixels = window(refiner.view, refiner.size, body, found.objects[number].qpos[:3], 1.5)
        before, drawn = eye._rows[place, 4:7].clone(), []
        for shade in (0.0, _TEST):
            eye._rows[place, 4:7] = shade
            drawn.append(eye.draw(found.qpos[None], pixels, geoms))
        eye._rows[place, 4:7] = before
        gloss = drawn[0].pixels[0].double().numpy()
        light = (drawn[1].pixels[0].double().numpy() - gloss) / _TEST
        fills = drawn[0].weight[0, geoms == place][0].numpy() > _INSIDE
        seen = frame.reshape(-1, 3)[pixels.numpy()] / 255.0
        colour, std = look.colour.copy(), np.full(3, np.inf)
        for channel in range(3):
            some = fills & (seen[:, channel] < _BRIGHT) & (light[:, channel] > _LIT)
            if some.sum() < _FEW:
                continue  # as the network has it
            weight = light[some, channel]
            told = (seen[some, channel] - gloss[some, channel]) / weight
            order = np.argsort(told)
            total = np.cumsum(weight[order])
            colour[channel] = told[order][np.searchsorted(total, 0.5 * total[-1])]
            # of a median of normally distributed values, from their median distance
            apart = 1.4826 * np.median(np.abs(told - colour[channel]))
            std[channel] = np.hypot(_TINT, 1.25 * apart * np.sqrt(ALIKE / some.sum()))
        colour = colour.clip(_DULL, 1.0)
        self.set_look(number, float((body.half / self.declared[number].half).mean()), colour)
        return look._replace(colour=colour, colour_std=std)

    def _sized(
        self, frame: npt.NDArray[np.uint8], found: Frame, number: int, look: Look, wide: bool
    ) -> tuple[Frame, Look]:
        """One body's pose and scale together, the rest as it is.

        `wide`: whether they may be pixels off.
        """
        refiner, body = self.refiner, self.refiner.bodies[number]
        model, place = refiner.model, found.objects[number].qpos
        geoms = refiner.shown([i for i, pose in enumerate(found.objects) if pose.seen])
        pixels = window(refiner.view, refiner.size, body, place[:3], 1.5)
        pose = at_rest(body, place, refiner.surfaces, refiner._eye, True)
        pose = pose[int(np.argmin(np.linalg.norm(pose - place, axis=1)))]
        upright = bool(abs(pose[2] - place[2]) < 0.1 * float(body.half.min()))
        start = found.qpos.copy()
        if upright:
            start[body.qpos : body.qpos + 7] = pose
        moves = directions(model.nv, body, start[body.qpos : body.qpos + 7], upright)
        count = moves.shape[1]
        ways = np.zeros((1, model.nv + 1, count + 1))
        ways[0, : model.nv, :count], ways[0, model.nv, count] = moves, 1.0
        if upright:  # what lies on something grows upwards
            ways[0, body.dof + 2, count] = _height(body, start)
        result = fit(
            ScaledEye(refiner.eye, body),
            torch.as_tensor(frame).double() / 255.0,
            pixels,
            np.append(start, 0.0)[None],
            ways,
            noise=NOISE,
            priors=[Prior(np.zeros(count + 1), np.array([np.inf] * count + [_SCALE]))],
            geoms=geoms,
            steps=_STEPS,
            wide=wide,
        )
        qpos, grown = result.qpos[0, : model.nq], float(np.exp(result.qpos[0, model.nq]))
        declared, half = self.declared[number].half, grown * body.half
        self.set_look(number, float((half / declared).mean()), body.colour)
        objects = list(found.objects)
        objects[number] = objects[number]._replace(qpos=qpos[body.qpos : body.qpos + 7].copy())
        std = float(np.sqrt(ALIKE * np.linalg.inv(result.precision[0])[count, count]))
        # outlines are drawn otherwise, as far as for a pose
        spread = np.hypot(std * half, refiner.outline(body, qpos[body.qpos : body.qpos + 3])[0])
        look = look._replace(half=half, half_std=spread)
        return found._replace(qpos=qpos, objects=tuple(objects)), look


def _height(body: Body, qpos: Floats) -> float:
    """Of a body's middle above its lowest point, m."""
    turn = np.zeros(9)
    mujoco.mju_quat2Mat(turn, qpos[body.qpos + 3 : body.qpos + 7])
    return float((np.abs(turn.reshape(3, 3)) @ body.half)[2])


def together(looks: list[tuple[Look, ...]]) -> tuple[Look, ...]:
    """One look of each body from those of several frames, weighted by their variances.

    Frames err alike, so that the standard deviation does not fall below the least of them.
    """
    found = []
    for of in zip(*looks, strict=True):
        values = []
        for name in ("half", "colour"):
            value = np.stack([getattr(one, name) for one in of])
            std = np.stack([getattr(one, f"{name}_std") for one in of])
            share = np.where(np.isfinite(std), 1.0 / np.maximum(std, 1e-6) ** 2, 0.0)
            none = share.sum(0) <= 0
            share = np.where(none, 1.0, share)
            values.append(((share * value).sum(0) / share.sum(0), std.min(0)))
        found.append(Look(values[0][0], values[1][0], values[0][1], values[1][1]))
    return tuple(found)


def fit_looks(
    fitter: LookFitter, frames: npt.NDArray[np.uint8], read: Reading, count: int = 5
) -> tuple[Look, ...]:
    """Looks of a video's bodies, from frames spread over it; the refiner's bodies get them.

    Args:
      fitter: of the refiner that will follow the bodies. frames: [T, H, W, 3].
      read: what a network reads off them. count: frames that are looked at.
    """
    looks: list[tuple[Look, ...]] = []
    for t in np.unique(np.linspace(0, len(frames) - 1, count).round().astype(int)):
        before = together(looks) if looks else None
        looks.append(fitter.first(frames[t], read, int(t), before)[1])
    found = together(looks)
    for i, look in enumerate(found):
        scale = float((look.half / fitter.declared[i].half).mean())
        fitter.set_look(i, scale, look.colour)
    return found
