"""The documentation can be read: no sentence is too long, the whole is not, and the README is short."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
PAGES = (
    *(ROOT / name for name in ("README.md", "CHANGELOG.md", "CONTRIBUTING.md", "SECURITY.md")),
    *sorted((ROOT / "docs").glob("*.md")),
    ROOT / "docs" / "deploy" / "README.md",
)
MOST_WORDS = {"a sentence": 40, "README.md": 700, "docs/*.md": 50_000}

CODE = re.compile(r"^( *)```(?s:.*?)^\1```$|^    .*$|<!--(?s:.*?)-->", re.MULTILINE)
COMMENT = re.compile(r"<!--.*?-->|```mermaid\n.*?```", re.DOTALL)
"""What nobody reads as words: comments, and the source of diagrams, which are pictures on the site."""
PARAGRAPH = re.compile(r"\n\s*\n|\n(?=\s*(?:[-*]|\d+\.) )|\n(?=[|#])| \| ")
"""Where a sentence ends without a full stop: at an empty line, an item of a list, a heading, a cell."""
END = re.compile(r"(?<=[.!?])[)\"*]*\s+")


def sentences(page: str) -> Iterator[str]:
    """Yield the sentences of a page, code and diagrams left out."""
    for paragraph in PARAGRAPH.split(CODE.sub("", page)):
        yield from END.split(paragraph)


def words(text: str) -> int:
    """Return how many words there are, those of code too; the lines of a table are none."""
    return len(re.findall(r"\w\S*", text))


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.relative_to(ROOT).as_posix())
def test_no_sentence_is_longer_than_one_can_read(page: Path) -> None:
    long = [
        one for one in sentences(page.read_text(encoding="utf-8")) if words(one) > MOST_WORDS["a sentence"]
    ]
    assert long == []


def test_the_whole_is_no_longer_than_somebody_reads() -> None:
    pages = "".join(page.read_text(encoding="utf-8") for page in (ROOT / "docs").glob("*.md"))
    assert words((ROOT / "README.md").read_text(encoding="utf-8")) <= MOST_WORDS["README.md"]
    assert words(COMMENT.sub("", pages)) <= MOST_WORDS["docs/*.md"]
