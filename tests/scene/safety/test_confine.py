"""References stay inside an archive."""

from __future__ import annotations

from pathlib import Path

import pytest

from orbisim.errors import SceneError
from orbisim.scene.safety.confine import confined_to, confinement, resolve_inside


@pytest.fixture
def root(tmp_path: Path) -> Path:
    (tmp_path / "root" / "sub").mkdir(parents=True)
    (tmp_path / "secret.txt").write_text("secret")
    return tmp_path / "root"


def resolved(reference: str, base: Path) -> Path:
    return resolve_inside(reference, base, source="s", element="e")


def test_where_nothing_is_confined_everything_goes(root: Path) -> None:
    assert confinement() is None
    assert resolved("../../x", root) == root / "../../x"
    assert resolved("/etc/passwd", root) == Path("/etc/passwd")


def test_the_folder_is_that_of_the_block(root: Path) -> None:
    with confined_to(root):
        assert confinement() == root.resolve()
        with pytest.raises(RuntimeError), confined_to(root / "sub"):
            raise RuntimeError
        assert confinement() == root.resolve()
    assert confinement() is None


@pytest.mark.parametrize("reference", ["a.obj", "./a.obj", "../a.obj", "x/../a.obj", "..\\a.obj"])
def test_what_stays_inside(root: Path, reference: str) -> None:
    with confined_to(root):
        assert resolved(reference, root / "sub").is_relative_to(root.resolve())


@pytest.mark.parametrize("reference", ["../../a", "..\\..\\a", "sub/../../../a", "link", "link/a"])
def test_what_leaves(root: Path, reference: str) -> None:
    (root / "sub" / "link").symlink_to(root.parent)
    with confined_to(root), pytest.raises(SceneError, match="outside the archive") as caught:
        resolved(reference, root / "sub")
    assert str(caught.value).startswith("s: e:")


@pytest.mark.parametrize(
    "reference", ["/etc/passwd", "~/x", "C:\\x", "c:x", "file:///etc/passwd", "http://a/b"]
)
def test_what_is_absolute(root: Path, reference: str) -> None:
    with confined_to(root), pytest.raises(SceneError, match="an absolute path"):
        resolved(reference, root)


def test_absolute_paths_inside_are_those_that_parsers_make(root: Path) -> None:
    with confined_to(root):
        assert resolved(str(root / "sub" / "m.obj"), root) == root.resolve() / "sub" / "m.obj"
