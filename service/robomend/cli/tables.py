"""Tables for people, as wide as their terminal, and 80 columns where there is none."""

from __future__ import annotations

import shutil
import textwrap
from collections.abc import Iterable, Sequence
from datetime import UTC, datetime

import click

MANY = 3
"""Diagnoses, or names, in one line."""


def some(names: Sequence[str], between: str = ", ", most: int = MANY) -> str:
    """Return the first of the names, and how many more there are."""
    more = f"{between}{len(names) - most} more" if len(names) > most else ""
    return between.join(names[:most]) + more


def diagnoses(found: Iterable[Sequence[str]], most: int = MANY) -> str:
    """Return diagnoses in one line: `lidar or lidar_node or gps with imu or 2 more`."""
    return some([" with ".join(bad) for bad in found], " or ", most)


def show_table(headings: Sequence[str], rows: Iterable[Sequence[str]]) -> None:
    """Write a table; what does not fit is wrapped, never cut off."""
    from rich.console import Console
    from rich.table import Table
    from rich.text import Text

    table = Table(box=None, pad_edge=False, padding=(0, 2, 0, 0), header_style="bold")
    console = Console(highlight=False)
    cells = [[printable(cell) for cell in row] for row in rows]
    # Where sentences stand in the last column, they have the room: lists before it are wrapped first.
    crowded = any(len(row[-1]) > console.width * 2 // 5 for row in cells)
    for place, heading in enumerate(headings):
        listed = crowded and place < len(headings) - 1 and any(" " in row[place] for row in cells)
        table.add_column(Text(heading), overflow="fold", max_width=console.width // 5 if listed else None)
    for row in cells:
        table.add_row(*map(Text, row))
    with console.capture() as capture:
        console.print(table)
    for line in capture.get().splitlines():
        click.echo(line.rstrip())


def show_paragraph(text: str) -> None:
    """Write a sentence, wrapped where the terminal ends, what follows indented under its beginning."""
    text = printable(text)
    indent = " " * (len(text) - len(text.lstrip()) + 2)
    width = max(40, shutil.get_terminal_size().columns)
    click.echo(
        textwrap.fill(text, width, subsequent_indent=indent, break_long_words=False, break_on_hyphens=False)
    )


def printable(text: str) -> str:
    """Return a text without what a terminal would obey: names come from models, whoever wrote them."""
    return "".join(one if one.isprintable() else repr(one)[1:-1] for one in text)


def at(time_ns: int | None, *, now_ns: int | None = None) -> str:
    """Return a time in UTC: of today the clock, else the day as well."""
    if time_ns is None:
        return ""
    moment = datetime.fromtimestamp(time_ns / 1e9, UTC)
    now = datetime.now(UTC) if now_ns is None else datetime.fromtimestamp(now_ns / 1e9, UTC)
    return f"{moment:%H:%M:%S}" if moment.date() == now.date() else f"{moment:%Y-%m-%d %H:%M}"
