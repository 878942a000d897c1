"""Which kind of log a file is, by what it begins with.

To add a kind: its reader, which yields blocks (blocks.py), a line in READERS, one in `kind_of` if it begins
with something of its own, and a row in docs/batch.md.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path

from robomend_batch.logs.blocks import Blocks, Opened
from robomend_batch.logs.parquet import read_parquet
from robomend_batch.logs.text import read_csv, read_ndjson
from robomend_batch.problems import LogRefused

Reader = Callable[[Path, Opened], Blocks]

READERS: Mapping[str, Reader] = {"parquet": read_parquet, "csv": read_csv, "ndjson": read_ndjson}

MAGIC = {b"PAR1": "parquet"}

BY_NAME = {".csv": "csv", ".ndjson": "ndjson", ".jsonl": "ndjson", ".json": "ndjson"}


def kind_of(path: Path) -> str:
    """Return the kind of a file; LogRefused if it is none that is known, or cannot be read."""
    try:
        with path.open("rb") as file:
            head = file.read(16)
    except OSError as error:
        raise LogRefused(f"cannot be read: {error.strerror}", str(path)) from error
    if not head:
        raise LogRefused("an empty file", str(path))
    for magic, kind in MAGIC.items():
        if head.startswith(magic):
            return kind
    kind_by_name = BY_NAME.get(path.suffix.lower())
    if kind_by_name is not None:
        return kind_by_name
    if head.lstrip()[:1] == b"{":
        return "ndjson"
    raise LogRefused(f"no log that is known: {', '.join(READERS)}", str(path))
