"""The why of a number stands beside it."""

from __future__ import annotations

import ast
from collections.abc import Iterator

from tests.test_layers import MODULES


def bare(module: str) -> Iterator[str]:
    """Numbers of a module with no comment on the line or above it, and no string below."""
    text = MODULES[module].read_text()
    lines, body = text.splitlines(), ast.parse(text).body
    for node, after in zip(body, [*body[1:], None], strict=True):
        if not isinstance(node, ast.Assign | ast.AnnAssign) or not is_number(node.value):
            continue
        commented = "#" in lines[node.end_lineno - 1] or lines[node.lineno - 2].startswith("#")
        described = isinstance(after, ast.Expr) and isinstance(after.value, ast.Constant)
        if not (commented or described):
            yield f"{module}: {lines[node.lineno - 1]}"


def is_number(value: ast.expr | None) -> bool:
    """Whether an expression is arithmetic of numbers."""
    if isinstance(value, ast.UnaryOp):
        return is_number(value.operand)
    if isinstance(value, ast.BinOp):
        return is_number(value.left) and is_number(value.right)
    return isinstance(value, ast.Constant) and type(value.value) in (int, float)


def test_a_constant_has_its_reason_beside_it() -> None:
    found = [line for module in MODULES for line in bare(module)]
    assert not found, "say why in a comment or in a string below:\n" + "\n".join(found)


def test_what_counts_as_a_reason(monkeypatch, tmp_path) -> None:
    path = tmp_path / "module.py"
    path.write_text(
        'a = 1\nb = 2  # why\n# why\nc = -3\nd = 2**20\n"""why"""\ne = "text"\nf = 4 * 5\n'
    )
    monkeypatch.setitem(MODULES, "module", path)
    assert list(bare("module")) == ["module: a = 1", "module: f = 4 * 5"]
