"""USD: what composition, instancing and packaging bring together."""

from __future__ import annotations

import math
import shutil
import subprocess
import sys
import zipfile
from pathlib import Path

import numpy as np
import pytest

from orbisim.errors import SceneError
from orbisim.scene import load_scene
from tests.scene.usd.usd_text import DATA, body, load, stage, write

pytest.importorskip("pxr")


def check_car(model) -> None:
    assert [model.body(i).name for i in range(1, model.nbody)] == [
        "Chassis", "Front", "Rear", "Spare",
    ]  # fmt: skip
    np.testing.assert_allclose(model.body("Front").pos, [1, 0, 0])
    np.testing.assert_allclose(model.body("Spare").pos, [0, 0, 2])
    assert model.geom("Front.Rim").size[0] == 0.25  # the default variant
    assert model.geom("Spare.Rim").size[0] == 0.3  # the selected one
    np.testing.assert_allclose(model.body("Rear").mass, 2)
    np.testing.assert_allclose(model.joint("FrontAxle").axis, [0, 1, 0])  # inherited
    assert model.joint("FrontAxle").range[1] == pytest.approx(math.pi / 2)
    assert model.joint("RearAxle").range[1] == pytest.approx(math.pi / 4)  # overridden
    assert model.nmesh == 1  # three lugs, one mesh


def test_references_payloads_instances_classes_and_variants() -> None:
    check_car(load_scene(DATA / "car.usda").model)


def test_the_same_as_crate(tmp_path: Path) -> None:
    """Binary layers, converted here; written in another process so that pxr stays out of it."""
    program = (
        "import sys; from pxr import Sdf\n"
        "for source, target in zip(sys.argv[1::2], sys.argv[2::2]):\n"
        "    Sdf.Layer.FindOrOpen(source).Export(target)\n"
    )
    paths = []
    for name in ("wheel", "car"):
        text = (DATA / f"{name}.usda").read_text().replace("wheel.usda", "wheel.usdc")
        paths += [str(write(tmp_path, text, f"{name}.usda")), str(tmp_path / f"{name}.usdc")]
    subprocess.run([sys.executable, "-c", program, *paths], check=True)
    (tmp_path / "wheel.usda").unlink()
    assert (tmp_path / "car.usdc").read_bytes().startswith(b"PXR-USDC")
    check_car(load_scene(tmp_path / "car.usdc").model)


def package(folder: Path, files: dict[str, bytes], compression: int = zipfile.ZIP_STORED) -> Path:
    """A `.usdz` with its entries aligned as the format wants it."""
    path = folder / "scene.usdz"
    with zipfile.ZipFile(path, "w", compression) as archive:
        for name, data in files.items():
            entry = zipfile.ZipInfo(name)
            entry.compress_type = compression
            padding = -(archive.fp.tell() + 30 + len(name) + 4) % 64  # type: ignore[union-attr]
            entry.extra = b"\x86\x19" + padding.to_bytes(2, "little") + bytes(padding)
            archive.writestr(entry, data)
    return path


def car_files() -> dict[str, bytes]:
    return {name: (DATA / name).read_bytes() for name in ("car.usda", "wheel.usda")}


def test_a_package(tmp_path: Path) -> None:
    check_car(load_scene(package(tmp_path, car_files())).model)


@pytest.mark.parametrize(
    "reference", ["@/etc/hostname@", "@../outside.usda@", "@./a/../../outside.usda@", "@~/x.usda@",
                  "@http://example.org/x.usda@"],
)  # fmt: skip
def test_references_that_leave_a_package_are_refused(tmp_path: Path, reference: str) -> None:
    write(tmp_path, stage(body("Outside")), "outside.usda")
    inside = tmp_path / "inside"
    inside.mkdir()
    text = stage(body("B") + f'def "X" (prepend references = {reference}) {{\n}}\n')
    path = package(inside, {"scene.usda": text.encode()})
    with pytest.raises(SceneError, match="outside of the archive"):
        load_scene(path)


def test_compressed_packages_are_refused(tmp_path: Path) -> None:
    """Ten megabytes of spaces in a few kilobytes."""
    text = stage(body("B")) + " " * 10_000_000
    path = package(tmp_path, {"scene.usda": text.encode()}, zipfile.ZIP_DEFLATED)
    with pytest.raises(SceneError, match="stores files uncompressed"):
        load_scene(path)


@pytest.mark.parametrize("name", ["../scene.usda", "/scene.usda"])
def test_entries_that_leave_the_package_are_refused(tmp_path: Path, name: str) -> None:
    path = package(tmp_path, {name: stage(body("B")).encode()})
    with pytest.raises(SceneError, match="leaves the archive"):
        load_scene(path)


def test_usd_in_a_zip_archive_is_confined_to_it(tmp_path: Path) -> None:
    path = tmp_path / "car.zip"
    with zipfile.ZipFile(path, "w") as archive:
        for name, data in car_files().items():
            archive.writestr(name, data)
    check_car(load_scene(path).model)
    write(tmp_path, stage(body("Outside")), "outside.usda")
    for reference in (tmp_path / "outside.usda", "../../../outside.usda"):
        text = stage(body("B") + f'def "X" (prepend references = @{reference}@) {{\n}}\n')
        with zipfile.ZipFile(path, "w") as archive:
            archive.writestr("scene.usda", text)
        with pytest.raises(SceneError, match="outside of the archive"):
            load_scene(path)


@pytest.mark.parametrize("arc", ["references", "payload"])
def test_missing_layers_are_named(tmp_path: Path, arc: str) -> None:
    text = body("B") + f'def "X" (prepend {arc} = @./parts/gone.usda@) {{\n}}\n'
    with pytest.raises(SceneError, match=r"/X: refers to .*parts/gone\.usda, which cannot be read"):
        load(tmp_path, text)


def test_missing_sublayers_are_named(tmp_path: Path) -> None:
    text = stage(body("B")).replace("(\n", "(\n    subLayers = [@./gone.usda@]\n", 1)
    with pytest.raises(SceneError, match=r"gone\.usda, which cannot be read"):
        load_scene(write(tmp_path, text))


def test_references_to_prims_that_do_not_exist(tmp_path: Path) -> None:
    with pytest.raises(SceneError, match="/X: a reference leads to no prim"):
        load(tmp_path, body("B") + 'def "X" (prepend references = </Nowhere>) {\n}\n')


def test_cycles_are_refused(tmp_path: Path) -> None:
    text = "(prepend references = @./{}.usda@</A>) {{\n}}\n"
    for one, other in (("first", "second"), ("second", "first")):
        write(tmp_path, '#usda 1.0\ndef "A" ' + text.format(other), f"{one}.usda")
    with pytest.raises(SceneError, match="its references form a circle"):
        load_scene(tmp_path / "first.usda")


def test_broken_layers_that_are_referred_to(tmp_path: Path) -> None:
    write(tmp_path, "#usda 1.0\ndef Xform {", "part.usda")
    with pytest.raises(SceneError, match=r"part\.usda"):
        load(tmp_path, body("B") + 'def "X" (prepend references = @./part.usda@) {\n}\n')


def test_a_scene_can_be_saved_and_moved(tmp_path: Path) -> None:
    scene = load_scene(DATA / "car.usda")
    path = scene.save(tmp_path / "saved")
    moved = shutil.move(str(path.parent), str(tmp_path / "moved"))
    again = load_scene(Path(moved) / path.name)
    np.testing.assert_allclose(again.model.body_mass, scene.model.body_mass, rtol=1e-12)
    np.testing.assert_allclose(again.model.geom_size, scene.model.geom_size, rtol=1e-6)


def test_point_instancers_are_listed(tmp_path: Path) -> None:
    text = (
        body("B")
        + """
    def PointInstancer "Many"
    {
        rel prototypes = </Many/Proto>
        int[] protoIndices = [0, 0]
        point3f[] positions = [(0, 0, 0), (1, 0, 0)]
        def Cube "Proto" (prepend apiSchemas = ["PhysicsCollisionAPI"])
        {
        }
    }
    """
    )
    scene = load(tmp_path, text)
    assert scene.model.ngeom == 0
    assert any("PointInstancer" in str(entry) for entry in scene.unsupported)


def test_names_are_display_names_and_take_parents_only_where_needed(tmp_path: Path) -> None:
    text = "".join(
        f'def Xform "{side}" {{\n{body("Foot")}\n{body(f"Only{side}")}\n}}\n'
        for side in ("Left", "Right")
    )
    text += body("tn__x").replace("APIs", "").replace(
        "prepend apiSchemas", 'displayName = "the box"\nprepend apiSchemas'
    ) + body("world")
    model = load(tmp_path, text).model
    names = {model.body(i).name for i in range(1, model.nbody)}
    assert names == {"Left.Foot", "Right.Foot", "OnlyLeft", "OnlyRight", "the box", "world_1"}


def test_leftover_attributes_are_grouped(tmp_path: Path) -> None:
    mass = "float physics:mass = 1\nfloat physxRigidBody:angularDamping = 0.05\ncustom float my = 1"
    mass += "\nfloat3 physics:velocity.timeSamples = {\n0: (0, 0, 1),\n1: (0, 0, 2)\n}"
    scene = load(tmp_path, "".join(body(name, mass=mass) for name in "ABC"))
    listed = [str(entry) for entry in scene.unsupported]
    assert "/A and 2 more: physxRigidBody:angularDamping (ignored)" in listed
    assert "/A and 2 more: time samples of physics:velocity (the first one holds)" in listed
    assert not any(" my " in text for text in listed)
    np.testing.assert_allclose(scene.model.key("initial").qvel[2], 1)


def test_unknown_types_and_schemas_are_listed(tmp_path: Path) -> None:
    text = body("B", extra=("PhysxVehicleAPI",)) + 'def PhysxParticleSystem "P" {\n}\n'
    listed = " ".join(str(entry) for entry in load(tmp_path, text).unsupported)
    assert "PhysxVehicleAPI" in listed and "PhysxParticleSystem" in listed


def test_stages_without_physics_are_refused(tmp_path: Path) -> None:
    with pytest.raises(SceneError, match="holds no physics"):
        load(tmp_path, 'def Xform "Empty" {\n}\n')
    cloth = """
    def Mesh "Cloth" (prepend apiSchemas = ["PhysicsCollisionAPI", "PhysicsDeformableBodyAPI"])
    {
    }
    """
    with pytest.raises(SceneError, match="deformable"):
        load(tmp_path, cloth)


def test_disabled_bodies_belong_to_the_world(tmp_path: Path) -> None:
    text = body(
        "B",
        'def Cube "C" (prepend apiSchemas = ["PhysicsCollisionAPI"]) {\n}',
        mass="bool physics:rigidBodyEnabled = 0",
        pos=(0, 0, 3),
    )
    scene = load(tmp_path, text)
    assert scene.model.nbody == 1
    np.testing.assert_allclose(scene.model.geom("C").pos, [0, 0, 3])
