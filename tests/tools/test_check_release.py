"""What is released: the wheel holds what it should, and the tool sees where it does not."""

from __future__ import annotations

import sys
import zipfile
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "tools"))

import check_release
from check_release import build_one, contents, copy_tracked, faults, faults_of

pytestmark = pytest.mark.skipif(
    not (check_release.ROOT / ".git").exists(), reason="what is released is what git tracks"
)


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("release")
    copy_tracked(folder / "tree")
    return build_one(folder / "tree", "build_wheel", folder)


def test_the_wheel_is_whole(wheel: Path) -> None:
    assert faults_of(wheel) == []


def test_what_is_wrong_is_found(wheel: Path) -> None:
    held = contents(wheel)
    with zipfile.ZipFile(wheel) as archive:
        (place,) = (name for name in held if name.endswith("/entry_points.txt"))
        points = archive.read(place).decode()
    weights = "orbisim_world_model/zoo/push/model.safetensors"
    licence = next(name for name in held if name.endswith("/LICENSE"))

    def told(change: dict[str, str | None], text: str = points, size: float = 50.0) -> list[str]:
        return faults({k: v for k, v in {**held, **change}.items() if v}, text, size)

    assert told({}) == []
    assert told({"tests/test_state.py": "0"}) == [
        "tests/test_state.py: does not belong into a wheel"
    ]
    assert told({"orbisim/state.py": None}) == ["orbisim/state.py: is missing"]
    assert told({licence: None}) == ["LICENSE: is missing"]
    assert told({weights: "0"})[0].startswith(f"{weights}: docs/zoo.md lists another SHA-256")
    assert any("the wheel lacks it" in one for one in told({weights: None}))
    assert told({}, size=101)[0].startswith("101 MB")
    assert told({}, points.replace("orbisim_warp:", "orbisim_wrap:")) == [
        "entry point warp of orbisim.backends: is not orbisim_warp:WarpBackend"
    ]
    assert told({"orbisim_warp/__init__.py": None})[1:] == [
        "entry point warp of orbisim.backends: there is no module of orbisim_warp:WarpBackend"
    ]


def test_what_doctor_says_is_heard() -> None:
    def said(status: str) -> str:
        checks = [
            {"kind": kind, "name": name, "status": "ok", "text": ""}
            for kind, name in check_release._WORKING["core"]
        ]
        checks.append({"kind": "backend", "name": "warp", "status": status, "text": "steps"})
        return check_release.json.dumps({"checks": checks})

    assert check_release._heard(said("ok"), "warp") == ""
    assert check_release._heard(said("absent"), "core") == ""
    assert check_release._heard(said("absent"), "warp") == "backend warp is absent"
    assert check_release._heard(said("failed"), "core") == "backend warp: steps"


def test_every_extra_for_users_is_tried() -> None:
    assert set(check_release.extras()) == set(check_release._EXTRAS)


def test_pythons_are_recognised() -> None:
    version = f"{sys.version_info.major}.{sys.version_info.minor}"
    assert check_release._is(sys.executable, version)
    assert not check_release._is(sys.executable, "2.7")
    assert check_release.interpreters(["2.99"]) == {"2.99": None}
