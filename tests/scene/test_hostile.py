"""Broken and hostile MJCF and URDF: one clear line, soon, and nothing worse."""

from __future__ import annotations

import os
import resource
import struct
from collections.abc import Callable, Mapping
from pathlib import Path

import hypothesis
import pytest
from hypothesis import strategies as st

from orbisim import load_scene
from orbisim.errors import SceneError
from orbisim.scene.safety import xmlsafe
from tests.clock import Stopwatch
from tests.scene.urdf.urdf_text import collision, inertial, joint, link, robot, two_links

SECONDS = 5.0
BYTES = 2 * 2**30

LAUGHS = "".join(f'<!ENTITY l{i} "{f"&l{i - 1};" * 10}">' for i in range(1, 12))
ENTITIES = {
    "bomb": f'<!DOCTYPE r [<!ENTITY l0 "ha">{LAUGHS}]>',
    "external": '<!DOCTYPE r [<!ENTITY l0 SYSTEM "file:///etc/passwd">]>',
    "parameter": '<!DOCTYPE r [<!ENTITY % l0 SYSTEM "http://localhost:1/x.dtd"> %l0;]>',
}


def refused(path: Path, says: str, **options) -> SceneError:
    """Loads a file that must be refused, in one line and in time."""
    watch = Stopwatch()
    with pytest.raises(SceneError, match=says) as caught:
        load_scene(path, **options)
    assert watch.seconds < SECONDS
    message = str(caught.value)
    assert "\n" not in message
    assert str(path) in message
    assert "the reader failed" not in message
    assert "Traceback" not in message
    assert len(message) < 2000
    return caught.value


@pytest.fixture(autouse=True, scope="module")
def _memory() -> None:
    """No reader takes more than `BYTES`.

    A forked child's resident memory includes the pages that it shares with this process, which
    may hold torch and Warp by the time it comes here: what this process holds is taken off.
    """
    taken: list[int] = []

    def waitpid(pid: int, options: int) -> tuple[int, int]:
        pid, status, used = os.wait4(pid, options)
        if pid:
            held = int(Path("/proc/self/statm").read_text().split()[1]) * resource.getpagesize()
            taken.append(used.ru_maxrss * 1024 - held)
        return pid, status

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(os, "waitpid", waitpid)
        yield
    assert taken
    assert max(taken) < BYTES


# ---- any file ----------------------------------------------------------------------------------

FILES: Mapping[str, tuple[str, bytes, str]] = {
    "empty urdf": ("s.urdf", b"", "is empty"),
    "empty mjcf": ("s.xml", b"", "is empty"),
    "blank urdf": ("s.urdf", b"  \n ", "holds no XML element"),
    "binary urdf": ("s.urdf", bytes(range(256)) * 4, "URDF starts with <robot>"),
    "binary mjcf": ("s.xml", bytes(range(256)) * 4, "not UTF-8"),
    "latin-1 urdf": ("s.urdf", "<robot name='é'/>".encode("latin-1"), "0xe9 is not UTF-8"),
    "utf-16 urdf": ("s.urdf", "<robot name='r'/>".encode("utf-16"), "XML|no <link>"),
    "NUL in urdf": ("s.urdf", b"<robot name='r'>\0</robot>", "NUL"),
    "NUL alone in urdf": ("s.urdf", b"\0\0", "NUL"),
    "html": ("s.urdf", b"<html><body>404</body></html>", "starts with <robot>; got <html>"),
    "urdf as xml": ("s.xml", b"<robot name='r'/>", "got <robot>; rename it to end in .urdf"),
    "mjcf as urdf": ("s.urdf", b"<mujoco/>", "got <mujoco>; rename it to end in .xml"),
    "wrong suffix": ("s.txt", b"<mujoco/>", "one of the suffixes .*.xml"),
    "no suffix": ("scene", b"<mujoco/>", "got 'none'"),
    "cut urdf": ("s.urdf", two_links().encode()[:-9], "not well-formed XML: line 1"),
    "cut mjcf": ("s.xml", b"<mujoco><worldbody>", "MuJoCo refuses it"),
    "no links": ("s.urdf", b"<robot name='r'/>", "no <link>"),
    "deep urdf": ("s.urdf", b"<robot>" + b"<link>" * 10**5, "nested more than 200 deep"),
    "deep mjcf": ("s.xml", b"<mujoco>" + b"<body>" * 10**6, "MuJoCo refuses it|crashed"),
    "many elements": ("s.urdf", b"<robot>" + b"<a/>" * 10**6 + b"</robot>", "more than 100000"),
    "long attribute": ("s.urdf", b"<robot name='" + b"x" * 10**7 + b"'><link/></robot>", "'name'"),
    "unbound entity": ("s.urdf", b"<robot name='&x;'/>", "undefined entity"),
    "unknown encoding": (
        "s.urdf",
        b"<?xml version='1.0' encoding='x'?><robot/>",
        "cannot be decoded",
    ),
}


@pytest.mark.parametrize("name", FILES)
def test_files(tmp_path: Path, name: str) -> None:
    file, content, says = FILES[name]
    path = tmp_path / file
    path.write_bytes(content)
    refused(path, says)


def test_missing_files_and_folders(tmp_path: Path) -> None:
    refused(tmp_path / "gone.urdf", "no such file")
    (tmp_path / "folder.urdf").mkdir()
    refused(tmp_path / "folder.urdf", "is a folder")
    (tmp_path / "robot.urdf").write_text(two_links())
    refused(tmp_path / "robbot.urdf", "did you mean .*robot.urdf")


@pytest.mark.parametrize("kind", ENTITIES)
@pytest.mark.parametrize("suffix", ["xml", "urdf"])
def test_entities(tmp_path: Path, kind: str, suffix: str) -> None:
    path = tmp_path / f"scene.{suffix}"
    body = "<mujoco model='&l11;'/>" if suffix == "xml" else "<robot name='&l11;'/>"
    path.write_text(ENTITIES[kind] + body)
    refused(path, "entities")


def test_an_entity_never_reaches_yourdfpy(monkeypatch: pytest.MonkeyPatch) -> None:
    """What yourdfpy's own parser is given has no document type and no prefix left."""
    import yourdfpy

    seen: list[bytes] = []
    real = yourdfpy.URDF.load

    def load(file, **options):
        seen.append(file.getvalue())
        return real(file, **options)

    monkeypatch.setattr(yourdfpy.URDF, "load", load)
    load_scene(robot("<!-- <x> --><sensor:camera name='c'/>", link("a"), "<gazebo><x/></gazebo>"))
    (text,) = seen
    for part in (b"<!", b"sensor", b"gazebo", b"<x"):
        assert part not in text


# ---- URDF --------------------------------------------------------------------------------------

LIMIT = "<limit lower='-1' upper='1' effort='1' velocity='1'/>"
URDF: Mapping[str, tuple[str, str]] = {
    "two parents": (
        robot(*map(link, "abc"), joint("j", "a", "c"), joint("k", "b", "c")),
        r"joint 'k' .*link 'c' is already the child of joint 'j'; a link has one parent",
    ),
    "cycle": (
        robot(*map(link, "abc"), joint("j", "a", "b"), joint("k", "b", "c"), joint("l", "c", "a")),
        "the joints form a loop through links",
    ),
    "cycle beside the tree": (
        robot(*map(link, "abc"), joint("j", "b", "c"), joint("k", "c", "b")),
        "the joints form a loop through links 'b', 'c'|through links 'c', 'b'",
    ),
    "itself": (robot(link("a"), joint("j", "a", "a")), "connects link 'a' with itself"),
    "two roots": (robot(link("a"), link("b")), r"2 links have no parent \('a', 'b'\)"),
    "unknown child": (robot(link("arm"), joint("j", "arm", "am")), "'am' is not .*mean 'arm'"),
    "unknown parent": (robot(link("a"), joint("j", "zzz", "a")), "parent 'zzz' is not a link"),
    "same links": (robot(link("a"), link("a")), "link 'a' .*the name is taken by line 1"),
    "same joints": (
        robot(*map(link, "abc"), joint("j", "a", "b"), joint("j", "a", "c")),
        "joint 'j' .*the name is taken",
    ),
    "no name": (robot("<link/>"), "<link> .*has no attribute 'name'"),
    "empty name": (robot("<link name=''/>"), "name is empty"),
    "no parent": (
        robot(link("a"), "<joint name='j' type='fixed'><child link='a'/></joint>"),
        "joint 'j' .*has no <parent>",
    ),
    "world below": (
        robot(link("a"), link("world"), joint("j", "a", "world")), "cannot have a parent"
    ),
    "unknown type": (two_links(type="screw"), "type 'screw'; expected one of revolute"),
    "zero axis": (two_links("<axis xyz='0 0 0'/>"), "joint 'j' .*its axis is zero"),
    "inverted": (two_links(LIMIT.replace("'1'", "'-2'", 1)), "lower -1 is above upper -2"),
    "equal": (two_links(LIMIT.replace("'-1'", "'1'", 1)), "both 1; make the joint fixed"),
    "negative damping": (two_links("<dynamics damping='-1'/>"), "damping is negative"),
    "mimic of nothing": (two_links("<mimic joint='jj'/>"), "mimics 'jj', .*did you mean 'j'"),
    "mimic of itself": (two_links("<mimic joint='j'/>"), "mimics 'j', which mimics it"),
    "zero mass": (two_links(child=link("b", inertial(0))), "link 'b' .*mass is zero"),
    "negative mass": (two_links(child=link("b", inertial(-1))), "mass is negative"),
    "negative size": (two_links(child=link("b", collision("<box size='1 -1 1'/>"))), "positive"),
    "no shape": (two_links(child=link("b", collision(""))), "holds nothing; expected one of box"),
    "two shapes": (
        two_links(child=link("b", collision("<sphere radius='1'/><sphere radius='2'/>"))),
        "more than one <sphere>",
    ),
    "other shape": (
        two_links(child=link("b", collision("<torus/>"))), "holds <torus>; expected one of box"
    ),
    "two origins": (two_links("<origin/><origin/>"), "more than one <origin>"),
    "missing mesh": (
        two_links(child=link("b", collision("<mesh filename='gone.stl'/>"))),
        "link 'b', collision 1 .*'gone.stl' does not exist",
    ),
    "mesh is a folder": (
        two_links(child=link("b", collision("<mesh filename='/tmp'/>"))), "is not a file"
    ),
    "mesh is no mesh": (
        two_links(child=link("b", collision("<mesh filename='/etc/passwd'/>"))), "suffix 'none'"
    ),
    "zero scale": (
        two_links(child=link("b", collision("<mesh filename='m.stl' scale='1 0 1'/>"))),
        "scale of zero|does not exist",
    ),
    "xacro": (robot("<xacro:include filename='x'/>", link("a")), "xacro macro.*expand"),
    "xacro value": (two_links("<origin xyz='${x} 0 0'/>"), "expand the macros"),
}  # fmt: skip


@pytest.mark.parametrize("name", URDF)
def test_urdf(tmp_path: Path, name: str) -> None:
    text, says = URDF[name]
    path = tmp_path / "robot.urdf"
    path.write_text(text)
    refused(path, says)


NUMBERS = ("nan", "inf", "-inf", "1e999", "abc", "", "1 2", "0x10", "1_0", "٣", "1e", "--1")
PLACES: Mapping[str, Callable[[str], str]] = {
    "mass": lambda x: two_links(child=link("b", inertial(x))),
    "inertia": lambda x: two_links(child=link("b", inertial(1, (x, 1, 1)))),
    "limit": lambda x: two_links(f"<limit lower='{x}' upper='1' effort='1' velocity='1'/>"),
    "effort": lambda x: two_links(f"<limit effort='{x}' velocity='1'/>"),
    "radius": lambda x: two_links(child=link("b", collision(f"<sphere radius='{x}'/>"))),
    "mimic": lambda x: two_links(f"<mimic joint='j' offset='{x}'/>"),
    "damping": lambda x: two_links(f"<dynamics damping='{x}'/>"),
    "xyz": lambda x: two_links(f"<origin xyz='{x} 0 0'/>"),
    "rpy": lambda x: two_links(f"<origin rpy='0 {x} 0'/>"),
    "axis": lambda x: two_links(f"<axis xyz='0 0 {x}'/>"),
    "colour": lambda x: robot(
        f"<material name='m'><color rgba='{x} 0 0 1'/></material>", link("a")
    ),
}


@pytest.mark.parametrize("number", NUMBERS)
@pytest.mark.parametrize("place", PLACES)
def test_numbers(tmp_path: Path, place: str, number: str) -> None:
    path = tmp_path / "robot.urdf"
    path.write_text(PLACES[place](number))
    error = refused(path, r"expected (one|[34]) finite numbers? up to 1e\+30")
    assert "line 1" in error.element


@pytest.mark.parametrize("place", ["mass", "inertia", "radius", "xyz", "limit", "axis"])
@pytest.mark.parametrize("number", ["1e300", "1e-300", "1e38", "99999999999999999999999"])
def test_extreme_numbers_load_or_are_refused(tmp_path: Path, place: str, number: str) -> None:
    path = tmp_path / "robot.urdf"
    path.write_text(PLACES[place](number))
    watch = Stopwatch()
    try:
        load_scene(path)
    except SceneError as error:
        assert "the reader failed" not in str(error)
        assert "\n" not in str(error)
    assert watch.seconds < SECONDS


def test_a_thousand_links_load(tmp_path: Path) -> None:
    path = tmp_path / "robot.urdf"
    joints = (joint(f"j{i}", "l0", f"l{i}") for i in range(1, 1000))
    path.write_text(robot(*(link(f"l{i}") for i in range(1000)), *joints))
    assert load_scene(path).model.njnt == 999


@pytest.mark.parametrize(
    ("count", "says"), [(2000, "more than 1000 joints away"), (10_000, "has 10000 links; at most")]
)
def test_very_long_chains_are_refused(tmp_path: Path, count: int, says: str) -> None:
    joints = (joint(f"j{i}", f"l{i}", f"l{i + 1}") for i in range(count - 1))
    path = tmp_path / "robot.urdf"
    path.write_text(robot(*(link(f"l{i}") for i in range(count)), *joints))
    refused(path, says)


# ---- MJCF --------------------------------------------------------------------------------------

MASSLESS = "<body><joint/><inertial pos='0 0 0' mass='{}' diaginertia='1 1 1'/></body>"
MJCF: Mapping[str, tuple[str, str]] = {
    "zero mass": (MASSLESS.format(0), "mass"),
    "negative mass": (MASSLESS.format(-1), "mass"),
    "text": ("<body pos='a b c'/>", "'pos'"),
    "nan": ("<body pos='nan 0 0'/>", "finite|nan|NaN"),
    "huge number": ("<body pos='1e999 0 0'/>", "too large"),
    "inverted limits": (
        "<body><joint range='1 -1' limited='true'/><geom size='1'/></body>",
        "range",
    ),
    "zero axis": ("<body><joint axis='0 0 0'/><geom size='1'/></body>", "axis too small"),
    "unknown element": ("<sphere/>", "<sphere>|sphere"),
    "unknown reference": ("<geom type='mesh' mesh='gone'/>", "gone"),
    "missing include": ("<include file='gone.xml'/>", "gone.xml"),
    "billion replicas": (
        "<replicate count='1000000000'><geom size='1'/></replicate>",
        "took|memory",
    ),
    "large cloth": (
        "<flexcomp name='f' type='grid' count='9999 9999 9' dim='3' spacing='1 1 1'/>",
        "took|memory|refuses|crashed",
    ),
}


@pytest.mark.usefixtures("little_time")
@pytest.mark.parametrize("name", MJCF)
def test_mjcf(tmp_path: Path, name: str) -> None:
    text, says = MJCF[name]
    path = tmp_path / "scene.xml"
    path.write_text(f"<mujoco><worldbody>{text}</worldbody></mujoco>")
    refused(path, says)


def test_mjcf_with_other_encodings(tmp_path: Path) -> None:
    """MuJoCo takes any bytes; Python's names are text."""
    path = tmp_path / "scene.xml"
    path.write_bytes("<mujoco>\n<!-- é\n --><worldbody/></mujoco>".encode("latin-1"))
    assert load_scene(path).model.nbody == 1
    body = "<mujoco>\n<!-- é\n -->\n<worldbody><body name='é'/></worldbody></mujoco>"
    path.write_bytes(body.encode("latin-1"))
    refused(path, "line 4: byte 0xe9 is not UTF-8")


@pytest.mark.parametrize("text", ["<mujoco model='\ud800'/>", "<robot name='\ud800'/>"])
def test_strings_that_are_not_text(text: str) -> None:
    with pytest.raises(SceneError, match=r"surrogate|not well-formed"):
        load_scene(text)


def test_mjcf_includes_itself(tmp_path: Path) -> None:
    path = tmp_path / "scene.xml"
    path.write_text("<mujoco><include file='scene.xml'/></mujoco>")
    refused(path, "scene.xml")


def test_mjcf_huge_height_field(tmp_path: Path) -> None:
    (tmp_path / "h.bin").write_bytes(struct.pack("<2i", 2**30, 2**30) + b"\0" * 64)
    path = tmp_path / "scene.xml"
    path.write_text(
        "<mujoco><asset><hfield name='h' file='h.bin' size='1 1 1 1'/></asset>"
        "<worldbody><geom type='hfield' hfield='h'/></worldbody></mujoco>"
    )
    refused(path, "h")


# ---- XML ---------------------------------------------------------------------------------------


@hypothesis.given(st.binary(max_size=300))
def test_any_bytes_parse_or_are_refused(data: bytes) -> None:
    try:
        xmlsafe.parse(data, "s")
    except SceneError as error:
        assert "\n" not in str(error)


@hypothesis.given(st.text(max_size=100))
def test_any_attribute_survives_the_parser(text: str) -> None:
    from xml.sax.saxutils import quoteattr

    try:
        root = xmlsafe.parse(f"<a b={quoteattr(text)}/>", "s")
    except SceneError:  # characters that XML cannot have
        assert any(
            ord(c) < 32 or 0xD800 <= ord(c) < 0xE000 or ord(c) in (0xFFFE, 0xFFFF) for c in text
        )
    else:
        assert root.attrib["b"].split() == text.split()


@pytest.mark.parametrize(
    ("text", "rest"),
    [
        (b"a<!--b-->c", b"ac"),
        (b"a<!--\n\n-->c\n<!---->d", b"a\n\nc\nd"),
        (b"a<!--b", b"a"),
        (b"a<!-->b-->c", b"ac"),
        (b"a-->b", b"a-->b"),
    ],
)
def test_comments_go_and_lines_stay(text: bytes, rest: bytes) -> None:
    assert xmlsafe.without_comments(text) == rest


def test_lines_prefixes_and_text() -> None:
    root = xmlsafe.parse("<a>\n <x:b name='n'>text</x:b>\n</a>", "s")
    (child,) = root.nodes()
    assert (child.tag, child.line, child.text) == ("x:b", 2, "text")
    assert child.label() == "x:b 'n' (line 2)"


def test_declared_encodings() -> None:
    declared = '<?xml version="1.0" encoding="latin-1"?><a b="é"/>'
    assert xmlsafe.parse(declared.encode("latin-1"), "s").get("b") == "é"
    assert xmlsafe.parse(declared, "s").get("b") == "é"  # a string is decoded already
    assert xmlsafe.parse("\ufeff <a b='é'/>".encode(), "s").get("b") == "é"
    assert xmlsafe.parse("<a b='é'/>".encode("utf-16"), "s").get("b") == "é"
