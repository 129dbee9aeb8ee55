"""What may import what: one way, and only downwards.

Every import counts, also one inside a function or under TYPE_CHECKING.
"""

from __future__ import annotations

import ast
import dataclasses
import functools
from collections.abc import Iterator
from pathlib import Path

import pytest

import orbisim

CORE = Path(orbisim.__file__).parent
REPOSITORY = CORE.parent

LAYERS = (
    # what needs nothing of ours
    {"errors", "version"},
    {"host"},
    {"plugins", "files"},
    # Scene
    {"scene"},
    # State
    {"state"},
    {"trajectory", "arguments", "tangent", "cameras"},
    # Backend, Renderer
    {"backend", "renderer"},
    {"registry", "gradients"},
    {"agreement"},
    # dm_control's Physics on top of them
    {"physics", "metrics", "penetration"},
    {"episodes", "coverage"},
    {"suite"},
    # Recording
    {"recording"},
    {"effects"},
    {"motion", "evidence"},
    {"sensing", "shooting"},
    {"learned_rest"},
    # what takes the five nouns and gives a result
    {"freerun"},
    {"scores"},
    {"replay", "compare", "tasks", "view"},
    {"diagnosis", "identification", "vector"},
    {"fleet"},
    # what shows results
    {"report", "testing"},
    {"cli"},
)
"""Packages and modules of the core, from the ground up; each may import those below it, and
itself. Those of one layer do not import each other."""

PLUGINS = (
    "orbisim_mujoco",
    "orbisim_warp",
    "orbisim_world_model",
    "orbisim_diffusion",
    "orbisim_policies",
)
"""They may import all of the core but the command line; of each other, what `BESIDE` says."""

BESIDE = {
    ("orbisim_world_model", "orbisim_mujoco"): "the hybrid corrects C MuJoCo's own step",
    ("orbisim_diffusion", "orbisim_world_model"): "manifests and weights are read alike",
    ("orbisim_policies", "orbisim_world_model"): "policies learn in the learned step",
    ("orbisim_policies", "orbisim_diffusion"): "a policy's states are read off frames",
}

DEFERRED = {
    "orbisim.cli": "a command loads engines when it runs, so that --help stays fast",
    "orbisim.vector.loading": "torch is wanted for tensors on a device only",
    "orbisim.scene.usd.dump.main": "the child process says first that OpenUSD was found",
    "orbisim_policies.workflows": "Stable-Baselines3 and vision are wanted for their own part",
    "orbisim_world_model.baseline": "training runs where MuJoCo is not installed",
    "orbisim_world_model.engine": "the C compiler is wanted for single worlds only",
    "orbisim_world_model.stepper": "Triton comes with a torch for GPUs only",
}
"""Modules (and packages) that import parts of the project inside functions, and why."""


@dataclasses.dataclass(frozen=True)
class Import:
    """One import of the project. importer, imported: modules. where: line. deferred: in a def."""

    importer: str
    imported: str
    where: int
    deferred: bool


def modules() -> dict[str, Path]:
    """Every module of the project by its name."""
    roots = {"orbisim": CORE} | {name: REPOSITORY / "backends" / name for name in PLUGINS}
    found = {}
    for name, root in roots.items():
        for path in root.rglob("*.py"):
            parts = (name, *path.relative_to(root).with_suffix("").parts)
            found[".".join(parts[:-1] if parts[-1] == "__init__" else parts)] = path
    return found


MODULES = modules()


def import_statements(
    node: ast.AST, deferred: bool = False
) -> Iterator[tuple[ast.Import | ast.ImportFrom, bool]]:
    """The import statements below a node, and whether each stands in a function."""
    for child in ast.iter_child_nodes(node):
        if isinstance(child, ast.Import | ast.ImportFrom):
            yield child, deferred
        elif not isinstance(child, ast.expr):  # no expression holds a statement
            inner = isinstance(child, ast.FunctionDef | ast.AsyncFunctionDef)
            yield from import_statements(child, deferred or inner)


def imports_of(module: str) -> Iterator[Import]:
    """The imports of the project that a module makes, anywhere in it."""
    for node, deferred in import_statements(ast.parse(MODULES[module].read_text())):
        if isinstance(node, ast.Import):
            names = [alias.name for alias in node.names]
        else:
            assert not node.level, f"{module}:{node.lineno} is a relative import"
            base = node.module or ""
            whole = [f"{base}.{alias.name}" for alias in node.names]
            names = [name if name in MODULES else base for name in whole]
        for name in names:
            if name in MODULES and name != module:
                yield Import(module, name, node.lineno, deferred)


@functools.cache
def imports() -> tuple[Import, ...]:
    """All of them. Read by tests alone: others import this module for what it knows of files."""
    return tuple(one for module in MODULES for one in imports_of(module))


def part_of(module: str) -> str:
    """The part of the core, or the plug-in, that a module belongs to; empty for `orbisim`."""
    package, _, rest = module.partition(".")
    return package if package != "orbisim" else rest.partition(".")[0]


def test_every_part_has_one_layer() -> None:
    named = [part for layer in LAYERS for part in layer]
    assert len(named) == len(set(named))
    assert {part_of(m) for m in MODULES if m != "orbisim"} == {*named, *PLUGINS}
    plugins = {path.name for path in (REPOSITORY / "backends").glob("orbisim_*")}
    assert plugins == set(PLUGINS)


def _allowed(one: Import) -> bool:
    here, there = part_of(one.importer), part_of(one.imported)
    if one.importer == "orbisim":  # the front door: names and where they are at home
        return there not in PLUGINS
    if here == there or (here, there) in BESIDE:
        return True
    if there == "" or there in PLUGINS:  # the front door is for users; plug-ins have entry points
        return here == "cli" and there != ""
    height = {part: level for level, layer in enumerate(LAYERS) for part in layer}
    if here in PLUGINS:
        return there != "cli"
    return height[there] < height[here]


def test_imports_run_downwards() -> None:
    wrong = [f"{i.importer}:{i.where} imports {i.imported}" for i in imports() if not _allowed(i)]
    assert not wrong


def cycles(edges: dict[str, set[str]]) -> list[set[str]]:
    """Groups of modules that import each other in a circle (what is left when leaves are cut)."""
    left = {module: set(targets) for module, targets in edges.items()}
    while leaves := {m for m, targets in left.items() if not targets & left.keys()}:
        left = {m: targets - leaves for m, targets in left.items() if m not in leaves}
    while roots := left.keys() - {t for targets in left.values() for t in targets}:
        left = {m: targets for m, targets in left.items() if m not in roots}
    return [set(left)] if left else []


def test_there_are_no_cycles() -> None:
    edges: dict[str, set[str]] = {module: set() for module in MODULES}
    for one in imports():
        edges[one.importer].add(one.imported)
    assert not cycles(edges)


def test_cycles_are_found() -> None:
    assert not cycles({"a": {"b"}, "b": {"c"}, "c": set()})
    assert cycles({"a": {"b"}, "b": {"c"}, "c": {"b"}, "d": {"a"}}) == [{"b", "c"}]


def test_imports_stand_at_the_top() -> None:
    def excused(module: str) -> bool:
        return any(module == name or module.startswith(f"{name}.") for name in DEFERRED)

    deferred = [one for one in imports() if one.deferred]
    wrong = [f"{i.importer}:{i.where}" for i in deferred if not excused(i.importer)]
    assert not wrong


@pytest.mark.parametrize("name", DEFERRED)
def test_every_excuse_is_used(name: str) -> None:
    users = {one.importer for one in imports() if one.deferred}
    assert any(user == name or user.startswith(f"{name}.") for user in users)
