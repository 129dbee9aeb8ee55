"""From a recording to a descriptor, by mujoco.sysid and by gradients."""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest
import torch

from orbisim import Recording, identify, load_scene
from orbisim.errors import DivergedError, InputError
from orbisim.identification.learned import identify_learned
from orbisim.identification.parameters import parameters
from orbisim.identification.windows import grid
from orbisim.recording import bind
from orbisim.replay import prepare
from orbisim.state import State

XML = """
<mujoco model="slide">
  <option timestep="0.005" integrator="implicitfast" cone="elliptic"/>
  <worldbody>
    <geom name="floor" type="plane" size="9 9 0.1" priority="1" friction="0.4"/>
    <body name="box" pos="0 0 0.05"><freejoint name="box"/>
      <geom name="box" type="box" size="0.05 0.05 0.05" density="500"/></body>
  </worldbody>
</mujoco>
"""
TRUE = 0.25


@pytest.fixture(scope="module")
def slides() -> list[Recording]:
    """Of a box that slides to rest on a floor that is slipperier than declared."""
    model = mujoco.MjModel.from_xml_string(XML.replace('friction="0.4"', f'friction="{TRUE}"'))
    found = []
    for speed in (1.0, 1.6, 2.2):
        data = mujoco.MjData(model)
        data.qpos[2], data.qvel[0] = 0.0499, speed
        rows = []
        for _ in range(161):
            rows.append((data.time, data.qpos.copy(), data.qvel.copy()))
            mujoco.mj_step(model, data, 1)
        time, qpos, qvel = (np.array(x)[::4] for x in zip(*rows, strict=True))
        found.append(Recording(time, {"qpos": qpos, "qvel": qvel}, source=f"{speed}"))
    return found


def test_mujoco_sysid_finds_the_friction(slides: list[Recording], tmp_path: Path) -> None:
    result = identify(load_scene(XML), slides, "friction:floor", backend="mujoco", window=0.4)
    assert result.values[0] == pytest.approx(TRUE, rel=0.02)
    assert result.low[0] <= TRUE * 1.02 and result.high[0] >= TRUE * 0.98
    assert result.before is not None and result.after is not None
    assert result.after < 0.1 * result.before
    folder = result.save(tmp_path / "out")
    said = json.loads((folder / "identified.json").read_text())
    assert said["parameters"]["friction:floor"]["declared"] == 0.4
    again = load_scene(folder / "scene" / "scene.xml").model
    assert again.geom_friction[0, 0] == pytest.approx(result.values[0])


@dataclasses.dataclass
class _Path:
    qpos: Any


_SEEN = 0.1, 0.9
"""Frictions that the model was trained with."""


class _Slides:
    """A backend in closed form: Coulomb friction alone, with gradients."""

    name, surface, timestep = "closed", "floor", 0.02
    entity_names = ("box",)

    def __init__(self, model: mujoco.MjModel) -> None:
        self.model = model

    def with_properties(self, state: State, objects: Any = None, world: Any = None) -> State:
        self.friction = world["friction_slide"]
        return state

    def trained(self, target: str, name: str) -> tuple[float, float] | None:
        return _SEEN if (target, name) == ("floor", "friction_slide") else None

    def rollout(
        self, state: State, controls: Any, raise_on_divergence: bool = False, **_: Any
    ) -> _Path:
        steps = self.timestep * torch.arange(1, controls.shape[1] + 1, dtype=torch.float64)
        speed, pull = state.qvel[:, :1], 9.81 * self.friction[:, None]
        time = torch.minimum(steps, (speed / pull).clamp(min=0.0))
        way = speed * time - 0.5 * pull * time.square()
        qpos = state.qpos[:, None].expand(-1, len(steps), -1)
        return _Path(torch.cat([qpos[..., :1] + way[..., None], qpos[..., 1:]], dim=-1))


def test_gradients_find_the_friction(slides: list[Recording]) -> None:
    scene = load_scene(XML)
    backend: Any = _Slides(scene.model)
    wanted = parameters(scene, "friction:floor")
    windows = grid([prepare(bind(one, scene), 0.4) for one in slides], backend.timestep)
    assert windows.ctrl.shape == (len(windows.qpos), 20, 0)
    found = identify_learned(backend, wanted, windows, 15, "cpu")
    assert float(found.values[0, 0]) == pytest.approx(TRUE, rel=0.02)
    with pytest.raises(InputError, match="knows friction"):
        identify_learned(backend, parameters(scene, "density:box")[:0] + (
            dataclasses.replace(wanted[0], target="wall"),
        ), windows, 1, "cpu")  # fmt: skip


def test_a_guess_is_where_it_begins_and_what_it_is_weighed_against(
    slides: list[Recording],
) -> None:
    scene = load_scene(XML)
    backend: Any = _Slides(scene.model)
    how: Any = {"backend": backend, "window": 0.4, "check": False}

    def found(spread: float) -> float:
        guess = {"friction:floor": (0.2, spread)}
        return identify(scene, slides, "friction:floor", guess=guess, **how).values[0]

    assert found(1.0) == pytest.approx(TRUE, rel=0.02)
    assert found(1e-4) == pytest.approx(0.2, rel=0.02)
    with pytest.raises(InputError, match="above 0"):
        found(0.0)
    with pytest.raises(InputError, match="begins as declared"):
        identify(scene, slides, "friction:floor", backend="mujoco", guess={"a": (1.0, 1.0)})


class _Diverging(_Slides):
    """Whose rollouts of some windows end in nothing where the friction is above a bound."""

    def __init__(self, model: mujoco.MjModel, worlds: slice, bound: float) -> None:
        super().__init__(model)
        self.worlds, self.bound = worlds, bound

    def rollout(
        self, state: State, controls: Any, raise_on_divergence: bool = False, **_: Any
    ) -> _Path:
        path = super().rollout(state, controls)
        lost = torch.zeros(len(path.qpos), dtype=torch.bool)
        lost[self.worlds] = True
        lost &= self.friction.detach() > self.bound
        if raise_on_divergence and lost.any():
            raise DivergedError("at step 3 by 'box'", torch.nonzero(lost)[:, 0].tolist())
        return _Path(torch.where(lost[:, None, None], torch.nan, path.qpos))


def test_values_stay_within_what_the_model_was_trained_on(
    slides: list[Recording], monkeypatch: pytest.MonkeyPatch
) -> None:
    scene = load_scene(XML)
    backend: Any = _Slides(scene.model)
    wanted = parameters(scene, "friction:floor")
    windows = grid([prepare(bind(one, scene), 0.4) for one in slides], backend.timestep)
    monkeypatch.setitem(globals(), "_SEEN", (0.3, 0.9))
    found = identify_learned(backend, wanted, windows, 15, "cpu")
    assert float(found.values[0, 0]) == pytest.approx(0.3)
    assert float(found.low[0, 0]) == pytest.approx(0.3)


def test_rollouts_that_diverge_count_as_far_off_and_are_said(slides: list[Recording]) -> None:
    scene = load_scene(XML)
    wanted = parameters(scene, "friction:floor")
    windows = grid([prepare(bind(one, scene), 0.4) for one in slides], _Slides.timestep)
    # a diverged rollout that counted nothing would be the best one
    away: Any = _Diverging(scene.model, slice(None), 0.45)
    found = identify_learned(away, wanted, windows, 15, "cpu")
    assert float(found.values[0, 0]) == pytest.approx(TRUE, rel=0.02)
    some: Any = _Diverging(scene.model, slice(0, 1), 0.0)
    with pytest.warns(UserWarning, match="step 3 by 'box'"):
        identify_learned(some, wanted, windows, 15, "cpu")
    every: Any = _Diverging(scene.model, slice(None), 0.0)
    with pytest.raises(DivergedError, match="step 3 by 'box'"):
        identify_learned(every, wanted, windows, 2, "cpu")


def test_a_backend_without_descriptors(slides: list[Recording]) -> None:
    from orbisim import make_backend

    scene = load_scene(XML)
    with pytest.raises(InputError, match="at least one"):
        identify(scene, [], "friction:floor", backend="mujoco")
    fake: Any = make_backend("mujoco", scene)
    fake.name = "other"
    with pytest.raises(InputError, match="not conditioned"):
        identify(scene, slides, "friction:floor", backend=fake)
