"""The learned backend keeps to what every backend must do."""

from __future__ import annotations

import pytest

from orbisim.testing import BackendConformance, scenes


@pytest.mark.usefixtures("toy_zoo")
@pytest.mark.filterwarnings("ignore::orbisim_world_model.backend.OutsideTrainingWarning")
class TestLearned(BackendConformance):
    backend = "learned"
    config = {"native": False}  # noqa: RUF012
    scenes = (*BackendConformance.scenes, scenes.CLOTH)
    tolerance = 2e-5  # products in float32 depend on the size of the batch
