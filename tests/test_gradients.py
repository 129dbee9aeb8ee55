"""Gradients through backends that know none, against finite differences."""

from __future__ import annotations

from importlib.util import find_spec

import numpy as np
import pytest

from orbisim import suite
from orbisim.registry import make_backend
from orbisim.scene import load_scene
from orbisim.testing import scenes

torch = pytest.importorskip("torch")

BALL = """
<mujoco>
  <option timestep="0.005"/>
  <worldbody>
    <body><joint name="ball" type="ball" damping="0.1"/>
      <geom type="capsule" fromto="0 0 0 0.1 0 -0.4" size="0.03" mass="1"/>
      <body pos="0.1 0 -0.4"><joint axis="0 1 0"/>
        <geom type="box" size="0.1 0.05 0.02" mass="0.3"/></body>
    </body>
    <body pos="1 0 1"><freejoint/><geom type="box" size="0.1 0.2 0.3" mass="2"/></body>
  </worldbody>
  <actuator><motor joint="ball" gear="0.3 1 0.2"/></actuator>
</mujoco>
"""


def loss_of(states, weights):
    final = states[-1]
    return (final.qpos * weights[0]).sum() + (final.qvel * weights[1]).sum()


@pytest.mark.parametrize("source", [scenes.CARTPOLE, scenes.FILTERED, BALL])
def test_gradient_of_a_rollout(source):
    from orbisim import gradients

    scene = load_scene(source)
    backend = make_backend("mujoco", scene, nworld=2)
    rng = np.random.default_rng(0)
    state = backend.reset()
    state = state.replace(qvel=rng.normal(size=state.qvel.shape))
    state = backend.step(state, None, 5)  # a generic orientation
    model = scene.model
    weights = torch.as_tensor(rng.normal(size=model.nq)), torch.as_tensor(rng.normal(size=model.nv))
    controls = torch.as_tensor(0.1 * rng.normal(size=(2, 6, model.nu)), dtype=torch.float64)
    controls.requires_grad_()
    qpos, qvel = (torch.as_tensor(a).requires_grad_() for a in (state.qpos, state.qvel))
    start = state.replace(qpos=qpos, qvel=qvel)
    loss_of(gradients.rollout(backend, start, controls), weights).backward()

    def value(dq=None, dv=None, du=None):
        from orbisim.tangent import perturbed

        tangent = np.zeros((2, 2 * model.nv + model.na))
        if dq is not None:
            tangent[:, : model.nv] = dq
        if dv is not None:
            tangent[:, model.nv : 2 * model.nv] = dv
        moved = perturbed(model, state, tangent)
        held = controls.detach() if du is None else controls.detach() + du
        return float(loss_of(gradients.rollout(backend, moved, held), weights))

    eps = 1e-6
    for _ in range(3):
        dv = rng.normal(size=state.qvel.shape)
        slope = (value(dv=eps * dv) - value(dv=-eps * dv)) / (2 * eps)
        assert float((qvel.grad * torch.as_tensor(dv)).sum()) == pytest.approx(
            slope, rel=1e-4, abs=1e-6
        )
        if model.nu:
            du = torch.as_tensor(rng.normal(size=controls.shape))
            slope = (value(du=eps * du) - value(du=-eps * du)) / (2 * eps)
            assert float((controls.grad * du).sum()) == pytest.approx(slope, rel=1e-4, abs=1e-6)
        dq = rng.normal(size=state.qvel.shape)
        slope = (value(dq=eps * dq) - value(dq=-eps * dq)) / (2 * eps)
        from orbisim.gradients import _to_tangent

        tangent = _to_tangent(model, state.qpos, qpos.grad.numpy())
        assert float((tangent * dq).sum()) == pytest.approx(slope, rel=1e-4, abs=1e-6)


def test_descent_reaches_a_target():
    """Gradient descent on the controls moves the cart where it should be."""
    from orbisim import gradients

    backend = make_backend("mujoco", load_scene(scenes.CARTPOLE))
    controls = torch.zeros((1, 20, 1), dtype=torch.float64, requires_grad=True)
    optimiser = torch.optim.Adam([controls], lr=0.02)
    for _ in range(150):
        optimiser.zero_grad()
        final = gradients.rollout(backend, backend.reset(), controls)[-1]
        loss = (final.qpos[0, 0] - 0.02) ** 2
        loss.backward()
        optimiser.step()
    assert loss.item() < 1e-6


DOMAINS = sorted(dict(suite.ALL_TASKS).items())


@pytest.mark.parametrize(("domain", "task"), DOMAINS, ids=[domain for domain, _ in DOMAINS])
def test_every_scene_of_the_suite_has_gradients(domain, task):
    """Some are integrated by Runge-Kutta, which MuJoCo's own differences refuse."""
    from orbisim import gradients

    environment = suite.load(domain, task, {"random": 1})
    environment.reset()
    physics = environment.physics
    backend = make_backend("mujoco", physics.scene)
    state = backend.step(physics.snapshot(), None, 3)
    control = torch.zeros((1, backend.model.nu), dtype=torch.float64, requires_grad=True)
    qvel = torch.as_tensor(state.qvel).requires_grad_()
    after = gradients.step(backend, state.replace(qvel=qvel), control)
    direction = torch.as_tensor(np.random.default_rng(0).normal(size=state.qvel.shape))
    (after.qvel * direction).sum().backward()
    assert torch.isfinite(qvel.grad).all()
    eps = 1e-6
    ahead, behind = (
        backend.step(state.replace(qvel=state.qvel + sign * eps * direction.numpy()))
        for sign in (1, -1)
    )
    slope = ((ahead.qvel - behind.qvel) / (2 * eps) * direction.numpy()).sum()
    assert float((qvel.grad * direction).sum()) == pytest.approx(slope, rel=1e-3, abs=1e-4)


@pytest.mark.skipif(not find_spec("mujoco_warp"), reason="MuJoCo-Warp is not installed")
def test_single_precision_is_differenced_over_longer_ways():
    """Differences of 1e-6 in float32 are noise."""
    scene = load_scene(scenes.CARTPOLE)
    exact, coarse = (make_backend(name, scene) for name in ("mujoco", "warp"))
    state = exact.reset().replace(qvel=np.array([[0.3, -0.2]]))
    expected, found = exact.linearize(state), coarse.linearize(state)
    np.testing.assert_allclose(found.A, expected.A, atol=1e-4)
    np.testing.assert_allclose(found.B, expected.B, atol=1e-4)


def test_arguments_are_checked():
    from orbisim import gradients
    from orbisim.errors import InputError

    backend = make_backend("mujoco", load_scene(scenes.CARTPOLE))
    state = backend.reset()
    with pytest.raises(InputError, match="nstep"):
        gradients.step(backend, state, torch.zeros(1), nstep=0)
    with pytest.raises(InputError, match="control has shape"):
        gradients.step(backend, state, torch.zeros(2))
    with pytest.raises(InputError, match="controls have shape"):
        gradients.rollout(backend, state, torch.zeros((2, 3, 4, 1)))
