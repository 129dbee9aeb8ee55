"""Gradients through any backend, as torch autograd functions.

A backend that is differentiable itself is used as it is. Any other is linearized at each step:
with the Jacobians A and B of the step in the tangent space of the state (dq, v, act), the
backward pass is g_x = A^T g_x', g_u = B^T g_x'. Gradients of quaternions are taken through the
exponential map: for q' = q * exp(w/2), dq = 1/2 G(q) w with orthonormal columns G(q), so that a
cotangent of q becomes 1/2 G^T g in the tangent space, and a cotangent of w becomes 2 G g of q.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import mujoco
import numpy as np
import numpy.typing as npt

from orbisim.backend import Backend, Capability
from orbisim.errors import MissingDependencyError
from orbisim.state import Array, State

try:
    import torch
except ImportError as error:  # pragma: no cover
    raise MissingDependencyError("gradients", "learned", "no module 'torch'") from error

Floats = npt.NDArray[np.float64]


def step(backend: Backend, state: State, control: Array, nstep: int = 1) -> State:
    """One differentiable step.

    Args:
      backend: any backend.
      state: with torch tensors for what gradients are wanted of (NumPy arrays are taken as
        constants). Contacts, limits and other constraints are linearized where they are.
      control: [nu] or [nworld, nu] tensor, held for `nstep` steps.

    Returns:
      The next state with float64 tensors for qpos, qvel and act.

    Raises:
      DivergedError, InputError: as `Backend.step`.
    """
    if Capability.DIFFERENTIABLE in backend.capabilities:
        return backend.step(state, control, nstep)
    control, nstep = backend.check_step(state, control, nstep)
    current = state.replace(
        qpos=_tensor(state.qpos), qvel=_tensor(state.qvel), act=_tensor(state.act)
    )
    control = _tensor(control)
    for _ in range(nstep):
        current = _linearized_step(backend, current, control)
    return current


def rollout(backend: Backend, state: State, controls: Array, nstep: int = 1) -> list[State]:
    """Differentiable states after each of the controls [T, nu] or [nworld, T, nu]."""
    controls, nstep = backend.check_rollout(state, controls, nstep)
    controls = _tensor(controls)
    states: list[State] = []
    for t in range(controls.shape[1]):
        state = step(backend, state, controls[:, t], nstep)
        states.append(state)
    return states


def _linearized_step(backend: Backend, state: State, control: Any) -> State:
    carrier: dict[str, Any] = {"backend": backend, "state": state}
    qpos, qvel, act = _Step.apply(carrier, state.qpos, state.qvel, state.act, control)
    after: State = carrier["after"]
    return after.replace(qpos=qpos, qvel=qvel, act=act)


class _Step(torch.autograd.Function):
    """One step of a backend that knows no gradients, with its linearization."""

    @staticmethod
    def forward(
        ctx: Any, carrier: dict[str, Any], qpos: Any, qvel: Any, act: Any, control: Any
    ) -> Any:
        backend: Backend = carrier["backend"]
        host = carrier["state"].replace(qpos=qpos, qvel=qvel, act=act).numpy()
        host_control = control.detach().cpu().numpy()
        after = backend.step(host, host_control).numpy()
        carrier["after"] = after
        ctx.backend, ctx.before, ctx.after, ctx.control = backend, host, after, host_control
        return tuple(torch.as_tensor(a) for a in (after.qpos, after.qvel, after.act))

    @staticmethod
    def backward(ctx: Any, g_qpos: Any, g_qvel: Any, g_act: Any) -> Any:
        backend: Backend = ctx.backend
        model = backend.model
        found = backend.linearize(ctx.before, ctx.control)
        nv = model.nv
        g_tangent = _to_tangent(model, ctx.after.qpos, g_qpos.numpy())
        g = np.concatenate([g_tangent, g_qvel.numpy(), g_act.numpy()], axis=1)
        g_x = np.einsum("wij,wi->wj", np.asarray(found.A, np.float64), g)
        g_u = np.einsum("wij,wi->wj", np.asarray(found.B, np.float64), g)
        g_q = _from_tangent(model, ctx.before.qpos, g_x[:, :nv])
        grads = (g_q, g_x[:, nv : 2 * nv], g_x[:, 2 * nv :], g_u)
        return (None, *(torch.as_tensor(grad) for grad in grads))


def _joints(model: mujoco.MjModel) -> Iterator[tuple[int, int, int, bool]]:
    """For each block of coordinates: address in qpos, address in qvel, size, is it a rotation."""
    for joint in range(model.njnt):
        q, v = int(model.jnt_qposadr[joint]), int(model.jnt_dofadr[joint])
        kind = model.jnt_type[joint]
        if kind == mujoco.mjtJoint.mjJNT_FREE:
            yield q, v, 3, False
            yield q + 3, v + 3, 3, True
        elif kind == mujoco.mjtJoint.mjJNT_BALL:
            yield q, v, 3, True
        else:
            yield q, v, 1, False


def _to_tangent(model: mujoco.MjModel, qpos: Floats, cotangent: Floats) -> Floats:
    """Cotangents of qpos [n, nq] as cotangents of the tangent space [n, nv]."""
    result = np.zeros((len(qpos), model.nv))
    for q, v, size, turns in _joints(model):
        if turns:
            frame = _quaternion_frame(qpos[:, q : q + 4])
            result[:, v : v + 3] = 0.5 * np.einsum("nij,ni->nj", frame, cotangent[:, q : q + 4])
        else:
            result[:, v : v + size] = cotangent[:, q : q + size]
    return result


def _from_tangent(model: mujoco.MjModel, qpos: Floats, cotangent: Floats) -> Floats:
    """Cotangents of the tangent space [n, nv] as cotangents of qpos [n, nq]."""
    result = np.zeros((len(qpos), model.nq))
    for q, v, size, turns in _joints(model):
        if turns:
            frame = _quaternion_frame(qpos[:, q : q + 4])
            result[:, q : q + 4] = 2.0 * np.einsum("nij,nj->ni", frame, cotangent[:, v : v + 3])
        else:
            result[:, q : q + size] = cotangent[:, v : v + size]
    return result


def _quaternion_frame(quat: Floats) -> Floats:
    """G(q) [n, 4, 3]: columns are q * i, q * j, q * k, the tangent directions at q."""
    w, x, y, z = quat.T
    return np.stack(
        [
            np.stack([-x, -y, -z], axis=1),
            np.stack([w, -z, y], axis=1),
            np.stack([z, w, -x], axis=1),
            np.stack([-y, x, w], axis=1),
        ],
        axis=1,
    )


def _tensor(array: Array) -> Any:
    if hasattr(array, "detach"):
        return array.to(torch.float64)
    return torch.as_tensor(np.asarray(array), dtype=torch.float64)
