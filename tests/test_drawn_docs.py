"""The diagrams of docs/ are those of the tables in the code."""

from __future__ import annotations

import runpy
from pathlib import Path

import pytest

DOCS = Path(__file__).resolve().parents[1] / "docs"
DRAW = runpy.run_path(str(DOCS / "draw.py"))


@pytest.mark.parametrize("path", sorted(DOCS.glob("*.md")), ids=lambda path: path.name)
def test_a_page_shows_the_diagrams_that_the_code_has(path: Path) -> None:
    page = path.read_text(encoding="utf-8")
    assert page == DRAW["drawn"](page), "run ./dev check --fix"


def test_every_diagram_is_on_a_page() -> None:
    pages = "".join(path.read_text(encoding="utf-8") for path in DOCS.glob("*.md"))
    shown = {block["name"] for block in DRAW["BLOCK"].finditer(pages)}
    assert shown == DRAW["DIAGRAMS"].keys()
