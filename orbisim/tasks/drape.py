"""`task:drape`: a cloth falls over what stands on a floor."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from typing import ClassVar

import mujoco
import numpy as np
from scipy.spatial.transform import Rotation

from orbisim.episodes import Episodes
from orbisim.scene import Scene
from orbisim.tasks import assets, standing
from orbisim.tasks.base import Task
from orbisim.tasks.cloth import coordinates, vertices
from orbisim.tasks.episode import Episode, Floats, Rollout, check_stable, clock
from orbisim.tasks.sampling import Range, stream
from orbisim.tasks.single import passive_rollout, passive_trials
from orbisim.tasks.views import Cast, make_episode

_KINDS = {
    "primitives": standing.PRIMITIVES,
    "meshes": standing.MESHES,
    "unseen": standing.UNSEEN,
}


@dataclasses.dataclass(frozen=True)
class DrapeConfig:
    """What an episode is drawn from.

    Attributes:
      objects: least and greatest number of objects. scale: of each, 1.
      place: of each, along x and along y, m.
      above: of the cloth over the highest of them, m. shift: of the cloth, m.
      turn: of the cloth about the vertical, tilt: from the horizontal, rad.
    """

    objects: tuple[int, int] = (1, 4)
    scale: Range = (0.8, 1.3)
    place: Range = (-0.25, 0.25)
    above: Range = (0.04, 0.25)
    shift: Range = (-0.08, 0.08)
    turn: Range = (-np.pi / 4, np.pi / 4)
    tilt: Range = (0.0, 0.25)


class Drape(Task):
    """A cloth over still objects, after Physion's Drape (paper appendix A, B.4).

    Subtasks: `primitives` (balls, boxes, cones, cylinders), `meshes` (lamps and chairs), `unseen`
    (stools and stepped pyramids, held out).
    """

    name: ClassVar[str] = "drape"
    counts: ClassVar[Mapping[str, int]] = {"primitives": 600, "meshes": 400, "unseen": 100}
    default_subtask = "primitives"
    control_timestep = 0.02
    horizon = 2.0
    config: DrapeConfig = DrapeConfig()

    def scene(self, subtask: str | None = None, seed: int | None = None) -> Scene:
        """Objects on the floor; one ball without a seed. The first keyframe is the cloth above."""
        name = self.check_subtask(subtask)
        spec = assets.spec("drape")
        if seed is not None:
            self._stand(spec, name, stream(seed, 0))
        start = self._start(spec.compile(), None)
        spec.add_key(name="start", qpos=start)
        return assets.scene(spec, self.label)

    def _stand(self, spec: mujoco.MjSpec, subtask: str, rng: np.random.Generator) -> None:
        """Draws the objects."""
        config, kinds = self.config, _KINDS[subtask]
        spec.delete(spec.geom("ball"))
        low, high = config.objects
        for number in range(int(rng.integers(low, high + 1))):
            kind = str(rng.choice(list(kinds)))
            shape = kinds[kind](rng, float(rng.uniform(*config.scale)))
            x, y = rng.uniform(*config.place, 2)
            turn = float(rng.uniform(0, 2 * np.pi))
            name = f"{kind}{number}"
            standing.add(spec, "objects", name, shape, (float(x), float(y)), turn)

    def _start(self, model: mujoco.MjModel, rng: np.random.Generator | None) -> Floats:
        """qpos of a flat cloth above the objects; level and in the middle without `rng`."""
        config, flat = self.config, vertices(model, np.array(model.qpos0))
        top = _top(model)
        if rng is None:
            return coordinates(model, flat + [0.0, 0.0, top + config.above[1]])
        heading = rng.uniform(-np.pi, np.pi)
        axis = np.array([np.cos(heading), np.sin(heading), 0.0])
        tilt = Rotation.from_rotvec(rng.uniform(*config.tilt) * axis)
        placed = (tilt * Rotation.from_euler("z", rng.uniform(*config.turn))).apply(flat)
        x, y = rng.uniform(*config.shift, 2)
        clear = top + rng.uniform(*config.above) - placed[:, 2].min()
        return coordinates(model, placed + [x, y, clear])

    def episode(self, subtask: str, seed: int) -> Episode:
        """One fall."""
        scene = self.scene(subtask, seed)
        start = self._start(scene.model, stream(seed, 1))
        return make_episode(
            scene.model,
            Cast(("objects",), surface="floor"),
            self._simulate(scene.model, start),
            subtask=subtask,
            seed=seed,
            scene_hash=scene.fingerprint,
            control_timestep=self.control_timestep,
        )

    def trials(self, count: int, seed: int, subtask: str | None = None) -> Episodes:
        """Falls over the same objects, from different starts."""
        scene = self.scene(subtask, seed)
        model = scene.model
        qpos = np.array([self._start(model, stream(seed + i, 1)) for i in range(count)])
        return passive_trials(
            scene, qpos, np.zeros((count, model.nv)), self.horizon, self.control_timestep
        )

    def _simulate(self, model: mujoco.MjModel, qpos: Floats) -> Rollout:
        steps = round(self.horizon / self.control_timestep)
        substeps = round(self.control_timestep / model.opt.timestep)
        data = mujoco.MjData(model)
        data.qpos[:] = qpos
        positions, velocities = [qpos], [np.zeros(model.nv)]
        for _ in range(steps):
            mujoco.mj_step(model, data, substeps)
            positions.append(data.qpos.copy())
            velocities.append(data.qvel.copy())
        check_stable(data)
        time = clock(steps, self.control_timestep)
        return passive_rollout(time, np.array(positions), np.array(velocities))


def _top(model: mujoco.MjModel) -> float:
    """Height of the highest object, m: no geom goes beyond its bounding box."""
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    body, top = model.body("objects").id, 0.0
    for geom in np.flatnonzero(model.geom_bodyid == body):
        centre, half = model.geom_aabb[geom, :3], model.geom_aabb[geom, 3:]
        frame = data.geom_xmat[geom].reshape(3, 3)
        reach = np.abs(frame[2]) @ half
        top = max(top, float(data.geom_xpos[geom, 2] + frame[2] @ centre + reach))
    return top
