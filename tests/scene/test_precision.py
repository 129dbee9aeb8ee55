"""Numbers in XML come back as they were."""

from __future__ import annotations

from pathlib import Path

import mujoco
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from orbisim import load_scene
from orbisim.scene.precision import full_precision


def document(value: float) -> mujoco.MjSpec:
    spec = mujoco.MjSpec()
    spec.worldbody.add_body(name="b", pos=[value, 0, 0])
    spec.compile()
    return spec


@given(st.floats(1e-6, 1e6) | st.floats(-1e6, -1e-6))  # smaller ones the writer takes for zero
def test_every_number_is_read_back_as_it_was(value: float) -> None:
    with full_precision():
        text = document(value).to_xml()
    assert mujoco.MjModel.from_xml_string(text).body_pos[1, 0] == value


def test_afterwards_it_is_as_before() -> None:
    plain = document(np.pi).to_xml()
    assert "3.14159 " in plain
    with pytest.raises(RuntimeError), full_precision():
        raise RuntimeError
    assert document(np.pi).to_xml() == plain


def test_saving_keeps_seventeen_digits(tmp_path: Path) -> None:
    body = "<body pos='0.12345678901234567 0 0'><geom size='1'/></body>"
    scene = load_scene(f"<mujoco><worldbody>{body}</worldbody></mujoco>")
    again = load_scene(scene.save(tmp_path))
    assert again.model.body_pos[1, 0] == 0.12345678901234567
    assert "0.1234567890123456" in scene.to_xml()
