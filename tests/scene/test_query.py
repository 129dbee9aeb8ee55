"""Options of a reader behind a scene's path."""

from __future__ import annotations

from pathlib import Path

import pytest

from orbisim.errors import InputError, UnknownNameError
from orbisim.scene import load_scene
from orbisim.scene.query import with_options, without_options
from tests.scene.urdf.urdf_text import two_links

LIMIT = "<limit effort='5' velocity='2' lower='-1' upper='1'/>"


def test_there_and_back() -> None:
    options = {
        "actuators": "position",
        "floating_base": True,
        "visuals": None,
        "position_gain": 50.0,
        "package_paths": {"a b": "/x y/z&?.d"},
    }
    text = with_options("robot.urdf", options)
    assert text.startswith("robot.urdf?actuators=position&floating_base=true&visuals=none")
    assert without_options(text) == ("robot.urdf", options)
    assert with_options("robot.urdf", {}) == "robot.urdf"
    assert without_options("robot.urdf") == ("robot.urdf", {})


def test_a_file_of_that_name_comes_first(tmp_path: Path) -> None:
    path = tmp_path / "a?b=c.xml"
    path.write_text("<mujoco/>")
    assert without_options(str(path)) == (str(path), {})
    assert load_scene(path).source == str(path)


def test_scenes_are_read_so(tmp_path: Path) -> None:
    path = tmp_path / "robot.urdf"
    path.write_text(two_links(LIMIT))
    name = f"{path}?actuators=motor&actuate=all&floating_base=true"
    scene = load_scene(name)
    assert (scene.model.nu, scene.model.nq) == (1, 8)
    assert scene.source == name
    assert load_scene(path).model.nu == 0
    with pytest.raises(UnknownNameError, match="did you mean 'actuators'"):
        load_scene(f"{path}?actuator=motor")
    with pytest.raises(InputError, match="expected None, 'motor'"):
        load_scene(f"{path}?actuators=engine")
    with pytest.raises(InputError, match="options of the reader"):
        load_scene(f"{path}?motor")
