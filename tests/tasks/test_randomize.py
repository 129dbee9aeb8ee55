"""Models drawn around the declared one."""

from __future__ import annotations

from pathlib import Path

import mujoco
import numpy as np
import pytest

from orbisim.errors import InputError, UnknownNameError
from orbisim.tasks.collect import collect
from orbisim.tasks.dataset import EpisodeFile
from orbisim.tasks.randomize import checked, drawn, factors_of
from orbisim.tasks.registry import make

ARM = Path(__file__).parents[2] / "mjcf_assets" / "arm2" / "scene.xml"
MODEL = mujoco.MjModel.from_xml_path(str(ARM))


def test_each_element_has_a_factor_of_its_own() -> None:
    model = drawn(MODEL, factors_of("20"), np.random.default_rng(0))
    for field in ("body_mass", "dof_damping"):
        ratio = getattr(model, field)[-2:] / getattr(MODEL, field)[-2:]
        assert (np.abs(ratio - 1) <= 0.2).all() and ratio[0] != ratio[1]
    assert np.allclose(
        model.body_inertia[1:] / MODEL.body_inertia[1:],
        (model.body_mass[1:] / MODEL.body_mass[1:])[:, None],
    )
    assert model.body_subtreemass[0] == pytest.approx(model.body_mass.sum())  # derived anew
    assert (MODEL.dof_damping == [0.15, 0.06]).all()


def test_one_element_alone(tmp_path: Path) -> None:
    (tmp_path / "r.yaml").write_text("damping/elbow: [2, 2]\ngain: 10\n")
    model = drawn(MODEL, factors_of(str(tmp_path / "r.yaml")), np.random.default_rng(0))
    assert model.dof_damping == pytest.approx([0.15, 0.12])
    assert (model.actuator_gainprm[:, 0] != MODEL.actuator_gainprm[:, 0]).all()
    with pytest.raises(UnknownNameError, match="did you mean 'elbow'"):
        drawn(MODEL, checked({"damping/elbwo": 5}), np.random.default_rng(0))


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("100", "below 100"),
        ("-5", "below 100"),
        ("nan", "below 100"),
        ("many", "a percentage, such as 20, or a YAML file"),
        ("mas: 3", "did you mean 'mass'"),
        ("mass: [2, 1]", "the smaller first"),
        ("mass: heavy", "two factors"),
        ("- 1", "a quantity and its range"),
        ("{", "is no YAML"),
    ],
)
def test_wrong_input(tmp_path: Path, text: str, message: str) -> None:
    if " " in text or text == "{":
        (tmp_path / "r.yaml").write_text(text)
        text = str(tmp_path / "r.yaml")
    with pytest.raises(InputError, match=message):
        factors_of(text)


def test_episodes_differ_and_are_repeatable(tmp_path: Path) -> None:
    changes = {"steps": 5, "randomize": {"mass": (0.5, 1.5)}}
    for name in ("a.h5", "b.h5"):
        collect(str(ARM), tmp_path / name, episodes=2, workers=1, changes=changes)
    assert (tmp_path / "a.h5").read_bytes() == (tmp_path / "b.h5").read_bytes()
    with EpisodeFile(tmp_path / "a.h5") as file:
        first, second = (file.episode(i)["descriptor/objects"] for i in range(2))
    assert not np.allclose(first, second)
    task = make(str(ARM), **changes)
    assert task.scene(seed=1).fingerprint != task.scene().fingerprint
