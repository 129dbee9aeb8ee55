"""COLLADA, made safe and whole."""

from __future__ import annotations

from pathlib import Path
from xml.etree import ElementTree

import pytest

from orbisim.scene.safety.collada import Collada, prepare
from orbisim.scene.safety.problem import MeshProblemError

DATA = Path(__file__).parents[1] / "urdf" / "data"
TWO_NODES = (DATA / "two_nodes.dae").read_text()


def prepared(folder: Path, text: str) -> Collada:
    file = folder / "m.dae"
    file.write_text(text)
    return prepare(file)


def tags(found: Collada) -> list[str]:
    return [node.tag.rpartition("}")[2] for node in ElementTree.fromstring(found.document).iter()]


def test_unit_and_axis(tmp_path: Path) -> None:
    found = prepared(tmp_path, TWO_NODES)
    assert (found.metres, found.up_axis, found.textured) == (0.01, "Z_UP", False)
    plain = prepared(tmp_path, "<COLLADA/>")
    assert (plain.metres, plain.up_axis) == (1.0, "Y_UP")  # the format's own defaults


def test_only_the_documents_own_conventions_count(tmp_path: Path) -> None:
    inner = "<library_nodes><asset><unit meter='7'/><up_axis>X_UP</up_axis></asset></library_nodes>"
    found = prepared(tmp_path, f"<COLLADA>{inner}</COLLADA>")
    assert (found.metres, found.up_axis) == (1.0, "Y_UP")


@pytest.mark.parametrize("metre", ["0", "-1", "nan", "inf", "one"])
def test_units_that_are_none(tmp_path: Path, metre: str) -> None:
    with pytest.raises(MeshProblemError, match=f"meter='{metre}'; expected a positive"):
        prepared(tmp_path, TWO_NODES.replace('meter="0.01"', f'meter="{metre}"'))


@pytest.mark.parametrize("number", ["nan", "INF", "1,5", "--"])
def test_coordinates_that_are_none(tmp_path: Path, number: str) -> None:
    text = TWO_NODES.replace("0 0 0  10 0 0", f"0 0 0  {number} 0 0")
    if number == "--":  # of digits and signs only: the parser's business
        prepared(tmp_path, text)
        return
    with pytest.raises(MeshProblemError, match=f"coordinate '{number}', which is not finite"):
        prepared(tmp_path, text)


def test_textures_become_a_plain_colour(tmp_path: Path) -> None:
    text = TWO_NODES.replace("<color>1 0 0 1</color>", '<texture texture="t" texcoord="UV"/>')
    found = prepared(tmp_path, text)
    assert found.textured
    assert "texture" not in tags(found)
    assert b"0.8 0.8 0.8 1" in found.document


def test_what_is_no_geometry_is_gone(tmp_path: Path) -> None:
    extra = "<library_images><image/></library_images><extra><x/></extra></COLLADA>"
    found = prepared(tmp_path, TWO_NODES.replace("</COLLADA>", extra))
    assert not {"library_images", "image", "extra"} & set(tags(found))
    assert tags(found) == tags(prepared(tmp_path, TWO_NODES))


def test_uses_of_materials_that_do_not_exist_are_gone(tmp_path: Path) -> None:
    whole = tags(prepared(tmp_path, TWO_NODES))
    broken = tags(prepared(tmp_path, TWO_NODES.replace('url="#blue-effect"', 'url="#gone"')))
    assert broken.count("material") == whole.count("material") - 1
    assert broken.count("instance_material") < whole.count("instance_material")
    assert broken.count("node") == whole.count("node")  # geometry stays


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("<html/>", "its root element is <html>"),
        ("<COLLADA>", "is no COLLADA: is not well-formed"),
        ("<!DOCTYPE x [<!ENTITY a 'b'>]><COLLADA>&a;</COLLADA>", "entities"),
    ],
)
def test_what_is_no_collada(tmp_path: Path, text: str, message: str) -> None:
    with pytest.raises(MeshProblemError, match=message):
        prepared(tmp_path, text)
