"""A recording in a scene's order: what of the state, the controls and the sensors is known when."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from orbisim.errors import RecordingError
from orbisim.recording import inference, inverse
from orbisim.recording.actuators import Actuator, actuators
from orbisim.recording.assembly import Assembly
from orbisim.recording.bound import Bound
from orbisim.recording.checks import suspicions
from orbisim.recording.formats.log import Column
from orbisim.recording.joints import Joint, body_label, joints
from orbisim.recording.matching import matches
from orbisim.recording.recording import Recording
from orbisim.recording.sensors import reads_state, sensors
from orbisim.recording.zero_order_hold import Held, filled
from orbisim.scene import Scene
from orbisim.scene.hidden import hidden_joints

Floats = npt.NDArray[np.float64]
Bools = npt.NDArray[np.bool_]

_MOST_COLUMNS = 20
"""Columns of the file that an error lists."""
_MOST_LOOKED_AT = 500
"""Columns that are compared with the signals of the scene."""


def bind(recording: Recording, scene: Scene) -> Bound:
    """Puts a recording into a scene's order.

    A joint that is not recorded is inferred from the pose of its body (free joints), from a joint
    equality, or from body poses by inverse kinematics if these have one solution.

    Raises:
      RecordingError: a name is not in the scene, a shape or unit does not fit, a quaternion is not
        of unit norm, or a joint is neither recorded nor can be inferred.
    """
    if len(recording) < 2:
        raise RecordingError(
            recording.source, "has one sample", remedy="a simulation needs at least two"
        )
    binder = _Binder(recording, scene)
    bound = binder.bind()
    found = tuple(suspicions(bound))
    notes = (*bound.notes, *(one.text for one in found))
    return dataclasses.replace(bound, notes=notes, suspicions=found)


def held_inputs(recording: Recording, like: Bound) -> tuple[Held, Held]:
    """Controls [., nu] and the joint forces that drive the scene [., nv], as they are held from
    sample to sample, of a recording with the signals of one that is bound."""
    binder = _Binder(recording, like.scene)
    ctrl = binder.fill("ctrl", like.model.nu, {a.name: a.ctrl for a in binder.actuators})
    torque = binder.fill("torque", like.model.nv, {j.name: j.v for j in binder.joints})
    applied = np.where(like.applied, np.nan_to_num(torque), 0.0)
    time = recording.time
    return Held(time, binder.hold(ctrl, like.switched_off)), Held(time, applied)


class _Binder(Assembly):
    """Fills the arrays of a `Bound` one kind of signal after the other."""

    def __init__(self, recording: Recording, scene: Scene) -> None:
        super().__init__(recording, scene)
        self.joints, self.actuators = joints(self.model), actuators(self.model)

    def bind(self) -> Bound:
        model = self.model
        self.check_names()
        qpos = self.fill("qpos", model.nq, {j.name: j.q for j in self.joints})
        qvel = self.fill("qvel", model.nv, {j.name: j.v for j in self.joints})
        ctrl = self.fill("ctrl", model.nu, {a.name: a.ctrl for a in self.actuators})
        torque = self.fill("torque", model.nv, {j.name: j.v for j in self.joints})
        xpos, xquat = self.poses("xpos", 3), self.poses("xquat", 4)
        for joint in self.joints:
            if joint.quat is not None:
                qpos[:, joint.quat] = self.unit(qpos[:, joint.quat], f"qpos/{joint.label}")
        sensordata = self.sensors()
        self.read(sensordata, qpos, qvel, xpos, xquat)
        self.rest(qpos, qvel)
        measured, unseen = self.infer(qpos, xpos, xquat)
        applied, switched_off = self.forces(torque, ctrl)
        return Bound(
            recording=self.recording,
            scene=self.scene,
            time=self.recording.time,
            qpos=qpos,
            qvel=qvel,
            ctrl=self.hold(ctrl, switched_off),
            torque=torque,
            applied=applied,
            switched_off=switched_off,
            xpos=xpos,
            xquat=xquat,
            sensordata=sensordata,
            measured=measured,
            unseen_turns=unseen,
            notes=tuple(dict.fromkeys(self.notes)),
        )

    def read(
        self,
        sensordata: Floats,
        qpos: Floats,
        qvel: Floats,
        xpos: dict[int, Floats],
        xquat: dict[int, Floats],
    ) -> None:
        """Fills what is not recorded by name from undelayed sensors that read it."""
        state = {"qpos": qpos, "qvel": qvel}
        poses = {"xpos": xpos, "xquat": xquat}
        known = all(np.isfinite(qpos[:, j.q]).any() for j in self.joints)
        for sensor in sensors(self.model):
            values = sensordata[:, sensor.place]
            reads = reads_state(self.model, sensor)
            if reads is None or sensor.delayed or not np.isfinite(values).any():
                continue
            kind, target = reads
            if sensor.rotation:
                values = self.unit(values, f"sensor/{sensor.label}")
            if kind in poses:
                if not known:
                    poses[kind].setdefault(target, values)
                continue
            joint = self.joints[target]
            place = joint.q if kind == "qpos" else joint.v
            if not np.isfinite(state[kind][:, place]).any():
                state[kind][:, place] = values
                self.notes.append(f"'{kind}/{joint.label}' from sensor {sensor.label!r}")

    def rest(self, qpos: Floats, qvel: Floats) -> None:
        """Joints that effects have added, which nothing reads, are at rest for now."""
        hidden = hidden_joints(self.model)
        for joint in self.joints:
            if joint.name in hidden and not np.isfinite(qpos[:, joint.q]).any():
                qpos[:, joint.q] = self.model.qpos0[joint.q]
                qvel[:, joint.v] = 0.0
                self.notes.append(
                    f"joint {joint.name!r}, which an effect added, is not recorded; its state is "
                    "carried along the recording"
                )

    # -- what is not recorded ----------------------------------------------------------------------

    def infer(
        self, qpos: Floats, xpos: inference.Poses, xquat: inference.Poses
    ) -> tuple[frozenset[int], frozenset[int]]:
        """Fills the joints that are not recorded; measured joints, and those turning unseen."""
        known = {j.id for j in self.joints if np.isfinite(qpos[:, j.q]).all(axis=1).any()}
        hidden = {j.id for j in self.joints if j.name in hidden_joints(self.model)}
        unseen = set()
        for joint in self.joints:
            if joint.id not in known:
                note = inference.from_own_pose(self.model, qpos, joint, xpos, xquat)
                if note is not None:
                    known.add(joint.id)
                    self.notes.extend([note] if note else [])
                    unseen |= {joint.id} if note else set()
        measured = known - hidden
        self.couple(qpos, known)
        unknown = [j for j in self.joints if j.id not in known]
        if unknown:
            measured |= self.invert(qpos, unknown, xpos, xquat)
        return frozenset(measured), frozenset(unseen)

    def couple(self, qpos: Floats, known: set[int]) -> None:
        for target, source in inference.from_couplings(self.model, qpos, known).items():
            leads = f"follows {self.joints[source].label!r}" if source >= 0 else "is fixed"
            self.notes.append(f"joint {self.joints[target].label!r} {leads} by a joint equality")

    def invert(
        self,
        qpos: Floats,
        unknown: Sequence[Joint],
        xpos: inference.Poses,
        xquat: inference.Poses,
    ) -> set[int]:
        found = inverse.solve(self.model, qpos, unknown, xpos, xquat)
        if found.undetermined or found.ambiguous:
            self.not_recorded(found)
        labels = ", ".join(repr(j.label) for j in found.solved)
        bodies = ", ".join(repr(body_label(self.model, b)) for b in {*xpos, *xquat})
        self.notes.append(
            f"joints {labels} from the poses of {bodies} by inverse kinematics, misfit "
            f"{found.rms:.2g} m"
        )
        return {j.id for j in found.solved}

    def not_recorded(self, found: inverse.Solution) -> None:
        """Raises `RecordingError` naming the joints that cannot be inferred."""
        missing = found.undetermined or found.ambiguous
        labels = ", ".join(repr(j.label) for j in missing)
        why = (
            "and the recorded body poses fit more than one configuration"
            if found.ambiguous
            else "and nothing that is recorded fixes it"
            if len(missing) == 1
            else "and nothing that is recorded fixes them"
        )
        example = missing[0]
        remedy = f"record 'qpos/{example.label}'"
        names = [f"qpos/{example.label}"]
        if example.kind == 0:
            body = body_label(self.model, example.body)
            remedy += f", or 'xpos/{body}' and 'xquat/{body}'"
            names.append(f"xpos/{body}")
        unseen = [name for name in names if name in self.recording.signals]
        if unseen:
            first, last = self.recording.time[[0, -1]]
            why += f": {unseen[0]!r} has no sample from {first:.4g} to {last:.4g} s"
            remedy = "leave out the stretch in which it is not seen, or " + remedy
        plural = "joint" if len(missing) == 1 else "joints"
        raise RecordingError(
            self.recording.source,
            f"{plural} {labels} of scene {self.scene.name!r} not recorded, {why}",
            remedy=remedy + self.unused(),
        )

    def unused(self) -> str:
        """What else the file holds, and which signals of the scene that may be."""
        columns = self.recording.columns
        if not columns:
            return ""
        shown = ", ".join(repr(name) for name in columns[:_MOST_COLUMNS])
        more = f" and {len(columns) - _MOST_COLUMNS} more" if len(columns) > _MOST_COLUMNS else ""
        given = [Column(name) for name in columns[:_MOST_LOOKED_AT]]
        like = [m for m in matches(given, self.model, table=True) if m.likeness < 1.0]
        pairs = ", ".join(f"{m.column.name!r} is {m.signal!r}" for m in like[:_MOST_COLUMNS])
        hint = f" (perhaps {pairs})" if pairs else ""
        return (
            f". The file has the columns {shown}{more}, which are not named as signals: say in a "
            f"map which ones they are{hint}; 'orbisim recording init LOG --scene SCENE' writes a "
            "first one"
        )

    # -- what drives the scene ---------------------------------------------------------------------

    def forces(self, torque: Floats, ctrl: Floats) -> tuple[Bools, tuple[int, ...]]:
        """Which recorded forces drive their joints, and the actuators they stand for."""
        applied = np.zeros(self.model.nv, bool)
        off: list[int] = []
        for joint in self.joints:
            if not np.isfinite(torque[:, joint.v]).any():
                continue
            acting = [a for a in self.actuators if a.joint == joint.id and a.driven]
            if any(np.isfinite(ctrl[:, a.ctrl]).any() for a in acting):
                continue
            applied[joint.v] = True
            off += [a.id for a in acting]
            if acting:
                self.notes.append(
                    f"'torque/{joint.label}' stands for {_listed(acting)}, whose controls are not "
                    "recorded: switched off"
                )
        return applied, tuple(off)

    def hold(self, ctrl: Floats, switched_off: Sequence[int]) -> Floats:
        """Controls without NaN; those that are not recorded are zero."""
        seen = np.isfinite(ctrl)
        absent = [
            a
            for a in self.actuators
            if a.driven and a.id not in switched_off and not seen[:, a.ctrl].any()
        ]
        if absent:
            nameless = not all(a.name for a in absent)
            remedy = "; to be recorded an actuator needs a name in the scene" if nameless else ""
            self.notes.append(
                f"controls of {_listed(absent)} are not recorded; taken as zero{remedy}"
            )
        some = seen.any(axis=0)
        if (~seen[:, some]).any():
            self.notes.append("missing controls hold the sample before them")
        return np.nan_to_num(filled(ctrl))


def _listed(some: Sequence[Actuator]) -> str:
    return ", ".join(repr(actuator.label) for actuator in some)
