"""Every module has a test of its name, or a reason and the test that reaches it.

`orbisim/a/b.py` is tested by `tests/a/test_b.py`, `backends/orbisim_x/y.py` by
`tests/backends/x/test_y.py`, what a package itself defines by `tests/a/test_init.py`.
"""

from __future__ import annotations

import ast
from pathlib import Path, PurePosixPath

import pytest

from tests.test_layers import CORE, MODULES, REPOSITORY

TESTS = REPOSITORY / "tests"

SEEN_THROUGH = {
    "orbisim.version": ("cli/test_main.py", "one constant, shown by `orbisim --version`"),
    "orbisim.backend": ("conformance", "an interface: what is promised is what conformance checks"),
    "orbisim.cli.diagnose": ("cli/test_main.py", "a diagnosis itself takes long"),
    "orbisim.cli.eval": ("cli/test_training.py", "it needs a checkpoint that was trained"),
    "orbisim.cli.train": ("cli/test_training.py", "a training from its start to its end"),
    "orbisim.diagnosis": ("diagnosis", "stages are seen in the verdict that they lead to"),
    "orbisim.effects.estimate": ("sensing/test_faults.py", "values without code"),
    "orbisim.freerun.jobs": ("freerun", "a value that is handed to a worker"),
    "orbisim.host.children": ("files/test_locking.py", "processes that end with their parent"),
    "orbisim.identification.classical": (
        "identification/test_init.py",
        "what mujoco.sysid finds of a recording",
    ),
    "orbisim.identification.learned": (
        "identification/test_init.py",
        "what gradients find of a recording",
    ),
    "orbisim.recording": ("recording", "stages of binding are seen in the bound recording"),
    "orbisim.report.diagnosis": ("report/test_names.py", "a page needs a diagnosis"),
    "orbisim.scene.safety.problem": (
        "scene/safety/test_meshformats.py",
        "an exception that every check raises",
    ),
    "orbisim.scene.visible": ("tasks/test_frames.py", "rows and poses are seen against images"),
    "orbisim.scene.urdf.assembly": (
        "scene/urdf/test_agreement.py",
        "bodies of random robots, against MuJoCo's import",
    ),
    "orbisim.scene.urdf.assets": ("scene/urdf/test_geometry.py", "meshes as the scene has them"),
    "orbisim.scene.urdf.build": ("scene/urdf/test_init.py", "the parts together"),
    "orbisim.scene.urdf.document": (
        "scene/urdf/test_init.py",
        "what a document says, as the scene has it",
    ),
    "orbisim.scene.urdf.extension": (
        "scene/urdf/test_init.py",
        "MuJoCo's extension, as the scene has it",
    ),
    "orbisim.scene.urdf.inertials": (
        "scene/urdf/test_inertia.py",
        "mass properties of links, as declared or inferred",
    ),
    "orbisim.scene.urdf.joints": ("scene/urdf/test_init.py", "joints as the scene has them"),
    "orbisim.scene.urdf.model": ("scene/urdf/test_init.py", "values without code"),
    "orbisim.scene.urdf.packages": ("scene/urdf/test_geometry.py", "where files are found"),
    "orbisim.scene.urdf.visuals": (
        "scene/urdf/test_geometry.py",
        "visual meshes that are not there",
    ),
    "orbisim.scene.usd": ("scene/usd", "a reader is called with a document"),
    "orbisim.learned_rest": ("diagnosis/test_rest.py", "a rest is learned from a diagnosis"),
    "orbisim.shooting.bench": ("shooting/test_noise.py", "data that every fit is made of"),
    "orbisim.shooting.fits": ("shooting/test_gauss_newton.py", "values without code"),
    "orbisim.shooting.holding": (
        "diagnosis/test_together.py",
        "joints that friction holds, seen in the effects that are proposed",
    ),
    "orbisim.shooting.one_run": ("shooting/test_judge.py", "what one run says of an effect"),
    "orbisim.testing.backend": ("conformance/test_backends.py", "tests that others inherit"),
    "orbisim.testing.reader": ("conformance/test_readers.py", "tests that others inherit"),
    "orbisim.testing.renderer": ("conformance/test_renderers.py", "tests that others inherit"),
    "orbisim.sensing.readings": (
        "sensing/test_faults.py",
        "readings along free runs and along the smoothed motion, against sensors that are right",
    ),
    "orbisim.tasks.mechanisms.families": (
        "tasks/mechanisms/test_catalogue.py",
        "every family's instances are scenes, and a hand succeeds with them",
    ),
    "orbisim.view": ("view", "a page is seen in the browser"),
    "orbisim_mujoco.renderer": ("conformance/test_renderers.py", "images against each other"),
    "orbisim_diffusion": ("backends/diffusion", "parts are seen in the renderer and its training"),
    "orbisim_warp.kernels": ("backends/warp/test_backend.py", "run on Warp's arrays only"),
    "orbisim_world_model.baseline": (
        "backends/world_model/test_backend.py",
        "MuJoCo's own step, seen in what is left to learn",
    ),
    "orbisim_world_model.card": ("cli/test_training.py", "written at the end of a training"),
    "orbisim_world_model.checkpoint": (
        "backends/world_model/test_manifest.py",
        "weights are read with their manifest",
    ),
    "orbisim_world_model.cloth": (
        "backends/world_model/cloth",
        "stages of a step, a training and an evaluation of a cloth, each as a whole",
    ),
    "orbisim_world_model.comparison": ("cli/test_training.py", "of checkpoints, by `orbisim eval`"),
    "orbisim_world_model.compiling": (
        "backends/world_model/test_speedups.py",
        "of steps, which must stay the same",
    ),
    "orbisim_world_model.curves": ("cli/test_training.py", "drawn at the end of a training"),
    "orbisim_world_model.dynamics": ("backends/world_model/test_model.py", "the model as a whole"),
    "orbisim_world_model.engine": (
        "backends/world_model/test_backend.py",
        "the model as a backend",
    ),
    "orbisim_world_model.episode_rows": (
        "backends/world_model/test_packing.py",
        "rows of episodes, as packs hold them",
    ),
    "orbisim_world_model.families": (
        "backends/world_model/cloth/test_trainer.py",
        "a checkpoint of either kind steps its scenes",
    ),
    "orbisim_world_model.stepping": ("backends/world_model/test_conformance.py", "an interface"),
    "orbisim_world_model.evaluate": (
        "backends/world_model/test_training.py",
        "errors of a model that was trained",
    ),
    "orbisim_world_model.features": (
        "backends/world_model/test_model.py",
        "symmetries of the whole model",
    ),
    "orbisim_world_model.fitting": (
        "backends/world_model/test_backend.py",
        "which scenes a checkpoint fits",
    ),
    "orbisim_world_model.hybrid": (
        "backends/world_model/test_backend.py",
        "a correction of MuJoCo's step",
    ),
    "orbisim_world_model.layout": (
        "backends/world_model/test_manifest.py",
        "layouts that do not fit are refused with their manifest",
    ),
    "orbisim_world_model.native.compiler": (
        "backends/world_model/native/test_step.py",
        "compiles the step",
    ),
    "orbisim_world_model.native.translate": (
        "backends/world_model/native/test_step.py",
        "writes the step",
    ),
    "orbisim_world_model.native.writer": (
        "backends/world_model/native/test_step.py",
        "writes the step",
    ),
    "orbisim_world_model.network.dreamer": (
        "backends/world_model/test_training.py",
        "every configuration is trained",
    ),
    "orbisim_world_model.network.folded": (
        "backends/world_model/test_speedups.py",
        "equal to the network that it is folded from",
    ),
    "orbisim_world_model.network.fused_kernels": (
        "backends/world_model/network/test_fused.py",
        "run through the modules that start them",
    ),
    "orbisim_world_model.network.inputs": (
        "backends/world_model/test_model.py",
        "values that networks are given",
    ),
    "orbisim_world_model.network.monolith": (
        "backends/world_model/test_training.py",
        "every configuration is trained",
    ),
    "orbisim_world_model.network.objects": (
        "backends/world_model/test_model.py",
        "the parts together",
    ),
    "orbisim_world_model.network.still": (
        "backends/world_model/test_training.py",
        "the baseline of every evaluation",
    ),
    "orbisim_world_model.pack": (
        "backends/world_model/test_packing.py",
        "packs are written and read",
    ),
    "orbisim_world_model.pack_shapes": (
        "backends/world_model/test_packing.py",
        "packs that do not fit together",
    ),
    "orbisim_world_model.parallel": (
        "backends/world_model/test_training.py",
        "two processes train as one",
    ),
    "orbisim_world_model.reading": (
        "backends/world_model/test_model.py",
        "layouts, against MuJoCo's kinematics",
    ),
    "orbisim_world_model.reading_limbs": (
        "backends/world_model/test_limbs.py",
        "limbs, against MuJoCo's",
    ),
    "orbisim_world_model.run": ("backends/world_model/test_training.py", "a whole training"),
    "orbisim_world_model.stepper": (
        "backends/world_model/test_speedups.py",
        "every way to step is the same step",
    ),
    "orbisim_world_model.trainer": ("backends/world_model/test_training.py", "a whole training"),
    "orbisim_world_model.unroll": (
        "backends/world_model/test_losses.py",
        "the ratio and the losses over a sequence",
    ),
    "orbisim_world_model.zoo": (
        "backends/world_model/test_manifest.py",
        "manifests of the zoo, and what it says it has",
    ),
    "orbisim.vector.device_evaluation": (
        "vector/test_on_device.py",
        "whether a task's functions run on the device, and why not",
    ),
    "orbisim.vector.program": ("vector/test_on_device.py", "a task's functions, step by step"),
}
"""Modules and packages without a test of their name: what reaches them (below tests/), and why."""

CROSS_CUTTING = {
    "effects/test_elsewhere.py": "what effects of several modules say of other places",
    "conformance": "what every plug-in keeps to",
    "docs": "what the documents say",
    "tools": "what lies in tools/",
    "diagnosis": "findings, each with the recordings that lead to it",
    "recording": "what recordings may hold",
    "view": "pages as a whole",
    "backends/world_model/test_conformance.py": "what every backend keeps to",
    "backends/world_model/test_equations.py": "docs/equations.md",
    "backends/world_model/test_many_objects.py": "episodes of different shapes, to the end",
    "backends/world_model/test_mixed.py": "objects and mechanisms in one model, to the end",
    "backends/world_model/test_model.py": "symmetries of the whole model",
    "backends/world_model/test_speedups.py": "fast steps against the plain one",
    "backends/world_model/test_training.py": "a training from its start to its end",
    "cli/test_training.py": "a training from its start to its end, by commands",
    "effects/test_full_inertia.py": "effects and factors on a body declared by a matrix",
    "effects/test_laws.py": "every effect that is a force, against its formula",
    "effects/test_neutral.py": "every effect of the catalogue without effect",
    "effects/test_units.py": "units of every effect",
    "report/test_names.py": "names of any kind in every report",
    "scene/test_fuzz.py": "damaged scenes of all formats",
    "scene/test_hostile.py": "hostile scenes of all formats",
    "scene/urdf": "documents and the scenes that they give",
    "scene/usd": "documents and the scenes that they give",
    "tasks/test_episode_data.py": "every task's episodes",
    "tasks/test_scenes.py": "every task as a scene",
    "test_constants.py": "numbers of every module",
    "test_layers.py": "imports of every module",
    "test_measured.py": "scenes against measured data",
    "test_mirror.py": "names of every test",
}
"""Tests (or folders of them) that are named after something else than a module, and what."""


def defines(module: str) -> bool:
    """Whether a module has more in it than names of others."""
    kinds = (ast.FunctionDef, ast.AsyncFunctionDef, ast.ClassDef)
    return any(isinstance(node, kinds) for node in ast.parse(MODULES[module].read_text()).body)


def test_of(module: str) -> str:
    """The test of a module's name, below tests/."""
    path = MODULES[module]
    if path.is_relative_to(CORE):
        rest = PurePosixPath(path.relative_to(CORE))
    else:
        package, *parts = path.relative_to(REPOSITORY / "backends").parts
        rest = PurePosixPath("backends", package.removeprefix("orbisim_"), *parts)
    return str(rest.parent / f"test_{rest.stem.strip('_')}.py")


test_of.__test__ = False  # type: ignore[attr-defined]
TEST_OF = {
    module: test_of(module)
    for module, path in MODULES.items()
    if path.name != "__init__.py" or defines(module)
}
WITHOUT = sorted(module for module, test in TEST_OF.items() if not (TESTS / test).is_file())


def within(name: str, package: str, separator: str = ".") -> bool:
    """Whether something is a package (folder) or in it."""
    return name == package or name.startswith(package + separator)


def test_modules_have_their_test_or_a_reason() -> None:
    wrong = [m for m in WITHOUT if not any(within(m, entry) for entry in SEEN_THROUGH)]
    assert not wrong, f"write {[TEST_OF[m] for m in wrong]}, or give a reason in SEEN_THROUGH"


@pytest.mark.parametrize("entry", SEEN_THROUGH)
def test_reasons_are_needed_and_name_a_test(entry: str) -> None:
    assert any(within(m, entry) for m in WITHOUT), f"take {entry} out of SEEN_THROUGH"
    found = TESTS / SEEN_THROUGH[entry][0]
    assert found.is_file() or list(found.rglob("test_*.py")), f"there is no {found}"


def _tests() -> list[str]:
    return [path.relative_to(TESTS).as_posix() for path in sorted(TESTS.rglob("test_*.py"))]


def test_tests_are_named_after_modules() -> None:
    known = set(TEST_OF.values())
    odd = [t for t in _tests() if t not in known]
    wrong = [t for t in odd if not any(within(t, entry, "/") for entry in CROSS_CUTTING)]
    assert not wrong, f"rename {wrong}, or give a reason in CROSS_CUTTING"


@pytest.mark.parametrize("entry", CROSS_CUTTING)
def test_cross_cutting_tests_exist(entry: str) -> None:
    odd = set(_tests()) - set(TEST_OF.values())
    assert any(within(t, entry, "/") for t in odd), f"take {entry} out of CROSS_CUTTING"


def test_names() -> None:
    assert TEST_OF["orbisim.scene.urdf.joints"] == "scene/urdf/test_joints.py"
    assert (
        TEST_OF["orbisim_world_model.network.adaln"] == "backends/world_model/network/test_adaln.py"
    )
    assert TEST_OF["orbisim.scene.usd"] == "scene/usd/test_init.py"
    assert "orbisim.physics" not in TEST_OF
    assert within("a.b", "a")
    assert not within("ab", "a")
    assert Path(TESTS / TEST_OF["orbisim.errors"]).is_file()
