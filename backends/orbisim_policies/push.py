"""Pushing one cube so that it hits another (paper section 4.3, appendix C.8).

Cubes, friction and places are drawn as by `task:push`, subtask `to_hit`, with the second cube
beyond the first as seen towards the far edge of the table, where the task's target is.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import mujoco
import numpy as np
import torch
from orbisim_world_model.rotation import rotate
from torch import Tensor

from orbisim.scene import Scene
from orbisim.tasks.arm import UR5E
from orbisim.tasks.push import SKIM, SUCCESS_DISTANCE, Push, Stroke, draw_hit, start_of_tool
from orbisim.tasks.sampling import stream
from orbisim.tasks.tabletop import TABLE_HIGH, TABLE_LOW, Cube, Pose, Setting, build, on_table
from orbisim_policies.arm import ArmKinematics
from orbisim_policies.problem import Floats, Moment, Problem, Starts

REACH, TURN = 0.04, 0.1
"""Largest translation, m, and turn, rad, of an action: 0.8 m/s and 2 rad/s."""
HEADING = 0.6
"""Largest angle between the way from cube 1 to cube 2 and the way to the far edge, rad."""
BORDER = float(TABLE_HIGH[0])
"""x of the far edge, m."""
REGION = 0.2
"""The designated region is so far from the far edge, m, or beyond it."""
_LOW, _HIGH = (0.26, -0.34, 0.022), (0.78, 0.34, 0.30)
"""Where the end effector is commanded to be, m."""
_YAW = 1.6
"""Largest turn of the tool either way, rad: the fingers look the same after pi."""
_ARM, _CUBE1, _CUBE2 = slice(0, 6), slice(8, 15), slice(15, 22)
_VEL1, _VEL2 = slice(8, 10), slice(14, 16)
_NOMINAL = (525.0, 0.4)
"""Density, kg/m^3, and friction in the middle of what is drawn."""
HIDDEN = {"density:cube1": 2, "density:cube2": 3, "friction:table": 6}
"""What no image shows, by the names of `orbisim identify`, and its place in the parameters."""
_NEAR = 1e-4
"""m, below which distances are not differentiated."""


class Layout(NamedTuple):
    """What is drawn for an episode.

    Attributes:
      setting: sizes, densities, friction. cubes: where they stand.
      stroke: what the script would do. tool: where the end effector begins, m.
    """

    setting: Setting
    cubes: list[Pose]
    stroke: Stroke
    tool: tuple[float, float, float]


class PushProblem(Problem):
    """r1, r2 and r3 at the end of an episode (equation rl_rewards).

    An action is a translation of the commanded end effector and a turn about the vertical, four of
    the seven numbers of the task's own actions: the tool points down and the gripper is closed, as
    in all of the task's data. All methods have the same.

    Args:
      steps: control steps of an episode.
      device: where to compute.
    """

    name = "task:push"
    parts = ("r1", "r2", "r3")
    sparse = True
    actions = 4
    observations = 42

    def __init__(self, steps: int = 64, device: torch.device | None = None) -> None:
        self.task = Push()
        self.scene, self.timestep = self.task.scene(), self.task.control_timestep
        self.steps = steps
        self._cubes = [int(self.scene.model.geom(f"cube{i}").id) for i in (1, 2)]
        self._table = int(self.scene.model.geom("table").id)
        self._data = mujoco.MjData(self.scene.model)
        config, key = self.task.config, self.scene.model.key("start")
        largest = Cube(config.cube_half[1], config.density[1], 0.4, (0.5, 0.5, 0.5))
        setting = Setting((largest, largest), 0.4)
        self._largest = build("push", setting, self.name, key.qpos, key.ctrl)
        self._place(device or torch.device("cpu"))

    def to(self, device: torch.device) -> PushProblem:
        """The same with its constants on a device."""
        return PushProblem(self.steps, device)

    def _place(self, device: torch.device) -> None:
        self.arm = ArmKinematics(UR5E, device)
        self._low, self._high = (torch.tensor(v, device=device) for v in (_LOW, _HIGH))
        self._middle = torch.tensor((0.5, 0.0, 0.1), device=device)
        self._turns = tuple(torch.tensor(v, device=device) for v in (-_YAW, _YAW))
        self._hidden = torch.tensor([*_NOMINAL[:1] * 2, *_NOMINAL[1:] * 3], device=device)

    # -- episodes ------------------------------------------------------------------------------

    def layout(self, seed: int, setting: Setting | None = None) -> Layout:
        """What is drawn for an episode, in a setting of its own if none is given."""
        setting, rng = setting or self.task.setting("to_hit", seed), stream(seed, 1)
        tool = start_of_tool(rng)
        while True:
            poses, stroke = draw_hit(setting, self.task.config, rng)
            way = np.array(poses[1].pos[:2]) - np.array(poses[0].pos[:2])
            if abs(math.atan2(way[1], way[0])) <= HEADING:
                return Layout(setting, poses, stroke, tool)

    def draw(self, seeds: Sequence[int]) -> Starts:
        """See `Problem.draw`."""
        return self._starts([self.layout(seed) for seed in seeds])

    def trials(self, count: int, seed: int) -> tuple[Scene, Starts]:
        """See `Problem.trials`."""
        setting = self.task.setting("to_hit", seed)
        starts = self._starts([self.layout(seed + i, setting) for i in range(count)])
        keyframe = starts.qpos[0], starts.ctrl[0]
        return build("push", setting, self.name, *keyframe), starts

    def _starts(self, drawn: Sequence[Layout]) -> Starts:
        tools = torch.tensor([layout.tool for layout in drawn])
        yaw = torch.zeros(len(tools))
        arm = ArmKinematics(UR5E, torch.device("cpu"))
        target, _ = arm.descend(arm.home.expand(len(tools), -1), tools, yaw, 60)
        joints, closed = target.double().numpy(), np.zeros((len(tools), 1))
        cubes = np.array([[pose.qpos for pose in layout.cubes] for layout in drawn])
        qpos = np.concatenate([joints, closed, closed, cubes.reshape(len(tools), -1)], axis=1)
        command = np.concatenate([tools.double().numpy(), closed, joints], axis=1)
        params = np.array([_numbers(layout.setting) for layout in drawn])
        speeds = np.zeros((len(tools), self.scene.model.nv))
        return Starts(qpos, speeds, np.append(joints, closed, axis=1), command, params)

    @property
    def template(self) -> Scene:
        """With cubes as large as they can be: MuJoCo's bounding volumes, which filter what may
        touch, are those of the compiled sizes (`bvh_aabb`), and cubes are only made smaller."""
        return self._largest

    def write(self, model: mujoco.MjModel, params: Floats) -> None:
        """See `Problem.write`: what `tabletop.build` declares, in the compiled model."""
        for geom, half, density, friction in zip(
            self._cubes, params[:2], params[2:4], params[4:6], strict=True
        ):
            body = int(model.geom_bodyid[geom])
            mass = float(8 * half**3 * density)
            model.geom_size[geom] = half
            model.geom_rbound[geom] = math.sqrt(3 * half**2)
            model.geom_aabb[geom] = [0, 0, 0, half, half, half]
            model.geom_friction[geom, 0] = friction
            model.body_mass[body] = mass
            model.body_inertia[body] = mass * half**2 * 2 / 3
        model.geom_friction[self._table, 0] = params[6]
        mujoco.mj_setConst(model, self._data)

    # -- functions of tensors ------------------------------------------------------------------

    def begin(self, qpos: Tensor, qvel: Tensor, command: Tensor) -> Tensor:
        """[N, 5]: smallest distances so far, the first ones, and cube 2's way to the edge."""
        hand, first, second = self._where(qpos)
        near = torch.stack([_distance(hand, first), _distance(first, second)], 1)
        return torch.cat([near, near, BORDER - second[:, :1]], 1)

    def count(self, score: Tensor, qpos: Tensor, qvel: Tensor, control: Tensor) -> Tensor:
        """See `Problem.count`."""
        hand, first, second = self._where(qpos)
        near = torch.stack([_distance(hand, first), _distance(first, second)], 1)
        return torch.cat([torch.minimum(score[:, :2], near), score[:, 2:]], 1)

    def value(self, score: Tensor, qpos: Tensor) -> Tensor:
        """r1, r2, r3 [N, 3]."""
        left = BORDER - qpos[:, _CUBE2.start : _CUBE2.start + 1]
        return 1.0 - torch.cat([score[:, :2] / score[:, 2:4], left / score[:, 4:5]], 1)

    def observe(self, moment: Moment) -> Tensor:
        """[N, 42]: where hand and cubes are to each other, how they move, what they are."""
        qpos, qvel, command, params, score, time = moment
        hand, first, second = self._where(qpos)
        way = second - first
        along = way[:, :2] / way[:, :2].norm(dim=1, keepdim=True).clamp_min(0.02)
        across = torch.stack([-along[:, 1], along[:, 0]], 1)
        behind = first[:, :2] - along * (params[:, :1] + 0.035)
        off, lag = hand[:, :2] - behind, command[:, :3] - hand
        place = hand[:, :2] - first[:, :2]
        parts = [
            (hand - self._middle) / 0.15,
            (first - self._middle)[:, :2] / 0.15,
            (second - self._middle)[:, :2] / 0.15,
            (hand - first) / 0.1,
            way[:, :2] / 0.1,
            along,
            off / 0.05,
            torch.stack([(place * along).sum(1), (place * across).sum(1)], 1) / 0.05,
            torch.stack([(off * along).sum(1), (off * across).sum(1)], 1) / 0.02,
            (hand[:, 2:] - SKIM) / 0.03,
            lag / 0.03,
            torch.stack([command[:, 3].cos(), command[:, 3].sin()], 1),
            _quarter(qpos[:, _CUBE1]),
            _quarter(qpos[:, _CUBE2]),
            torch.cat([qvel[:, _VEL1], qvel[:, _VEL2]], 1) / 0.3,
            1.0 - score[:, :2] / score[:, 2:4],
            time[:, None],
            (params[:, :2] - 0.026) / 0.004,
            (params[:, 2:4] - _NOMINAL[0]) / 200.0,
            (params[:, 6:7] - _NOMINAL[1]) / 0.12,
        ]
        return torch.cat(parts, 1).clamp(-8.0, 8.0)

    def unseen(self, params: Tensor) -> Tensor:
        """See `Problem.unseen`: sizes are declared; densities and friction are the nominal ones."""
        nominal = self._hidden.to(params).expand(len(params), -1)
        return torch.cat([params[:, :2], nominal], 1)

    def control(self, command: Tensor, action: Tensor) -> tuple[Tensor, Tensor]:
        """Joint targets by damped least squares, and the gripper closed."""
        action = action.clamp(-1.0, 1.0)
        way = action[:, :3] * REACH
        way = way * (REACH / way.norm(dim=1, keepdim=True).clamp_min(REACH))
        pos = _kept(command[:, :3] + way, self._low, self._high)
        yaw = _kept(command[:, 3] + action[:, 3] * TURN, *self._turns)
        before = command[:, 4:]
        found, inverse = self.arm.descend(before, pos, yaw, UR5E.iterations)
        stride = UR5E.stride
        found = torch.maximum(torch.minimum(found, before + stride), before - stride).detach()
        pose = torch.cat([pos, torch.zeros_like(pos[:, :2]), yaw[:, None]], 1)
        # the value is `found`; its derivative is that of the inverse kinematics
        target = found + rotate(inverse, pose - pose.detach())
        control = torch.cat([target, torch.zeros_like(yaw[:, None])], 1)
        return control, torch.cat([pos, yaw[:, None], found], 1)

    def _where(self, qpos: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """Positions of hand, cube 1 and cube 2, [N, 3] each."""
        hand, _ = self.arm.pose(qpos[:, _ARM])
        return hand, qpos[:, _CUBE1][:, :3], qpos[:, _CUBE2][:, :3]

    # -- what came of it -----------------------------------------------------------------------

    def success(self, starts: Starts, qpos: Floats, value: Floats) -> Mapping[str, Any]:
        """The paper's three definitions.

        `moved`: the second cube moves more than 5 cm (appendix C.8, figure of table rl_success).
        `on_table`: so it does, and neither cube falls (section 4.3).
        `region`: the first cube stays on the table and the second ends in the region near the far
        edge, or beyond that edge, but has not left the table by another one (appendix A.1).
        """
        first, second = qpos[:, _CUBE1][:, :3], qpos[:, _CUBE2][:, :3]
        way = np.linalg.norm((second - starts.qpos[:, _CUBE2][:, :3])[:, :2], axis=1)
        moved = way > SUCCESS_DISTANCE
        there = [on_table(cube) for cube in (first, second)]
        y = second[:, 1]
        near = (second[:, 0] > BORDER - REGION) & (y > TABLE_LOW[1]) & (y < TABLE_HIGH[1])
        return {"moved": moved, "on_table": moved & there[0] & there[1], "region": near & there[0]}


def _numbers(setting: Setting) -> list[float]:
    """Half sides, densities and frictions of both cubes, friction of the table."""
    cubes = setting.cubes
    each = [[getattr(cube, name) for cube in cubes] for name in ("half", "density", "friction")]
    return [*(number for pair in each for number in pair), setting.table_friction]


def _kept(value: Tensor, low: Tensor, high: Tensor) -> Tensor:
    """The value within bounds; with the gradient of the value, so that it finds back from them."""
    return value + (torch.maximum(torch.minimum(value, high), low) - value).detach()


def _distance(a: Tensor, b: Tensor) -> Tensor:
    return ((a - b).square().sum(1) + _NEAR**2).sqrt()


def _quarter(cube: Tensor) -> Tensor:
    """[N, 2]: the turn of a cube about the vertical, the same after a quarter turn."""
    w, x, y, z = cube[:, 3:7].unbind(1)
    angle = 4.0 * torch.atan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z) + 1e-12)
    return torch.stack([angle.cos(), angle.sin()], 1)
