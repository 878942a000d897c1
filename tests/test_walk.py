"""docs/design.md lists the files in which an observation is followed to a verified repair: few and short."""

from __future__ import annotations

import re
from pathlib import Path

PAGE = Path(__file__).resolve().parents[1] / "docs" / "design.md"

MOST_FILES = 7
MOST_LINES = 1500


def listed() -> list[Path]:
    """Return the files of the list."""
    section = PAGE.read_text(encoding="utf-8").partition("Read these in order.")[2].partition("\n## ")[0]
    return [
        PAGE.parent / link for link in re.findall(r"^\d+\. \[`[^`]+`\]\(([^)]+)\)", section, re.MULTILINE)
    ]


def test_the_way_of_an_observation_is_read_in_a_few_files() -> None:
    files = listed()
    assert 4 <= len(files) <= MOST_FILES
    lines = {path.name: len(path.read_text(encoding="utf-8").splitlines()) for path in files}
    assert sum(lines.values()) <= MOST_LINES, lines
