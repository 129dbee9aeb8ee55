"""A learned residual force: what is left when no named effect explains it. It is no effect.

Small tanh networks, one for each joint that needs a force, map joint positions, velocities,
controls and applied forces to the joint's generalized force. They stand as JSON (schema
`orbisim.rest/1`) in
`<custom><text name="orbisim:rest">`, which plain MuJoCo carries and ignores and which the classical
backends apply at every timestep, before any effect. Inputs are kept within the range that was seen,
so that the force is bounded and constant beyond it.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from typing import Any, Literal, get_args

import mujoco
import numpy as np
import numpy.typing as npt

from orbisim.effects.base import Hook, StepInputs
from orbisim.errors import InputError, SceneError, UnknownNameError
from orbisim.recording.joints import Joint, Kind, joints
from orbisim.scene import Scene
from orbisim.scene.texts import read_text, replace_text

Floats = npt.NDArray[np.float64]
Source = Literal["position", "turn", "pose", "velocity", "control", "force"]

TEXT_NAME = "orbisim:rest"
SCHEMA = "orbisim.rest/1"


@dataclasses.dataclass(frozen=True)
class Input:
    """What a network reads.

    Attributes:
      source: `position` of a hinge or slide; `turn`: sine and cosine of a hinge's angle; `pose`: of
        a ball or free joint, translation (free only) and rotation matrix; `velocity` and applied
        `force` of a joint; `control`.
      name: the joint, or the number of the control.
    """

    source: Source
    name: str


@dataclasses.dataclass(frozen=True, eq=False)
class Network:
    """The force at one joint.

    Attributes:
      joint: whose degrees of freedom feel it. inputs: what it reads, F numbers in all.
      centre, scale: [F]; inputs are shifted and divided by them.
      low, high: [F]; then kept within these.
      layers: weights [in, out] and biases [out], with tanh between them; the last gives the force.
    """

    joint: str
    inputs: tuple[Input, ...]
    centre: Floats
    scale: Floats
    low: Floats
    high: Floats
    layers: tuple[tuple[Floats, Floats], ...]

    def force(self, features: Floats) -> Floats:
        """Generalized force [..., nv of the joint] from features [..., F]."""
        x = np.clip((features - self.centre) / self.scale, self.low, self.high)
        for weight, bias in self.layers[:-1]:
            x = np.tanh(x @ weight + bias)
        weight, bias = self.layers[-1]
        return np.asarray(x @ weight + bias)

    def to_json(self) -> dict[str, Any]:
        """As it stands in the MJCF."""
        return {
            "joint": self.joint,
            "inputs": [[one.source, one.name] for one in self.inputs],
            **{name: _plain(getattr(self, name)) for name in _PER_FEATURE},
            "layers": [[_plain(weight), _plain(bias)] for weight, bias in self.layers],
        }

    @staticmethod
    def from_json(data: Mapping[str, Any], model: mujoco.MjModel) -> Network:
        """Reads what `to_json` wrote.

        Raises:
          InputError: something is missing, not finite, or of a size that does not fit the scene.
          UnknownNameError: it names a joint that the scene lacks.
        """
        try:
            inputs = tuple(Input(source, str(name)) for source, name in data["inputs"])
            parts = {name: np.array(data[name], np.float64) for name in _PER_FEATURE}
            layers = tuple(
                (np.array(weight, np.float64), np.array(bias, np.float64))
                for weight, bias in data["layers"]
            )
            network = Network(joint=str(data["joint"]), inputs=inputs, layers=layers, **parts)
        except (KeyError, TypeError, ValueError) as error:
            raise InputError(f"not a learned force: {error!r}") from None
        _check(network, model)
        return network


_PER_FEATURE = ("centre", "scale", "low", "high")


def _plain(values: Floats) -> Any:
    """Numbers with the digits of single precision."""
    if values.ndim > 1:
        return [_plain(row) for row in values]
    return [float(f"{value:.8g}") for value in values]


def _check(network: Network, model: mujoco.MjModel) -> None:
    every = {j.label: j for j in joints(model)}
    if network.joint not in every:
        raise UnknownNameError("joint", network.joint, every)
    width = sum(_width(model, one) for one in network.inputs)
    for name in _PER_FEATURE:
        if getattr(network, name).shape != (width,):
            raise InputError(f"{name} must hold {width} numbers, one for each input")
    if not (network.scale > 0).all():
        raise InputError("scale must be positive")
    for weight, bias in network.layers:
        if weight.ndim != 2 or weight.shape[0] != width or bias.shape != weight.shape[1:]:
            raise InputError(f"a layer has weights {weight.shape}; it is given {width} numbers")
        width = weight.shape[1]
    own = every[network.joint].v
    if not network.layers or width != own.stop - own.start:
        raise InputError(f"the last layer must give {own.stop - own.start} numbers")
    numbers = [
        *(getattr(network, n) for n in _PER_FEATURE),
        *(a for p in network.layers for a in p),
    ]
    if not all(np.isfinite(part).all() for part in numbers):
        raise InputError("it holds numbers that are not finite")


# -- features --------------------------------------------------------------------------------------


def _width(model: mujoco.MjModel, one: Input) -> int:
    if one.source not in get_args(Source):
        raise InputError(f"no such input: {one.source!r}; known are {', '.join(get_args(Source))}")
    if one.source == "control":
        if not one.name.isdigit() or int(one.name) >= model.nu:
            raise InputError(f"there is no control number {one.name!r}; the scene has {model.nu}")
        return 1
    joint = _joint(model, one)
    if one.source in ("velocity", "force"):
        return joint.v.stop - joint.v.start
    if joint.scalar == (one.source == "pose") or (
        one.source == "turn" and joint.kind != Kind.HINGE
    ):
        raise InputError(f"joint {one.name!r} has no {one.source}")
    return {"position": 1, "turn": 2}.get(one.source, 12 if joint.kind == Kind.FREE else 9)


def _joint(model: mujoco.MjModel, one: Input) -> Joint:
    every = {j.label: j for j in joints(model)}
    if one.name not in every:
        raise UnknownNameError("joint", one.name, every)
    return every[one.name]


def features(
    model: mujoco.MjModel,
    inputs: Sequence[Input],
    qpos: Floats,
    qvel: Floats,
    ctrl: Floats,
    force: Floats,
) -> Floats:
    """What a network reads, [N, F].

    Args:
      qpos: [N, nq]. qvel: [N, nv]. ctrl: [N, nu]. force: [N, nv] applied generalized force.
    """
    every = {j.label: j for j in joints(model)}
    parts: list[Floats] = []
    for one in inputs:
        if one.source == "control":
            parts.append(ctrl[:, [int(one.name)]])
            continue
        joint = every[one.name]
        if one.source in ("velocity", "force"):
            parts.append((qvel if one.source == "velocity" else force)[:, joint.v])
        elif one.source == "position":
            parts.append(qpos[:, joint.q])
        elif one.source == "turn":
            parts += [np.sin(qpos[:, joint.q]), np.cos(qpos[:, joint.q])]
        else:
            parts.append(_pose(qpos, joint))
    return np.concatenate(parts, axis=1)


def _pose(qpos: Floats, joint: Joint) -> Floats:
    assert joint.quat is not None
    w, x, y, z = np.moveaxis(qpos[:, joint.quat], 1, 0)
    rotation = [
        1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y),
        2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x),
        2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y),
    ]  # fmt: skip
    place = [] if joint.kind == Kind.BALL else list(qpos[:, joint.q.start : joint.q.start + 3].T)
    return np.stack([*place, *rotation], axis=1)


# -- in a scene and in a simulation ----------------------------------------------------------------


class RestHook(Hook):
    """Applies learned forces."""

    def __init__(self, model: mujoco.MjModel, networks: Sequence[Network]) -> None:
        super().__init__({})
        places = {j.label: j.v for j in joints(model)}
        self._parts = [(network, places[network.joint]) for network in networks]

    def force(self, inputs: StepInputs) -> None:
        """Adds to `inputs.qfrc` in place."""
        applied = inputs.qfrc.copy()
        for network, place in self._parts:
            read = features(
                inputs.model, network.inputs, inputs.qpos, inputs.qvel, inputs.ctrl, applied
            )
            inputs.qfrc[:, place] += network.force(read)


def with_rest(scene: Scene, networks: Sequence[Network]) -> Scene:
    """The scene with learned forces in place of those that it may have.

    Raises:
      InputError: one does not fit the scene, or the scene cannot be edited.
    """
    spec = scene.spec
    for network in networks:
        _check(network, scene.model)
    data = {"schema": SCHEMA, "forces": [network.to_json() for network in networks]}
    replace_text(spec, TEXT_NAME, data if networks else None)
    return Scene.from_spec(spec, source=scene.source, unsupported=scene.unsupported)


def carried_rest(model: mujoco.MjModel, source: str = "scene") -> tuple[Network, ...]:
    """The learned forces that a compiled model carries.

    Raises:
      SceneError: the text is not what `with_rest` writes, or does not fit the scene.
    """
    try:
        data = read_text(model, TEXT_NAME)
        if data is None:
            return ()
        if not isinstance(data, dict) or data.get("schema") != SCHEMA:
            raise InputError(f"expected an object of schema {SCHEMA!r}")
        return tuple(Network.from_json(one, model) for one in data.get("forces", []))
    except (ValueError, TypeError, AttributeError, InputError, UnknownNameError) as error:
        raise SceneError(source, str(error), element=f"<custom><text name='{TEXT_NAME}'>") from None


def rest_hooks(model: mujoco.MjModel) -> list[Hook]:
    """The hook of the learned forces that a model carries; none if there are none."""
    networks = carried_rest(model)
    return [RestHook(model, networks)] if networks else []
