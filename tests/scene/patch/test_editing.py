"""Edits of bytes: what is between them stays as it is."""

from __future__ import annotations

from pathlib import Path

from orbisim.scene.patch.differences import differences
from orbisim.scene.patch.editing import Counterparts, Edit, applied, edits
from orbisim.scene.patch.marked import parsed, read


def edited(folder: Path, own: str, old: str, new: str, degrees: bool = False) -> str:
    path = folder / "own.xml"
    path.write_text(own)
    before, after = parsed(old), parsed(new)
    turning = frozenset(id(one) for one in after.descendants() if one.tag == "joint")
    counterparts = Counterparts(before, read(path))
    ((_, data),) = applied(
        edits(differences(before, after), counterparts, turning, degrees)
    ).values()
    return data.decode()


def test_attributes_in_their_place(tmp_path: Path) -> None:
    own = "<mujoco>\n<worldbody> <body name='b'  pos='1 2 3'\n /></worldbody></mujoco>"
    old = "<mujoco><worldbody><body name='b' pos='1 2 3'/></worldbody></mujoco>"
    found = edited(tmp_path, own, old, old.replace("1 2 3", "4 2 3"))
    assert found == own.replace("'1 2 3'", '"4 2 3"')
    found = edited(tmp_path, own, old, old.replace(" pos='1 2 3'", ""))
    assert found == own.replace("  pos='1 2 3'", "")


def test_angles_in_degrees_and_short_numbers(tmp_path: Path) -> None:
    own = "<mujoco><worldbody><body><joint name='j'/></body></worldbody></mujoco>"
    new = own.replace("'j'", "'j' ref='1.5707963267948966' damping='0.029999999999999999'")
    assert '<joint name=\'j\' ref="90" damping="0.03"/>' in edited(tmp_path, own, own, new, True)


def test_another_orientation_replaces_the_old_one(tmp_path: Path) -> None:
    own = "<mujoco><worldbody><site name='s' euler='0 0 90'/></worldbody></mujoco>"
    old = "<mujoco><worldbody><site name='s' quat='0 0 0 1'/></worldbody></mujoco>"
    found = edited(tmp_path, own, old, old.replace("0 0 0 1", "1 0 0 0"))
    assert "<site name='s' quat=\"1 0 0 0\"/>" in found


def test_sections_of_several_places_and_new_ones(tmp_path: Path) -> None:
    own = "<mujoco>\n<option timestep='1'/>\n<option gravity='0 0 0'/>\n</mujoco>\n"
    old = "<mujoco><option timestep='1' gravity='0 0 0'/></mujoco>"
    new = "<mujoco><option timestep='1' gravity='0 0 1'/><custom><text name='t'/></custom></mujoco>"
    assert edited(tmp_path, own, old, new) == (
        "<mujoco>\n<option timestep='1'/>\n<option gravity=\"0 0 1\"/>\n"
        '  <custom>\n    <text name="t"/>\n  </custom>\n</mujoco>\n'
    )


def test_edits_at_one_place_keep_their_order(tmp_path: Path) -> None:
    path = tmp_path / "f.xml"
    path.write_bytes(b"ab")
    made = applied([Edit(path, 1, 1, b"1"), Edit(path, 1, 1, b"2"), Edit(path, 0, 1, b"A")])
    assert made[path] == (b"ab", b"A12b")
