"""What can be chosen about reading URDF."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from orbisim.errors import InputError, UnknownNameError
from orbisim.scene.urdf.options import UrdfOptions, urdf_options


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"lump_fixed": "yes"}, "lump_fixed='yes': expected None, True, False"),
        ({"actuators": "servo"}, "expected None, 'motor', 'position', 'velocity'"),
        ({"mesh_inertia": "shell"}, "expected 'legacy', 'exact', 'convex'"),
        ({"position_gain": 0}, "position_gain=0: expected a positive number"),
        ({"velocity_gain": float("inf")}, "expected a positive number"),
        ({"velocity_gain": "1"}, "expected a positive number"),
    ],
)
def test_values_that_are_none(options: dict[str, Any], message: str) -> None:
    with pytest.raises(InputError, match=message):
        urdf_options(options)


def test_unknown_options() -> None:
    with pytest.raises(UnknownNameError, match="did you mean 'floating_base'"):
        urdf_options({"floating_bas": True})


def test_packages_by_name_or_by_folder() -> None:
    named = UrdfOptions(package_paths={"p": "/a"})
    assert named.named_packages == {"p": Path("/a")}
    assert named.package_folders == ()
    for paths in ("/a", Path("/a"), ["/a"]):
        options = UrdfOptions(package_paths=paths)  # type: ignore[arg-type]
        assert options.package_folders == (Path("/a"),)
        assert options.named_packages == {}
