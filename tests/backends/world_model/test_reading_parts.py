"""Which joints are parts', and what is read of them."""

from __future__ import annotations

import dataclasses

import mujoco
import numpy as np
import pytest
import trimesh
from orbisim_world_model.layout import Layout
from orbisim_world_model.parts import COLUMNS
from orbisim_world_model.reading import read_layout
from orbisim_world_model.reading_parts import body_mesh, encoder_digest, read_parts, shape_tokens

from orbisim import load_scene
from orbisim.errors import InputError, UnsupportedSceneError
from tests.backends.world_model.synthetic import DOOR, PANEL, TABLE


def read(xml: str) -> tuple[mujoco.MjModel, Layout]:
    model = mujoco.MjModel.from_xml_string(xml)
    return model, read_layout(model, 0.02)


def test_joints_apart_from_the_hand_and_without_a_motor() -> None:
    _, layout = read(PANEL)
    assert [layout.joints[j] for j in layout.parts] == ["hinge", "turn", "press"]
    assert layout.robot == (("x", False), ("y", False))
    assert layout.hand == "tcp"
    assert Layout.from_dict(layout.to_dict()) == layout
    driven = PANEL.replace("</actuator>", '<motor joint="press"/></actuator>')
    assert [read(driven)[1].joints[j] for j in read(driven)[1].parts] == ["hinge", "turn"]
    assert read(TABLE)[1].parts == ()
    assert read(DOOR.replace('name="tcp"', 'name="elsewhere"'))[1].parts == ()


def test_descriptors_are_those_of_the_model() -> None:
    model, layout = read(PANEL)
    rows = read_parts(model, layout)
    assert rows.shape == (3, len(COLUMNS))

    def column(name: str) -> list[float]:
        return [float(v) for v in rows[:, COLUMNS.index(name)]]

    assert column("parent") == [-1.0, 0.0, -1.0]
    assert column("type_hinge") == [1.0, 1.0, 0.0]
    np.testing.assert_allclose(column("low"), [-0.2, -0.8, -0.05])
    np.testing.assert_allclose(column("reference"), [0.0, 0.0, 0.01])
    np.testing.assert_allclose(column("damping"), [0.02, 0.002, 0.5])
    np.testing.assert_allclose(column("half_y")[0], 0.1, atol=1e-9)
    np.testing.assert_allclose(column("centre_y")[0], 0.08, atol=1e-9)
    np.testing.assert_allclose(column("axis_y")[2], 0.5**0.5, atol=1e-9)


def test_the_token_is_the_shape_s() -> None:
    model, layout = read(PANEL)
    rows = read_parts(model, layout)
    mesh = body_mesh(model, int(model.body("leaf").id))
    assert isinstance(mesh, trimesh.Trimesh)
    np.testing.assert_allclose(mesh.bounds, [[-0.01, -0.02, -0.08], [0.01, 0.18, 0.08]], atol=1e-9)
    first = COLUMNS.index("shape_00")
    np.testing.assert_array_equal(rows[0, first:], shape_tokens()(mesh).astype(float))
    assert np.abs(rows[0, first:] - rows[1, first:]).max() > 0.1
    assert len(encoder_digest()) == 64


def test_parts_that_cannot_be_read_are_refused_by_name() -> None:
    model, layout = read(DOOR.replace('<geom type="capsule" size="0.01" fromto="0 0 0 -0.02 0.05 0" mass="0.05"/>', '<inertial pos="0 0 0" mass="0.05" diaginertia="0.001 0.001 0.001"/>'))  # fmt: skip  # noqa: E501
    with pytest.raises(UnsupportedSceneError, match="'lever' has no shape"):
        read_parts(model, layout)
    model, layout = read(
        DOOR.replace('<joint name="turn"', '<joint name="more"/><joint name="turn"')
    )
    with pytest.raises(UnsupportedSceneError, match="no part with two joints"):
        read_parts(model, layout)


def test_layouts_with_impossible_parts_are_refused() -> None:
    _, layout = read(DOOR)
    for changes, message in (
        ({"parts": (0, 2)}, "no joints of it"),
        ({"parts": (2, 9)}, "not there"),
        ({"part_columns": ()}, "columns of descriptors"),
    ):
        wrong = dataclasses.replace(layout, **changes)  # type: ignore[arg-type]
        with pytest.raises(InputError, match=message):
            Layout.from_dict(wrong.to_dict())


def test_a_generated_mechanism_has_a_part_for_each_joint() -> None:
    model = load_scene("task:mechanism:pressure_cooker").model
    layout = read_layout(model, 0.05)
    names = [layout.joints[j] for j in layout.parts]
    assert len(names) >= 2 and all(name.startswith("pressure_cooker_") for name in names)
    assert np.isfinite(read_parts(model, layout)).all()
