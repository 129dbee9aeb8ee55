"""Where MuJoCo's own import of a URDF succeeds, ours gives the same robot."""

from __future__ import annotations

import importlib.util
import math
import os
import sys
from pathlib import Path

import hypothesis
import mujoco
import pytest
from hypothesis import strategies as st

from orbisim.scene import Scene
from orbisim.scene.urdf import read_urdf_string
from tests.scene.urdf.urdf_text import collision, inertial, joint, link, robot

TOOLS = Path(__file__).parents[3] / "tools"
TOLERANCE = 1e-9


def _comparison():
    spec = importlib.util.spec_from_file_location("corpus_urdf", TOOLS / "corpus_urdf.py")
    module = importlib.util.module_from_spec(spec)
    sys.modules["corpus_urdf"] = module
    spec.loader.exec_module(module)
    return module


corpus_urdf = _comparison()


def check_agreement(text: str, **options) -> None:
    theirs = mujoco.MjSpec.from_string(text)
    theirs.compiler.fusestatic = options.get("lump_fixed", True)
    ours = Scene.from_read(read_urdf_string(text, **options), "test").model
    apart = corpus_urdf.differences(ours, theirs.compile())
    assert {name: gap for name, gap in apart.items() if not gap < TOLERANCE} == {}


number = st.floats(-2, 2, allow_subnormal=False).map(lambda x: round(x, 6))
positive = st.floats(0.01, 2).map(lambda x: round(x, 6))
angle = st.floats(-math.pi, math.pi).map(lambda x: round(x, 9))


@st.composite
def origins(draw) -> str:
    xyz = " ".join(repr(draw(number)) for _ in range(3))
    rpy = " ".join(repr(draw(angle)) for _ in range(3))
    return f"<origin xyz='{xyz}' rpy='{rpy}'/>"


@st.composite
def inertials(draw) -> str:
    a, b = draw(positive), draw(positive)
    c = abs(a - b) + 0.01 + draw(st.floats(0, 0.9)) * (a + b - abs(a - b) - 0.02)
    return inertial(draw(positive), (a, b, c), draw(origins()))


@st.composite
def collisions(draw) -> str:
    size = [repr(draw(positive)) for _ in range(3)]
    shape = draw(
        st.sampled_from(
            [
                f"<box size='{' '.join(size)}'/>",
                f"<sphere radius='{size[0]}'/>",
                f"<cylinder radius='{size[0]}' length='{size[1]}'/>",
                f"<capsule radius='{size[0]}' length='{size[1]}'/>",
            ]
        )
    )
    return collision(shape, draw(origins()))


@st.composite
def links(draw, name: str) -> str:
    content = draw(st.lists(collisions(), max_size=2))
    if not content or draw(st.booleans()):
        content.append(draw(inertials()))
    return link(name, *content)


@st.composite
def joints(draw, name: str, parent: str, child: str) -> str:
    kind = draw(st.sampled_from(["revolute", "continuous", "prismatic", "fixed", "planar"]))
    axis = draw(st.tuples(number, number, number).filter(lambda v: max(map(abs, v)) > 0.1))
    content = [draw(origins()), f"<axis xyz='{axis[0]} {axis[1]} {axis[2]}'/>"]
    if draw(st.booleans()):
        low, span, effort = draw(number), draw(positive), draw(st.sampled_from([0, 3.5, -2]))
        content.append(
            f"<limit lower='{low}' upper='{low + span}' effort='{effort}' velocity='1'/>"
        )
    if draw(st.booleans()):
        content.append(f"<dynamics damping='{draw(positive)}' friction='{draw(positive)}'/>")
    return joint(name, parent, child, *content, type=kind)


@st.composite
def robots(draw) -> str:
    count = draw(st.integers(1, 6))
    parts = [draw(links(f"l{i}")) for i in range(count)]
    parents = [draw(st.integers(0, i - 1)) for i in range(1, count)]
    parts += [
        draw(joints(f"j{i}", f"l{parent}", f"l{i}")) for i, parent in enumerate(parents, start=1)
    ]
    return robot(*draw(st.permutations(parts)))


@hypothesis.settings(max_examples=int(os.environ.get("ORBISIM_EXAMPLES", "50")), deadline=None)
@hypothesis.given(text=robots(), lump=st.booleans())
def test_random_robots_agree(text: str, lump: bool) -> None:
    check_agreement(text, lump_fixed=lump)


MESH = "<mesh filename='{file}' scale='{scale}'/>"


@pytest.mark.parametrize("suffix", ["stl", "obj"])
@pytest.mark.parametrize("scale", ["1 1 1", "0.5 2 1", "-1 1 1"])
def test_inertia_of_meshes_agrees(tmp_path: Path, suffix: str, scale: str) -> None:
    """Also for a mesh that is not star-shaped, whose volume MuJoCo overestimates."""
    import trimesh

    pieces = [
        trimesh.creation.box((3, 1, 1)),
        trimesh.creation.box((1, 1, 3), trimesh.transformations.translation_matrix((-1, 0, 1))),
        trimesh.creation.icosphere(2, 0.3).apply_translation((4, 1, 2)),
    ]
    file = tmp_path / f"part.{suffix}"
    trimesh.util.concatenate(pieces).export(file)
    shape = MESH.format(file=file, scale=scale)
    text = robot(
        link("a"),
        link("b", collision(shape, "<origin xyz='1 2 3' rpy='0.1 0.2 0.3'/>")),
        joint("j", "a", "b"),
    )
    theirs = mujoco.MjSpec.from_string(text).compile()
    ours = Scene.from_read(read_urdf_string(text), "test").model
    apart = corpus_urdf.differences(ours, theirs)
    assert {name: gap for name, gap in apart.items() if not gap < 1e-6} == {}  # float32 vertices


def test_comparison_sees_a_difference() -> None:
    """The comparison is not blind: each quantity, changed, is reported."""
    limit = "<limit lower='-1' upper='1' effort='2' velocity='1'/>"
    text = robot(
        link("a"),
        link("b", inertial(), collision("<box size='1 1 1'/>")),
        joint("j", "a", "b", limit, "<origin xyz='0 0 1'/>"),
    )
    changes = {
        "mass": ("mass value='1.0'", "mass value='1.1'"),
        "inertia": ("izz='1'", "izz='1.1'"),
        "limits": ("upper='1'", "upper='1.5'"),
        "pos": ("xyz='0 0 1'", "xyz='0 0 1.1'"),
        "fk": ("xyz='0 0 1'", "xyz='0 0 1.1'"),
        "axis": ("</joint>", "<axis xyz='0 1 0'/></joint>"),
        "geoms": ("box size='1 1 1'", "box size='1 1 2'"),
        "dynamics": ("</joint>", "<dynamics damping='1'/></joint>"),
    }
    theirs = mujoco.MjSpec.from_string(text).compile()
    for quantity, (old, new) in changes.items():
        assert old in text
        ours = Scene.from_read(read_urdf_string(text.replace(old, new)), "test").model
        assert corpus_urdf.differences(ours, theirs)[quantity] > 1e-3, quantity
