"""docs/equations.md names a function for each equation, and the function names the equation."""

from __future__ import annotations

import importlib
import re
from pathlib import Path

import pytest

PAGE = Path(__file__).parents[3] / "docs" / "equations.md"
ROWS = re.findall(r"^\| ([^|]+?) \| .+? \| `([\w.]+):([\w.]+)` \|", PAGE.read_text(), re.MULTILINE)
EXPECTED = {
    "Dynamics",
    "RSSM f_enc",
    "RSSM f_cp",
    "RSSM f_rec",
    "RSSM f_tra",
    "RSSM f_dec",
    "AdaLN",
    "3_losses L_tra",
    "3_losses L_enc",
    "3_losses L_dec",
    "L_state",
    "L_robot",
    "L_object",
    "L_dyn",
    "AR ratio",
}


def test_every_equation_has_a_function() -> None:
    assert {label for label, _, _ in ROWS} >= EXPECTED


@pytest.mark.parametrize(("label", "module", "name"), ROWS)
def test_the_function_names_its_equation(label: str, module: str, name: str) -> None:
    found = importlib.import_module(module)
    for part in name.split("."):
        found = getattr(found, part)
    symbol = label.split()[-1]
    text = (found.__doc__ or "").lower()
    assert symbol.lower().replace("ar ratio", "ratio") in text or symbol == "ratio", (label, text)
