"""The blocks of README.md and docs/*.md, fenced or indented, with what they are.

A fence says its language. An indented block, and whatever a test has to know besides, says it in a comment
right above it, which nobody sees on the page:

    <!-- sh -->                          shell commands; tests/test_blocks.py has the other kinds
    <!-- sh, not run: takes minutes -->  with the reason; its options are looked at all the same
    <!-- yaml agent -->                  read as the file of an agent; also: yaml settings, json robot
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from textwrap import dedent

ROOT = Path(__file__).parents[1]
PAGES = (ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md")), ROOT / "docs" / "deploy" / "README.md")

FENCE = re.compile(r"( *)```(\w*)\Z")
COMMENT = re.compile(r"<!-- (?P<kind>[a-z]+)(?: (?P<use>[a-z]+))?(?:, not run: (?P<reason>.+?))? -->\Z")


@dataclass(frozen=True)
class Block:
    """One block of a page."""

    page: str
    line: int
    kind: str  # empty: nobody says
    text: str
    use: str = ""
    reason: str = ""  # why it is not run

    def __str__(self) -> str:
        return f"{self.page}:{self.line}"


def blocks_of(page: Path) -> Iterator[Block]:
    """Yield the blocks of a page, in its order."""
    name = page.relative_to(ROOT).as_posix()
    lines = page.read_text(encoding="utf-8").split("\n")
    at = 0
    while at < len(lines):
        before = lines[at - 1] if at else ""
        said = COMMENT.match(before)
        if fence := FENCE.match(lines[at]):
            end = lines.index(fence[1] + "```", at + 1)
            text, kind = dedent("\n".join(lines[at + 1 : end])), fence[2]
        elif lines[at].startswith("    ") and (not before or said):
            end = at
            while end < len(lines) and (lines[end].startswith("    ") or _goes_on(lines, end)):
                end += 1
            text, kind = "\n".join(line[4:] for line in lines[at:end]), ""
        else:
            at += 1
            continue
        use, reason = (said["use"] or "", said["reason"] or "") if said else ("", "")
        yield Block(name, at + 1, said["kind"] if said else kind, text, use, reason)
        at = end + 1


def _goes_on(lines: list[str], at: int) -> bool:
    return not lines[at] and at + 1 < len(lines) and lines[at + 1].startswith("    ")


BLOCKS = [block for page in PAGES for block in blocks_of(page)]
