"""What every reader of scenes must do."""

from __future__ import annotations

from pathlib import Path

import mujoco
import numpy as np
import pytest

from orbisim.errors import InputError, SceneError
from orbisim.scene import ReadResult, Scene, load_scene
from orbisim.scene.readers import reader_of_suffix


class ReaderConformance:
    """Inherit, set the attributes, run with pytest.

    Attributes:
      suffix: under which the reader is registered.
      document: a scene in its format; text, or the bytes of a file.
      joints: names of the joints that the scene has.
    """

    suffix: str = ""
    document: str | bytes = ""
    joints: tuple[str, ...] = ()

    @classmethod
    def content(cls) -> bytes:
        """The document as it stands in a file."""
        return cls.document.encode() if isinstance(cls.document, str) else cls.document

    @pytest.fixture
    def file(self, tmp_path: Path) -> Path:
        """The document as a file."""
        path = tmp_path / f"scene{self.suffix}"
        path.write_bytes(self.content())
        return path

    def test_it_reads_its_own_format(self, file: Path) -> None:
        read = reader_of_suffix(self.suffix).read(str(file))
        assert isinstance(read, ReadResult)
        assert all(part.feature and part.consequence for part in read.unsupported)

    def test_the_scene_can_be_simulated(self, file: Path) -> None:
        model = load_scene(file).model
        assert {model.joint(i).name for i in range(model.njnt)} == set(self.joints)
        assert (np.asarray(model.body_mass[1:]) >= 0).all()
        data = mujoco.MjData(model)
        mujoco.mj_step(model, data, 10)
        assert np.isfinite(data.qpos).all()

    def test_reading_twice_gives_the_same_model(self, file: Path) -> None:
        assert load_scene(file).fingerprint == load_scene(file, trusted=True).fingerprint

    def test_the_scene_can_be_saved(self, file: Path, tmp_path: Path) -> None:
        scene = load_scene(file)
        again = load_scene(scene.save(tmp_path / "saved"))
        assert _sizes(again) == _sizes(scene)

    def test_a_document_is_read_as_the_file_is(self, file: Path) -> None:
        if reader_of_suffix(self.suffix).root is None or not isinstance(self.document, str):
            pytest.skip("the format has no text form")
        try:
            scene = load_scene(self.document)
        except InputError as error:
            assert "from files only" in str(error)
        else:
            assert scene.fingerprint == load_scene(file).fingerprint

    def test_an_unknown_option_is_refused(self, file: Path) -> None:
        with pytest.raises(InputError, match="no_such_option"):
            reader_of_suffix(self.suffix).read(str(file), no_such_option=1)

    def test_a_missing_file_is_named(self, tmp_path: Path) -> None:
        gone = str(tmp_path / f"gone{self.suffix}")
        for read in (load_scene, reader_of_suffix(self.suffix).read):
            with pytest.raises(SceneError, match="gone"):
                read(gone)

    @pytest.mark.parametrize("seed", range(20))
    def test_a_damaged_file_is_read_or_refused(self, tmp_path: Path, seed: int) -> None:
        rng, whole = np.random.default_rng(seed), self.content()
        start = int(rng.integers(len(whole)))
        kept = whole[start + int(rng.integers(1, 40)) :]
        path = tmp_path / f"damaged{self.suffix}"
        path.write_bytes(whole[:start] + rng.bytes(int(rng.integers(8))) + kept)
        try:
            load_scene(path)
        except InputError as error:
            assert "\n" not in str(error)

    @pytest.mark.parametrize("share", [0.0, 0.3, 0.6, 0.9])
    def test_a_cut_file_is_refused(self, tmp_path: Path, share: float) -> None:
        whole = self.content()
        path = tmp_path / f"cut{self.suffix}"
        path.write_bytes(whole[: int(share * len(whole))])
        with pytest.raises(SceneError, match="cut"):
            load_scene(path)


def _sizes(scene: Scene) -> tuple[int, ...]:
    model = scene.model
    return (model.nq, model.nv, model.nbody, model.ngeom, model.nu)
