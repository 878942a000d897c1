"""The blocks of README.md and docs/*.md, fenced or indented, with what they are.

A fence says its language. An indented block, and whatever a test has to know besides, says it in a comment
right above it, which nobody sees on the page:

    <!-- sh -->                          shell commands; tests/test_blocks.py has the other kinds
    <!-- yaml agent -->                  read as the file of an agent; also: yaml settings, json robot
    <!-- console board -->               it goes on: it is the emulator of the page's other blocks
    <!-- sh endless -->                  it goes on: it is run until it has said something

What tests/test_blocks.py does not run says how it is run instead, and why:

    <!-- sh, run by tests/x.py: it takes a robot -->   that test reads the block from the page, and runs it
    <!-- sh, begun: it takes minutes -->    each line is typed into a terminal, works until it has shown that
                                            it does, and is ended with Ctrl-C (tests/test_begun_blocks.py,
                                            --long); else each word is read by the command's own parser
"""

from __future__ import annotations

import re
import shlex
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from textwrap import dedent

ROOT = Path(__file__).parents[1]
PAGES = (ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md")), ROOT / "docs" / "deploy" / "README.md")

FENCE = re.compile(r"( *)```(\w*)\Z")
COMMENT = re.compile(
    r"<!-- (?P<kind>[a-z]+)(?: (?P<use>[a-z]+))?"
    r"(?:, (?P<how>begun|run by (?P<test>tests/[a-z0-9_/]+\.py)): (?P<reason>.+?))? -->\Z"
)


@dataclass(frozen=True)
class Block:
    """One block of a page."""

    page: str
    line: int
    kind: str  # empty: nobody says
    text: str
    use: str = ""
    reason: str = ""  # why tests/test_blocks.py does not run it
    how: str = ""  # how it is run instead: begun, run by
    test: str = ""  # the file that runs it

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
        told = {key: value or "" for key, value in said.groupdict().items()} if said else {}
        use, reason, test = (told.get(key, "") for key in ("use", "reason", "test"))
        how = "run by" if test else told.get("how", "")
        yield Block(name, at + 1, told.get("kind") or kind, text, use, reason, how, test)
        at = end + 1


def _goes_on(lines: list[str], at: int) -> bool:
    return not lines[at] and at + 1 < len(lines) and lines[at + 1].startswith("    ")


BLOCKS = [block for page in PAGES for block in blocks_of(page)]


def commands(text: str) -> Iterator[list[str]]:
    """Yield the commands of a block, each as its words."""
    whole = text.replace("\\\n", " ")
    for line in whole.split("\n"):
        words: list[str] = []
        for word in shlex.split(line.removeprefix("$ "), comments=True):
            if word in ("&&", "||", "|", ";", "&"):
                yield words
                words = []
            else:
                words.append(word)
        if ">" in words:
            del words[words.index(">") :]
        while words and re.match(r"[A-Z_]+=", words[0]):  # a variable that is set
            del words[0]
        if words:
            yield words
