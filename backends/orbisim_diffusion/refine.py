"""Analysis by synthesis: poses and joints whose image is the frame, near what a network reads."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from typing import NamedTuple, TypedDict

import numpy as np
import numpy.typing as npt
import torch
from scipy import ndimage
from scipy.spatial.transform import Rotation

from orbisim.scene import Scene
from orbisim.scene.visible import ROBOT
from orbisim_diffusion.levenberg import SETTLED, Fit, Prior, cost, fit, losses
from orbisim_diffusion.resting import (
    MARGIN,
    Body,
    at_rest,
    directions,
    free_bodies,
    overlap,
    scalar_joints,
    surfaces,
    window,
)
from orbisim_diffusion.solids import rays
from orbisim_diffusion.synthesis import FINE, Eye
from orbisim_diffusion.turns import Turns

Floats = npt.NDArray[np.float64]
Bools = npt.NDArray[np.bool_]

NOISE = 0.02
"""Of a pixel's value, 0 to 1; what drawing cannot say of a rendered image is 0.03 rms."""
ALIKE = 4.0
"""Neighbouring pixels err together: so many count as one where uncertainties are stated."""
_TOGETHER = 5.0
"""An arm's pixels err together all over it: its joints are 8 to 11 times as far off as `NOISE` and
`ALIKE` make them (each of six joints in 112 frames of three episodes of `push`). Half of that
leaves less say to a network that misreads how a gripper is turned (0.05 rad off instead of 0.08 in
24 such frames), and is as good elsewhere; what is stated is the whole."""
_STATED = 10.0 / _TOGETHER
_SEEN_PIXELS, _SEEN_SHARE, EXPLAINED = 6.0, 0.15, 0.5
"""What counts as seen: at least so many pixels (of 128 x 128) of an object that are right with it
and wrong without, that share of its outline, and that share of the improvement which a perfect
match would be."""
_TAILS = 4.0
"""Degrees of freedom of Student's distribution about what a network reads, and about where motion
has a joint: mostly near, at times far off (a network by 0.1 to 0.4 rad, of a gripper near a quarter
turn), which a normal one would pull the fit to."""
_ALIKE = 0.1
"""Likeness of a pixel's colour from which on it may be the object's."""
_RIGHT = 0.1
"""Difference of a pixel's value from which on it is wrong."""
_BIAS, _WANDER = 0.2, 0.08
"""Pixels by which outlines are off whatever the curvature says, since they are drawn otherwise; and
how much of that changes from frame to frame as outlines cross pixels (0.05 in films of a sliding
block that end at rest). The rest is common to a film: motions between its frames do not have it."""
_LIES, _FREE = 0.9, 0.15
"""A body that rests on a surface and explains so much of the improvement does rest. Else it may be
anywhere, if that lowers the cost by such a share."""
_ROBOT_PIXELS = 700
"""Pixels that a robot's fit looks at, at most."""
_FOLLOWING, _REACHED = 6, 3.0
"""Steps of a robot's fit from where it goes; and pixels, what the secants of a fit bridge: where a
network reads it so near to where that fit ends, another one from there hardly ends elsewhere."""
_CERTAIN = 3.0
"""Standard deviations by which two objects must be within each other to be called impossible."""
_SURE, _LESS, _SAME = 0.75, 0.05, 0.015
"""Share of the improvement from which on no other place is tried, unless the frame before had so
much more; places so near, m, are one."""
_STEADY, _ROUNDS = 1.0, 3
"""Pixels from which on a motion counts: the window that a fit looks at moves along, so often at
most."""
_BEGUN = 0.01
"""A fit that a finer one goes on with is settled earlier (see `levenberg.SETTLED`)."""
_ROUGH, _STEPS = 6, 12
"""Steps of a fit that shows whether a place is worth it, and of one to the end."""


class Pose(NamedTuple):
    """An object in a frame.

    Attributes:
      qpos: [7] of its free joint. seen: whether the frame shows it. explained: share of the
        improvement that a perfect match would be. std: [6] of position, m, and turn about the
        world's axes, rad.
      jitter: [6] the part of `std` that changes from frame to frame.
      rests: whether it lies on a surface.
    """

    qpos: Floats
    seen: bool
    explained: float
    std: Floats
    jitter: Floats = np.full(6, np.inf)
    rests: bool = True


class Frame(NamedTuple):
    """What one frame shows.

    Attributes:
      qpos: [nq] of the scene; objects that are not seen stay where they were seen last.
      joints_std: [joints] of the scalar joints, rad or m. objects: of each free body in order.
      joints_seen: whether the frame shows what the joints move.
    """

    qpos: Floats
    joints_std: Floats
    objects: tuple[Pose, ...]
    joints_seen: bool = True


class Refiner:
    """Fits states to frames.

    Args:
      scene: with the objects that are looked for. camera: number of the camera. size: height and
        width of the frames, pixels.
    """

    def __init__(self, scene: Scene, camera: int, size: int) -> None:
        self.eye, self.model, self.size = Eye(scene, camera, size), scene.model, size
        self.keyed = scene.model.nkey > 0
        self.rest = np.array(scene.model.key_qpos[0] if self.keyed else scene.model.qpos0)
        self.bodies = tuple(free_bodies(self.eye))
        self.scalar = scalar_joints(scene.model)
        self.surfaces = surfaces(self.eye)
        self._all = torch.arange(size * size)
        entity = self.eye.entity
        self._fixed = torch.nonzero(entity <= ROBOT)[:, 0]
        self._robot = entity == ROBOT
        self.turns = Turns(self.eye, self.rest, self.scalar, self.shown([]))
        self.view = self.eye.placed(scene.model.qpos0[None])[1]
        self._ray = rays(self.view, size, size)[0].double().numpy()
        self._eye = self.view.pos[0].double().numpy()

    def first(
        self,
        frame: npt.NDArray[np.uint8],
        joints: Floats,
        places: Sequence[Sequence[Floats]],
        read: Floats | None = None,
    ) -> Frame:
        """A frame by itself.

        Args:
          frame: [H, W, 3]. joints: [joints] of the scalar joints, nearly.
          places: for each body, poses [7] of what the
            network sees that it might be; none is fine, too.
          read: see `following`.
        """
        found = self._frame(frame, joints, None, places, None, read=read)
        return self._held(frame, found, read) if self.keyed else found

    def _held(self, frame: npt.NDArray[np.uint8], found: Frame, read: Floats | None) -> Frame:
        """The frame with joints in the turns that are probable, of those that look the same."""
        columns, qpos = self.scalar.qpos, found.qpos.copy()
        qpos[columns] = self.turns.held(qpos[columns], found.joints_std)
        halves = np.round((qpos - found.qpos)[columns] / np.pi)
        if not (halves % 2).any():
            return found._replace(qpos=qpos)
        image = torch.as_tensor(frame).double() / 255.0  # fitted: fingers have changed sides
        present = [i for i, pose in enumerate(found.objects) if pose.seen]
        known = self._known(qpos[columns], read)
        qpos, std = self._arm(image, qpos, present, known, steps=6)
        return found._replace(qpos=qpos, joints_std=std)

    def following(
        self,
        frame: npt.NDArray[np.uint8],
        joints: Floats,
        places: Sequence[Sequence[Floats]],
        before: Frame,
        known: Floats | None = None,
        ahead: Sequence[Floats | None] = (),
        read: Floats | None = None,
    ) -> Frame:
        """The next frame of a video.

        Args:
          frame, places: see `first`. joints: [joints] if they go on as they moved. before: the
            frame before it. known: joints that need no fit. ahead: for each body, the pose [7] that
            it has if it goes on as it moved; None where that is not known.
          read: [joints] as a network reads this frame by itself. What the frame does not show of
            the joints stays there, and the fit begins there, too: joints that a frame has lost, or
            does not show, would else go on at the speed at which they were lost.
        """
        return self._frame(frame, joints, known, places, before, ahead, read)

    def _frame(
        self,
        frame: npt.NDArray[np.uint8],
        joints: Floats,
        known: Floats | None,
        places: Sequence[Sequence[Floats]],
        before: Frame | None,
        ahead: Sequence[Floats | None] = (),
        read: Floats | None = None,
    ) -> Frame:
        image = torch.as_tensor(frame).double() / 255.0
        qpos = np.array(self.rest if before is None else before.qpos)
        # what a frame does not show would leave its range at the speed of the last two frames
        within = np.clip(joints, self.scalar.low, self.scalar.high)
        qpos[self.scalar.qpos] = within if known is None else known
        std = np.zeros(len(joints))
        present: list[int] = []
        if before is not None:
            present = [i for i, pose in enumerate(before.objects) if pose.seen]
        about = self._known(qpos[self.scalar.qpos], read, before)
        if known is None and len(joints):
            if before is None:
                qpos, std = self._arm(image, qpos, present, about, steps=20)
            elif len(about) > 1:
                qpos, std = self._either(image, qpos, present, about)
            else:
                qpos, std = self._arm(image, qpos, present, about, _FOLLOWING)
        found: list[Pose | None] = [None] * len(self.bodies)
        order = self._order(before)
        for i in order:
            others = [j for j in range(len(self.bodies)) if j != i and j in present]
            last = before.objects[i] if before is not None else None
            pose = self._object(
                image, qpos, i, others, places[i], last, ahead[i] if ahead else None
            )
            found[i] = pose
            body = self.bodies[i]
            qpos[body.qpos : body.qpos + 7] = pose.qpos
            present = sorted({*others, *([i] if pose.seen else [])})
        if before is None and len(present):
            if known is None and len(joints):
                qpos, std = self._arm(image, qpos, present, about, steps=6)
            for i in present:
                others = [j for j in present if j != i]
                body = self.bodies[i]
                here = qpos[body.qpos : body.qpos + 7]
                found[i] = self._object(image, qpos, i, others, [here], found[i])
                qpos[body.qpos : body.qpos + 7] = found[i].qpos  # type: ignore[union-attr]
        shown = Frame(qpos, std, tuple(pose for pose in found if pose is not None))
        if before is None:
            return self.possible(self._exchanged(image, shown))
        return self._kept(self.possible(shown), before)

    def _kept(self, frame: Frame, before: Frame) -> Frame:
        """The frame with what is not seen where it was before: nothing says that it has moved."""
        qpos, objects = frame.qpos.copy(), list(frame.objects)
        for i, (pose, last) in enumerate(zip(objects, before.objects, strict=True)):
            if not pose.seen:
                objects[i] = pose._replace(qpos=last.qpos, rests=last.rests)
                qpos[self.bodies[i].qpos :][:7] = last.qpos
        return frame._replace(qpos=qpos, objects=tuple(objects))

    def possible(self, frame: Frame) -> Frame:
        """The frame without what is within another object: of two, what explains less is not seen.

        What is hidden for the most part has a place in the image, not along the line of sight, and
        is easily put into its neighbour; solids are not in one place.
        """
        objects = list(frame.objects)
        for i, j in itertools.combinations(range(len(objects)), 2):
            if not (objects[i].seen and objects[j].seen):
                continue
            spread = np.hypot(objects[i].std[:3].max(), objects[j].std[:3].max())
            if overlap(self.eye, frame.qpos, self.bodies[i], self.bodies[j]) > _CERTAIN * spread:
                worse = min(i, j, key=lambda k: objects[k].explained)
                objects[worse] = objects[worse]._replace(seen=False)
        return frame._replace(objects=tuple(objects))

    def _exchanged(self, image: torch.Tensor, frame: Frame) -> Frame:
        """The frame with two objects in each other's places, where its image is then more alike.

        What is like another object is easily found in its place; the other one, pushed out of it,
        is not seen then or half explained.
        """
        for i, j in itertools.combinations(range(len(self.bodies)), 2):
            if min(frame.objects[i].explained, frame.objects[j].explained) > _LIES:
                continue
            other = self._exchange(image, frame, i, j)
            if self._loss(image, other) < self._loss(image, frame):
                frame = other
        return frame

    def _exchange(self, image: torch.Tensor, frame: Frame, i: int, j: int) -> Frame:
        """Both fitted again from each other's places, in turn."""
        qpos, objects = frame.qpos.copy(), list(frame.objects)
        for number, place in ((i, objects[j].qpos), (j, objects[i].qpos)):
            qpos[self.bodies[number].qpos :][:7] = place
        present = {k for k, pose in enumerate(objects) if pose.seen} | {i, j}
        for number in (i, j, i):  # the first saw the other one where it had been
            body = self.bodies[number]
            scene = _Around(image, qpos, number, tuple(sorted(present - {number})))
            starts = self._upright(scene, qpos[body.qpos : body.qpos + 7])[1]
            objects[number] = self._near(scene, starts)
            qpos[body.qpos : body.qpos + 7] = objects[number].qpos
            present = present - {number} | ({number} if objects[number].seen else set())
        return Frame(qpos, frame.joints_std, tuple(objects))

    def _loss(self, image: torch.Tensor, frame: Frame) -> float:
        """Of the whole image, drawn with what is seen."""
        seen = [i for i, pose in enumerate(frame.objects) if pose.seen]
        drawn = self.eye.draw(frame.qpos[None], self._all, self.shown(seen)).pixels[0]
        return float(losses(drawn.double().numpy() - image.reshape(-1, 3).numpy()).sum())

    def _order(self, before: Frame | None) -> list[int]:
        """Bodies in the order of their fit: large and sure ones first."""
        sizes = [float(body.half.prod()) for body in self.bodies]
        sure = [before.objects[i].explained if before else 0.0 for i in range(len(sizes))]
        return sorted(range(len(sizes)), key=lambda i: (-sure[i], -sizes[i]))

    # -- the robot ---------------------------------------------------------------------------------

    def _known(
        self, joints: Floats, read: Floats | None, before: Frame | None = None
    ) -> tuple[Prior, ...]:
        """What is known of the joints before a frame is looked at.

        Args:
          joints: [joints] where they go, about. read: see `following`. before: the frame before.
        """
        if read is None or not np.isfinite(read).all():
            return (Prior(joints, self.scalar.prior),)
        found = [Prior(self.turns.nearest(read, joints), self.scalar.read, _TAILS)]
        if before is not None:  # two frames have the speed
            std = np.hypot(np.sqrt(5.0) * before.joints_std, self.scalar.gone)
            found.append(Prior(joints, std, _TAILS))
        return tuple(found)

    def _arm(
        self,
        image: torch.Tensor,
        qpos: Floats,
        present: list[int],
        known: Sequence[Prior],
        steps: int,
    ) -> tuple[Floats, Floats]:
        """The state [nq] with joints near those of `qpos`, and their standard deviations."""
        geoms = self.shown(present)
        pixels = self._touched(qpos[None], geoms)
        if not len(pixels):
            return qpos, np.full(len(self.scalar.qpos), np.inf)
        return self._joined(self._joints(image, qpos, known, geoms, pixels, steps))

    def _either(
        self, image: torch.Tensor, expected: Floats, present: list[int], known: Sequence[Prior]
    ) -> tuple[Floats, Floats]:
        """See `_arm`; from where motion has the joints or where a network reads them.

        Both fits are of the same pixels and have the same prior: the lower cost is kept.

        Args:
          image: [H, W, 3]. expected: [nq] by the motion. present: objects there.
        """
        columns, geoms = self.scalar.qpos, self.shown(present)
        started = expected.copy()
        started[columns] = known[0].centre
        pixels = self._touched(np.stack([expected, started]), geoms)
        if not len(pixels):
            return started, np.full(len(columns), np.inf)
        found = self._joints(image, expected, known, geoms, pixels, _FOLLOWING)
        if self.eye.apart(found.qpos[0], started, self._robot) < _REACHED:
            # a glance: what is near and drawn worse is on the way to the same end
            there = cost(
                self.eye, image, pixels, started, **self._about(started, known), geoms=geoms
            )
            if there >= found.cost[0]:
                return self._joined(found)
        other = self._joints(image, started, known, geoms, pixels, _FOLLOWING)
        return self._joined(other if other.cost[0] < found.cost[0] else found)

    def _joints(
        self,
        image: torch.Tensor,
        start: Floats,
        known: Sequence[Prior],
        geoms: torch.Tensor,
        pixels: torch.Tensor,
        steps: int,
    ) -> Fit:
        """From one state [nq]."""
        directions = np.zeros((1, self.model.nv, len(self.scalar.dof)))
        directions[0, self.scalar.dof, np.arange(len(self.scalar.dof))] = 1.0
        about = self._about(start, known)
        return fit(
            self.eye, image, pixels, start[None], directions, **about, geoms=geoms, steps=steps
        )

    def _about(self, start: Floats, known: Sequence[Prior]) -> _Told:
        """The same about a change from one state [nq]."""
        # noise grows with the stride: fewer pixels say as much as they stand for
        noise, joints = float(_TOGETHER * NOISE * np.sqrt(ALIKE)), start[self.scalar.qpos]
        priors = [prior._replace(centre=prior.centre - joints) for prior in known]
        return {"noise": noise, "priors": priors}

    def _joined(self, found: Fit) -> tuple[Floats, Floats]:
        """The state [nq] of a fit with joints in their ranges, and their standard deviations."""
        best, columns = found.qpos[0], self.scalar.qpos
        best[columns] = np.clip(best[columns], self.scalar.low, self.scalar.high)
        return best, _STATED * np.sqrt(np.diag(np.linalg.inv(found.precision[0])))

    def _touched(self, states: Floats, geoms: torch.Tensor) -> torch.Tensor:
        """Pixels, not too many, that joints change in some states [S, nq], and those around."""
        grid = self._all.reshape(self.size, self.size)[::2, ::2]
        drawn = self.eye.draw(states, grid.reshape(-1), geoms)
        without = self.eye.draw(states[:1], grid.reshape(-1), self.unmoved(geoms))
        touched = np.zeros((self.size, self.size), bool)
        changed = ((drawn.pixels - without.pixels).abs().amax(-1) > 0.03).any(0)
        touched[::2, ::2] = changed.reshape(grid.shape).numpy()
        near = ndimage.binary_dilation(touched, iterations=MARGIN)
        pixels = torch.as_tensor(np.flatnonzero(near))
        return pixels[:: max(1, len(pixels) // _ROBOT_PIXELS)]

    # -- objects -----------------------------------------------------------------------------------

    def _object(
        self,
        image: torch.Tensor,
        qpos: Floats,
        number: int,
        others: list[int],
        places: Sequence[Floats],
        last: Pose | None,
        ahead: Floats | None = None,
    ) -> Pose:
        """Where an object is: near where it was or goes if that holds, else from everywhere."""
        scene = _Around(image, qpos, number, tuple(others))
        tried = []
        if last is not None and last.seen:
            starts = [last.qpos]
            if ahead is not None and self.apart(self.bodies[number], ahead, last.qpos) > _STEADY:
                starts = [ahead, last.qpos]
            near = self._near(scene, np.stack(starts))
            as_well = near.explained > max(_SURE, last.explained - _LESS)
            # what has just left its surface may as well be a fit that went astray
            if near.seen and as_well and (near.rests or not last.rests):
                return near
            tried.append(near)
        spots = [] if last is None else [last.qpos]  # it is still there, if nothing has moved it
        spots += [place for place in places if np.isfinite(place).all()]
        left = self._left(scene, [pose for pose in tried if pose.seen])
        rough: list[tuple[float, Floats]] = []
        for spot in self._worth(scene, left, spots + self._peaks(scene, left)):
            if any(np.linalg.norm(spot[:3] - pose[0, :3]) < _SAME for _, pose in rough):
                continue
            rough.append(self._upright(scene, spot))
            if rough[-1][0] > _SURE:
                break
        if rough:
            tried.append(self._near(scene, max(rough, key=lambda one: one[0])[1]))
        if not tried:
            place = qpos[self.bodies[number].qpos :][:7]
            return Pose(place, False, 0.0, np.full(6, np.inf))
        return max(tried, key=lambda pose: (pose.seen, pose.explained))

    def _upright(self, scene: _Around, spot: Floats) -> tuple[float, Floats]:
        """How well standing there explains the frame, and the two best such poses [2, 7]."""
        body = self.bodies[scene.number]
        starts = at_rest(body, spot, self.surfaces, self._eye, False)
        pixels = window(self.view, self.size, body, spot[:3], 2.0)
        if not len(pixels):
            return -np.inf, starts[:2]
        geoms = self._relevant(scene, starts[0], pixels)
        found = self._fit(scene, starts, geoms, pixels[::2], True, _ROUGH)
        best = np.argsort(found.cost)[:2]
        _, explained = self._judged(scene, found.qpos[best[0]], geoms, pixels)
        return explained, found.qpos[best, body.qpos : body.qpos + 7]

    def _near(self, scene: _Around, starts: Floats) -> Pose:
        """The pose that is reached from some [S, 7] that are nearly right."""
        body = self.bodies[scene.number]
        rest = np.concatenate(
            [at_rest(body, start, self.surfaces, self._eye, True) for start in starts]
        )
        centre, best = starts[0], rest
        for _ in range(_ROUNDS):
            pixels = window(self.view, self.size, body, centre[:3], 1.5)
            if not len(pixels):
                return Pose(centre, False, 0.0, np.full(6, np.inf))
            geoms = self._relevant(scene, centre, pixels)
            upright = self._fit(scene, best, geoms, pixels, True, _STEPS)
            reached = upright.qpos[upright.best, body.qpos : body.qpos + 7]
            if self.apart(body, reached, centre) < _STEADY:
                break
            centre, best = reached, reached[None]  # the window was about another place
        place = upright.qpos[upright.best, body.qpos : body.qpos + 7]
        seen, explained = self._judged(scene, upright.qpos[upright.best], geoms, pixels)
        if not seen:  # nor will it be by parts of a pixel
            return Pose(place, False, explained, np.full(6, np.inf))
        upright = self._fit(scene, place[None], geoms, pixels, True, _STEPS, FINE)
        chosen, k, row = upright, 3, upright.best
        seen, explained = self._judged(scene, upright.qpos[row], geoms, pixels)
        if explained < _LIES:
            best = upright.qpos[row, body.qpos : body.qpos + 7]
            loose = self._fit(scene, best[None], geoms, pixels, False, _STEPS, FINE, _FREE / 3.0)
            if loose.cost[0] < (1.0 - _FREE) * upright.cost[row]:
                best = loose.qpos[0, body.qpos : body.qpos + 7]
                chosen = self._fit(scene, best[None], geoms, pixels, False, _STEPS, FINE)
                k, row = 6, 0
                seen, explained = self._judged(scene, chosen.qpos[0], geoms, pixels)
        variance = np.linalg.inv(chosen.precision[row] + 1e-6 * np.eye(k))
        spread = np.sqrt(ALIKE * np.diag(variance))
        if k == 3:  # how a body at rest lies is known
            spread = np.array([spread[0], spread[1], 0.0, 0.0, 0.0, spread[2]])
        pose = chosen.qpos[row, body.qpos : body.qpos + 7]
        bias, wander = (self.outline(body, pose[:3], part) for part in (_BIAS, _WANDER))
        std, jitter = np.hypot(spread, bias), np.hypot(spread, wander)
        if k == 3:  # height and tilt are assumed: a body that moves rocks, and no frame was asked
            jitter[2:5] = std[2:5]
        return Pose(pose, seen, explained, std, jitter, k == 3)

    def apart(self, body: Body, one: Floats, other: Floats) -> float:
        """How many pixels a body's outline moves between two poses [7], about."""
        far = float(np.linalg.norm(one[:3] - self._eye))
        first, second = Rotation.from_quat(np.roll(np.stack([one, other])[:, 3:], -1, axis=1))
        turn = (first * second.inv()).magnitude() * float(np.linalg.norm(body.half))
        moved = float(np.linalg.norm(one[:3] - other[:3])) + turn
        return moved * self.size * float(self.view.focal[0, 1]) / far

    def outline(self, body: Body, place: Floats, pixels: float = _BIAS) -> Floats:
        """[6] m and rad that stand for so many pixels, by default what outlines are off."""
        metres = pixels * float(np.linalg.norm(place - self._eye)) / self.size
        metres /= float(self.view.focal[0, 1])
        return np.repeat([metres, metres / max(float(body.half.max()), 1e-3)], 3)

    def _fit(
        self,
        scene: _Around,
        starts: Floats,
        geoms: torch.Tensor,
        pixels: torch.Tensor,
        upright: bool,
        steps: int,
        fine: int = 1,
        settled: float = SETTLED,
    ) -> Fit:
        """From poses [S, 7]; see `levenberg.fit`. Fine fits begin where others have ended."""
        body = self.bodies[scene.number]
        states = np.repeat(scene.qpos[None], len(starts), 0)
        states[:, body.qpos : body.qpos + 7] = starts
        ways = np.stack([directions(self.model.nv, body, start, upright) for start in starts])
        return fit(
            self.eye,
            scene.image,
            pixels,
            states,
            ways,
            noise=NOISE,
            geoms=geoms,
            steps=steps,
            settled=settled if fine > 1 else _BEGUN,
            wide=fine == 1,
            fine=fine,
        )

    def _relevant(self, scene: _Around, pose: Floats, pixels: torch.Tensor) -> torch.Tensor:
        """Geoms that show or throw shadows in the window, the object's among them."""
        body = self.bodies[scene.number]
        state = scene.qpos[None].copy()
        state[:, body.qpos : body.qpos + 7] = pose
        geoms = self.shown([*scene.others, scene.number])
        near = self.eye.met(state, pixels[::4], geoms)
        return geoms[near | torch.isin(geoms, body.geoms)]

    def _judged(
        self, scene: _Around, state: Floats, geoms: torch.Tensor, pixels: torch.Tensor
    ) -> tuple[bool, float]:
        """Whether the object is seen, and the share explained (see `Pose`)."""
        own = torch.isin(geoms, self.bodies[scene.number].geoms)
        there = self.eye.draw(state[None], pixels, geoms)
        share = there.weight[0, own].sum(0).numpy()
        gone = self.eye.draw(state[None], pixels, geoms[~own])
        alone = self.eye.draw(state[None], pixels, geoms[own])
        whole = float(alone.weight[0].sum())
        wanted = scene.image.reshape(-1, 3)[pixels].numpy()
        shown, blank = there.pixels[0].double().numpy(), gone.pixels[0].double().numpy()
        gain = losses(blank - wanted).sum() - losses(shown - wanted).sum()
        best = losses(blank - shown).sum()
        explained = min(1.0, float(gain / best)) if best > 1e-9 else 0.0
        right = np.abs(shown - wanted).max(-1) < _RIGHT
        telling = float(share[right & (np.abs(blank - wanted).max(-1) > _RIGHT)].sum())
        enough = telling > max(_SEEN_PIXELS * (self.size / 128) ** 2, _SEEN_SHARE * whole)
        return enough and explained > EXPLAINED, explained

    def _left(self, scene: _Around, seen: Sequence[Pose]) -> Floats:
        """[H, W]: how like the object pixels are that are wrong without it, 0 to 1.

        Args:
          seen: a pose that the object has, so that only what it leaves unexplained counts.
        """
        body, n = self.bodies[scene.number], self.size
        state, shown = scene.qpos[None].copy(), self.shown(scene.others)
        if seen:
            state[:, body.qpos : body.qpos + 7] = seen[0].qpos
            shown = self.shown([*scene.others, scene.number])
        blank = self.eye.draw(state, self._all, shown).pixels[0].numpy()
        wanted = scene.image.numpy().reshape(-1, 3)
        odd = np.abs(wanted - blank).max(-1) > 0.06
        bright = (wanted @ body.colour) / (body.colour @ body.colour)
        apart = np.abs(wanted - bright[:, None] * body.colour).max(-1)
        apart = apart / np.maximum(0.3, bright)  # darker sides differ by less
        found: Floats = (odd & (bright > 0.08)) * np.exp(-((apart / 0.12) ** 2))
        return found.reshape(n, n)

    def _worth(self, scene: _Around, left: Floats, spots: list[Floats]) -> list[Floats]:
        """Of some places those where enough pixels are left for the object to be seen there."""
        body, alike = self.bodies[scene.number], left.reshape(-1) > _ALIKE
        fewest = _SEEN_PIXELS * (self.size / 128) ** 2
        return [
            spot
            for spot in spots
            if alike[window(self.view, self.size, body, spot[:3], 2.0)].sum() > fewest
        ]

    def _peaks(self, scene: _Around, left: Floats) -> list[Floats]:
        """Places [7] where most of the object's colour is left (see `_left`)."""
        body, n = self.bodies[scene.number], self.size
        surface = max((s.top for s in self.surfaces), default=0.0)
        for_ray = self._ray[:, 2]
        down = (surface + body.half.min() - self._eye[2]) / np.where(for_ray < -1e-3, for_ray, -1e9)
        middle = float(np.median(down[down > 0])) if (down > 0).any() else 1.0
        width = 2.0 * float(np.median(body.half)) * n * float(self.view.focal[0, 1]) / middle
        smooth = ndimage.uniform_filter(left, max(3, round(width)))
        found = []
        for _ in range(3):
            peak = int(smooth.argmax())
            if smooth.flat[peak] < 0.05:
                break
            row, column = divmod(peak, n)
            place = self._eye + down[peak] * self._ray[peak]
            found.append(np.array([*place, 1.0, 0.0, 0.0, 0.0]))
            r = max(2, round(width / 2))
            smooth[max(0, row - r) : row + r + 1, max(0, column - r) : column + r + 1] = 0.0
        return found

    def shown(self, numbers: Sequence[int]) -> torch.Tensor:
        """What is not an object, and some objects: places among the geoms that are drawn."""
        parts = [self._fixed, *(self.bodies[i].geoms for i in numbers)]
        return torch.cat(parts).sort().values

    def unmoved(self, geoms: torch.Tensor) -> torch.Tensor:
        """Those of some geoms that no scalar joint moves."""
        return geoms[~self._robot[geoms]]


class _Told(TypedDict):
    """What a fit of joints is told beside the image; see `levenberg.fit`."""

    noise: float
    priors: list[Prior]


class _Around(NamedTuple):
    """A frame [H, W, 3], the rest of its state [nq], the object looked for and the others seen."""

    image: torch.Tensor
    qpos: Floats
    number: int
    others: tuple[int, ...]
