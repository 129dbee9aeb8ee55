"""Every page says whom it is for, is linked from the README and stands in the site's contents."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from tests.test_layers import REPOSITORY

PAGES = sorted((REPOSITORY / "docs").glob("*.md"))
README = (REPOSITORY / "README.md").read_text()
SITE = (REPOSITORY / "mkdocs.yml").read_text()


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_a_page_can_be_found(page: Path) -> None:
    head, _, rest = page.read_text().partition("\n")
    assert head.startswith("# ")
    assert rest.strip().startswith("*For "), f"{page.name}: whom is it for?"
    if page.stem not in ("index", "api"):
        assert f"(docs/{page.name})" in README
    assert f": {page.name}\n" in SITE


@pytest.mark.parametrize("page", [REPOSITORY / "README.md", *PAGES], ids=lambda page: page.stem)
def test_links_lead_somewhere(page: Path) -> None:
    text = re.sub(r"```.*?```", "", page.read_text(), flags=re.S)
    links = re.findall(r"\]\(([^)#\s]+)(?:#[^)]*)?\)", text)
    gone = [one for one in links if "://" not in one and not (page.parent / one).exists()]
    assert not gone
