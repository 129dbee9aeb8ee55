"""`Pack`: training data as a few large tensors, small enough to live on the GPU.

All episodes stand after one another; `start` and `length` say where each begins and how many
control steps it has. The row after an episode's last step holds its last state.
"""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path
from typing import Any

import numpy as np
import torch
from safetensors import safe_open
from safetensors.torch import save_file
from torch import Tensor

from orbisim.errors import InputError
from orbisim.files.reading import parse_json, size_of
from orbisim.files.writing import writing
from orbisim_world_model.config import ModelConfig
from orbisim_world_model.entities import Context, Entities
from orbisim_world_model.kinematics import Kinematics
from orbisim_world_model.layout import Layout
from orbisim_world_model.pack_shapes import check_tensors

SCHEMA = "orbisim.pack/1"
_TENSORS = ("qpos", "qvel", "act", "ctrl", "action", "start", "length", "base")
_STATIC = ("attributes", "world", "mask", "parts", "part_mask", "group")


@dataclasses.dataclass(frozen=True, eq=False)
class Pack:
    """Episodes of one scene layout.

    Attributes:
      layout: of the scene.
      qpos, qvel, act: [F, ...] states, F the sum of length + 1.
      ctrl, action: [F, ...] what acted after each state; 0 in an episode's last row.
      hand: [F, 18] or [F, 0]; follows from qpos and qvel.
      base: [F, nq + nv + na] state that MuJoCo predicts for the next row, or [F, 0].
      start, length: [E] first row and number of control steps of each episode.
      attributes, world, mask: [E, N, D], [E, W], [E, N] (see `Context`).
      parts, part_mask: [E, P, D], [E, P] (see `Context`); empty without parts of mechanisms.
      group: [E] number of the subtask; `notes["groups"]` has the names.
      notes: where the data come from.
    """

    layout: Layout
    qpos: Tensor
    qvel: Tensor
    act: Tensor
    ctrl: Tensor
    action: Tensor
    hand: Tensor
    base: Tensor
    start: Tensor
    length: Tensor
    attributes: Tensor
    world: Tensor
    mask: Tensor
    group: Tensor
    notes: dict[str, Any]
    parts: Tensor
    part_mask: Tensor

    @property
    def episodes(self) -> int:
        """Number of episodes."""
        return len(self.start)

    @property
    def device(self) -> Any:
        """Where the tensors are."""
        return self.qpos.device

    def to(self, device: Any) -> Pack:
        """On another device."""
        names = (*_TENSORS, *_STATIC, "hand")
        moved = {name: getattr(self, name).to(device) for name in names}
        return dataclasses.replace(self, **moved)

    def controls(self, config: ModelConfig) -> Tensor:
        """The control that a configuration is driven by, [F, U]."""
        return self.ctrl if config.control == "ctrl" else self.action

    def states(self, rows: Tensor) -> Entities:
        """The entities at rows [...] of the data, flattened to one leading axis."""
        flat = rows.reshape(-1)
        x = self.layout.split(self.qpos[flat], self.qvel[flat], self.act[flat])
        return x._replace(hand=self.hand[flat])

    def predictions(self, rows: Tensor) -> Entities:
        """What MuJoCo predicts for the step after rows [...], flattened."""
        sizes = (self.layout.nq, self.layout.nv, self.layout.na)
        return self.layout.split(*self.base[rows.reshape(-1)].split(sizes, dim=1))

    def context(self, episodes: Tensor) -> Context:
        """The descriptors of episodes [B]."""
        known = (self.attributes[episodes], self.world[episodes], self.mask[episodes])
        if not self.layout.parts:
            return Context(*known)
        return Context(*known, self.parts[episodes], self.part_mask[episodes])

    def subset(self, episodes: Tensor) -> Pack:
        """Some of the episodes; the states stay where they are."""
        chosen = {name: getattr(self, name)[episodes] for name in ("start", "length", *_STATIC)}
        return dataclasses.replace(self, **chosen)

    def robots(self) -> Tensor:
        """[E]: a number for each robot, by what is known of its limbs; 0 without limbs."""
        if not self.layout.articulated:
            return torch.zeros_like(self.start)
        return self.parts.flatten(1).unique(dim=0, return_inverse=True)[1]

    def rows(self, chosen: Tensor) -> Tensor:
        """Rows of the states of some episodes [E], as a mask over all rows."""
        found = torch.zeros(len(self.qpos), dtype=torch.bool, device=self.device)
        for episode in torch.nonzero(chosen)[:, 0].tolist():
            first = int(self.start[episode])
            found[first : first + int(self.length[episode]) + 1] = True
        return found

    def split(self, held_out: float, seed: int = 0) -> tuple[Pack, Pack]:
        """Training and held-out episodes, drawn at random; at least one of each."""
        order = np.random.default_rng([seed, 7]).permutation(self.episodes)
        count = min(max(1, round(held_out * self.episodes)), self.episodes - 1)
        if count < 1:
            raise InputError("need at least two episodes: one to train on and one to hold out")
        held = torch.as_tensor(np.sort(order[:count]), device=self.device)
        kept = torch.as_tensor(np.sort(order[count:]), device=self.device)
        return self.subset(kept), self.subset(held)

    def transitions(self, limit: int = 200_000) -> tuple[Tensor, Tensor]:
        """Rows of states that a step follows, and their episodes; evenly thinned to a limit."""
        counts = self.length
        episode = torch.repeat_interleave(torch.arange(len(counts), device=self.device), counts)
        before = torch.cumsum(counts, 0) - counts
        row = torch.arange(int(counts.sum()), device=self.device) - before[episode]
        row = row + self.start[episode]
        stride = max(1, len(row) // limit)
        return row[::stride], episode[::stride]

    # -- files ---------------------------------------------------------------------------------

    def save(self, path: str | Path) -> None:
        """Writes the pack to a safetensors file."""
        tensors = {name: getattr(self, name).contiguous().cpu() for name in (*_TENSORS, *_STATIC)}
        if torch.equal(self.action, self.ctrl):
            del tensors["action"]
        header = {
            "schema": SCHEMA,
            "layout": json.dumps(self.layout.to_dict()),
            "notes": json.dumps(self.notes),
        }
        with writing(path) as part:
            save_file(tensors, str(part), metadata=header)

    @staticmethod
    def load(path: str | Path) -> Pack:
        """Reads a pack.

        Raises:
          InputError: the file is not a pack, or what it holds does not fit together.
        """
        size_of(path)
        try:
            with safe_open(str(path), framework="pt") as file:
                header = file.metadata() or {}
                if header.get("schema") != SCHEMA:
                    raise ValueError(f"schema is {header.get('schema')!r}, not {SCHEMA!r}")
                tensors = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118
            tensors.setdefault("action", tensors["ctrl"])
            none = no_parts(len(tensors["start"]))  # packs did not always have them
            for name, empty in none.items():
                tensors.setdefault(name, empty)
        except Exception as error:  # safetensors has an error type of its own
            raise InputError(f"{path}: not a pack of episodes ({error})") from None
        values, notes = (
            parse_json(header.get(name, ""), f"{path}, {name}") for name in ("layout", "notes")
        )
        layout = Layout.from_dict(values, f"{path}, layout")
        check_tensors(layout, tensors, notes, str(path))
        hand = hands(layout, tensors["qpos"], tensors["qvel"])
        return Pack(layout=layout, hand=hand, **tensors, notes=notes)


def no_parts(episodes: int) -> dict[str, Tensor]:
    """`Pack.parts` and `Pack.part_mask` of scenes without mechanisms."""
    return {"parts": torch.zeros(episodes, 0, 0), "part_mask": torch.zeros(episodes, 0)}


def hands(layout: Layout, qpos: Tensor, qvel: Tensor) -> Tensor:
    """Pose and velocity of the hand [F, 18] of states, or [F, 0] without a hand."""
    if not layout.hand:
        return torch.zeros(len(qpos), 0)
    kinematics = Kinematics(layout).double()
    parts = [
        kinematics(q[:, list(layout.joint_q)].double(), v[:, list(layout.joint_v)].double())
        for q, v in zip(qpos.split(65_536), qvel.split(65_536), strict=True)
    ]
    return torch.cat(parts).float()


def joined(packs: list[Pack]) -> Pack:
    """Packs of scenes with the same robot and up to as many objects or parts as the largest, as
    one.

    Raises:
      InputError: the scenes do not fit together.
    """
    if len(packs) == 1:
        return packs[0]
    largest = max(packs, key=lambda p: (len(p.layout.objects), len(p.layout.parts)))
    wanted = _common(packs, largest.layout)
    padded = [_padded(pack, wanted) for pack in packs]
    offsets = np.cumsum([0] + [len(pack.qpos) for pack in padded])
    names = [name for pack in padded for name in pack.notes["groups"]]
    firsts = np.cumsum([0] + [len(pack.notes["groups"]) for pack in padded])
    shifted = [
        dataclasses.replace(pack, start=pack.start + int(offset), group=pack.group + int(first))
        for pack, offset, first in zip(padded, offsets, firsts, strict=False)
    ]
    names_of_all = (*_TENSORS, *_STATIC, "hand")
    together = {n: torch.cat([getattr(p, n) for p in shifted]) for n in names_of_all}
    sources = [source for pack in packs for source in pack.notes["sources"]]
    notes = {**packs[0].notes, "groups": names, "sources": sources}
    return Pack(layout=wanted, **together, notes=notes)


def grouped(packs: list[Pack]) -> list[Pack]:
    """Packs of the same robot as one each, in the order in which the robots appear."""
    groups: dict[Any, list[Pack]] = {}
    for pack in packs:
        layout = pack.layout
        key: Any = (layout.robot, layout.nu, layout.hand, bool(layout.parts))
        if layout.articulated:  # any robot, if the engine integrates in the same way
            key = layout.runge_kutta
        groups.setdefault(key, []).append(pack)
    return [joined(group) for group in groups.values()]


def _common(packs: list[Pack], largest: Layout) -> Layout:
    """The largest layout; of limbs with as many controls and substeps as any has."""
    layouts = [pack.layout for pack in packs]
    if not largest.articulated or len({one.joints for one in layouts}) == 1:
        return largest
    return dataclasses.replace(
        largest,
        joints=tuple(f"limb{number}" for number in range(len(largest.joints))),
        nu=max(one.nu for one in layouts),
        substeps=max(one.substeps for one in layouts),
        timestep=min(one.timestep for one in layouts),
    )


def _padded_limbs(pack: Pack, want: Layout) -> Pack:
    """With limbs and controls that are not there added; each world knows its own step."""
    have = pack.layout
    if have.runge_kutta != want.runge_kutta or have.settings != want.settings:
        raise InputError(
            f"scenes do not fit into one batch: {have.joints} and {want.joints} are integrated in "
            "different ways"
        )
    lacking, controls = len(want.parts) - len(have.parts), want.nu - have.nu
    more = torch.zeros(pack.episodes, lacking, len(want.part_columns))
    ctrl = _columns(pack.ctrl, controls)
    return dataclasses.replace(
        pack,
        layout=want,
        qpos=_columns(pack.qpos, lacking),
        qvel=_columns(pack.qvel, lacking),
        ctrl=ctrl,
        action=ctrl,
        parts=torch.cat([pack.parts, more], dim=1),
        part_mask=_columns(pack.part_mask, lacking),
    )


def _padded(pack: Pack, layout: Layout) -> Pack:
    """With objects that are not there added, so that it has the larger layout."""
    have, want = pack.layout, layout
    if have.articulated and want.articulated:
        return _padded_limbs(pack, want)
    same = (
        have.robot == want.robot
        and have.nu == want.nu
        and have.attributes == want.attributes
        and have.timestep == want.timestep
        and have.part_columns == want.part_columns
        and len(have.parts) <= len(want.parts)
    )
    if not same or _robot_size(have) != _robot_size(want):
        raise InputError(
            f"scenes do not fit into one model: {have.joints}, {have.nu} controls, "
            f"{have.timestep:g} s against {want.joints}, {want.nu}, {want.timestep:g} s"
        )
    extra = len(want.objects) - len(have.objects)
    lacking = len(want.parts) - len(have.parts)
    if not extra and have.object_q == want.object_q and not lacking and have.parts == want.parts:
        return dataclasses.replace(pack, layout=want)
    x = have.split(pack.qpos, pack.qvel, pack.act)
    rows, episodes = len(pack.qpos), pack.episodes
    still, turned = torch.zeros(rows, extra, 3), torch.zeros(rows, extra, 4)
    turned[..., 0] = 1.0
    fields = {"pos": still, "quat": turned, "vel": still, "ang": still}
    grown = {n: torch.cat([getattr(x, n), more], dim=1) for n, more in fields.items()}
    joints = [*have.robot_joints, *have.parts, *range(len(have.joints), len(want.joints))]
    order = [joints[j] for j in _places(want)]
    grown |= {n: _columns(getattr(x, n), lacking)[:, order] for n in ("q", "v")}
    qpos, qvel, act = want.join(x._replace(**grown))
    more = torch.zeros(episodes, extra, len(want.attributes))
    return dataclasses.replace(
        pack,
        layout=want,
        qpos=qpos,
        qvel=qvel,
        act=act,
        attributes=torch.cat([pack.attributes, more], dim=1),
        mask=torch.cat([pack.mask, torch.zeros(episodes, extra)], dim=1),
        parts=torch.cat([pack.parts, torch.zeros(episodes, lacking, len(want.part_columns))], 1),
        part_mask=_columns(pack.part_mask, lacking),
    )


def _robot_size(layout: Layout) -> int:
    return layout.nq - 7 * len(layout.objects) - len(layout.parts)


def _columns(rows: Tensor, more: int) -> Tensor:
    """Rows [F, J] with so many zeros after each."""
    return torch.nn.functional.pad(rows, (0, more))


def _places(layout: Layout) -> list[int]:
    """For each joint, its number among the robot's joints and then the parts."""
    known = (*layout.robot_joints, *layout.parts)
    return [known.index(joint) for joint in range(len(layout.joints))]
