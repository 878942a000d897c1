"""The reports that `robomend-bench --out DIR` wrote, as values: Markdown to headings, tables and sentences.

Only what such reports are made of is read; anything else is a sentence as it stands. Whoever may write into
the folder says what is shown, as text: nothing of it becomes code of the page. Plots are shown as pictures,
which run no scripts.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

NAME = r"^[A-Za-z0-9][A-Za-z0-9._+\-]{0,99}$"
"""Of a report, without its ending; and of a plot."""

MOST = 200
"""Reports that are listed, the newest of them."""

MOST_BYTES = 1 << 20
"""Of a report, or of a plot."""

MOST_ENTRIES = 10_000
"""Of the folder, that are looked at."""

RULE = re.compile(r"\|[\s:|-]+\|")


@dataclass(frozen=True, slots=True)
class ReportEntry:
    """A report of the list."""

    name: str
    changed_ns: int


@dataclass(frozen=True, slots=True)
class ReportTable:
    """Rows of cells below a head."""

    head: Sequence[str]
    rows: Sequence[Sequence[str]]


@dataclass(frozen=True, slots=True)
class Report:
    """One report: (heading, text or table) pieces in their order, and the names of its plots."""

    name: str
    pieces: Sequence[tuple[str, str | ReportTable]]
    plots: Sequence[str]


def entries(folder: Path) -> list[ReportEntry]:
    """Return which reports there are, the newest first."""
    found = [
        ReportEntry(path.stem, path.stat().st_mtime_ns)
        for path in _files(folder)
        if path.suffix == ".md" and re.match(NAME, path.stem)
    ]
    return sorted(found, key=lambda entry: -entry.changed_ns)[:MOST]


def report(folder: Path, name: str) -> Report | None:
    """Return a report, None if there is none of this name that can be shown."""
    text = content(folder, f"{name}.md")
    if text is None:
        return None
    plots = [
        path.name
        for path in sorted(_files(folder))
        if path.suffix == ".svg" and path.name.startswith(f"{name}-") and re.match(NAME, path.name)
    ]
    return Report(name, list(pieces(text.decode(errors="replace"))), plots)


def content(folder: Path, file: str) -> bytes | None:
    """Return a file right in the folder; None if there is none, if it is a link, or too large."""
    path = folder / file
    if not re.match(NAME, file) or path.is_symlink() or not path.is_file():
        return None
    with path.open("rb") as opened:
        read = opened.read(MOST_BYTES + 1)
    return read if len(read) <= MOST_BYTES else None


def pieces(text: str) -> Iterator[tuple[str, str | ReportTable]]:
    """Yield what a report is made of: ("heading", …), ("table", …), ("text", …)."""
    for paragraph in re.split(r"\n\s*\n", text.strip()):
        lines = paragraph.strip().split("\n")
        if len(lines) > 1 and lines[0].startswith("|") and RULE.fullmatch(lines[1].strip()):
            yield "table", ReportTable(_cells(lines[0]), [_cells(line) for line in lines[2:]])
        elif lines[0].startswith("#"):
            yield "heading", lines[0].lstrip("# ")
            if lines[1:]:
                yield "text", " ".join(lines[1:])
        elif paragraph.strip():
            yield "text", " ".join(line.strip() for line in lines)


def _cells(line: str) -> list[str]:
    return [cell.strip() for cell in line.strip().strip("|").split("|")]


def _files(folder: Path) -> Iterator[Path]:
    """Yield the files right in the folder, not links."""
    for number, path in enumerate(folder.iterdir()):
        if number >= MOST_ENTRIES:
            return
        if path.is_file() and not path.is_symlink():
            yield path
