"""Mechanisms as URDF: masses, meshes, names."""

from __future__ import annotations

from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest
import trimesh

from orbisim import load_scene
from orbisim.tasks.mechanisms.catalogue import make
from orbisim.tasks.mechanisms.solids import mass_properties
from orbisim.tasks.mechanisms.urdf import write_urdf


def test_masses_are_those_of_the_parts(tmp_path: Path) -> None:
    mechanism = make("microwave", 2)
    model = load_scene(write_urdf(mechanism, tmp_path), trusted=True).model
    for part in mechanism.parts[1:]:
        mass, com, _ = mass_properties(part.solids, part.density)
        body = model.body(part.name)
        assert float(body.mass[0]) == pytest.approx(mass)
        np.testing.assert_allclose(body.ipos, com, atol=1e-9)


def test_every_part_has_a_mesh(tmp_path: Path) -> None:
    mechanism = make("bottle", 1)
    path = write_urdf(mechanism, tmp_path)
    links = ElementTree.parse(path).getroot().findall("link")
    assert [link.get("name") for link in links] == [part.name for part in mechanism.parts]
    for link in links:
        [mesh] = link.findall("visual/geometry/mesh")
        loaded = trimesh.load(tmp_path / str(mesh.get("filename")), force="mesh")
        assert loaded.volume > 0
