"""The logs that a command names: files, folders and patterns, each file once, in the order of their names."""

from __future__ import annotations

import glob
import os
from collections.abc import Iterable
from pathlib import Path

from robomend.cli.files import near_file
from robomend.errors import InputError
from robomend_batch.logs import without_ending

ENDINGS = (".bag", ".bag.active", ".mcap", ".db3", ".parquet", ".csv", ".ndjson", ".jsonl")
"""What is taken of a folder, compressed as well."""

MOST = 1_000_000


def find_logs(given: Iterable[str]) -> tuple[list[str], list[tuple[str, str]]]:
    """Return the names of the logs, and what is wrong: name and reason.

    Raises:
        InputError: there are none, or more than MOST.
    """
    names: dict[str, None] = {}
    problems: list[tuple[str, str]] = []
    known: dict[str, str] = {}
    for pattern in given:
        found = list(_matching(pattern))
        if not found:
            problems.append((pattern, f"there is no such log{near_file(pattern)}"))
        for name in found:
            real = os.path.realpath(name)
            if real in known:
                problems.append((name, f"the same log as {known[real]}: diagnosed once"))
                continue
            known[real] = name
            names[name] = None
    if not names:
        raise InputError("; ".join(f"{name}: {reason}" for name, reason in problems) or "no logs are given")
    if len(names) > MOST:
        raise InputError(f"more than {MOST} logs")
    return sorted(names), problems


def _matching(pattern: str) -> Iterable[str]:
    path = Path(pattern)
    if path.is_dir():
        return sorted(
            os.path.normpath(entry)
            for entry in path.rglob("*")
            if without_ending(entry.name.lower()).endswith(ENDINGS)
            and entry.is_file()
            and (entry == (plain := entry.with_name(without_ending(entry.name))) or not plain.exists())
        )
    if path.exists():
        return [os.path.normpath(pattern)]
    return sorted(
        os.path.normpath(name) for name in glob.glob(pattern, recursive=True) if os.path.isfile(name)
    )
