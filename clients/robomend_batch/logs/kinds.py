"""Which kind of log a file is, by what it begins with.

To add a kind: its reader, which yields blocks (blocks.py), a line in READERS, one in `kind_of` if it begins
with something of its own, and a row in docs/batch.md.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path

from robomend.model.other_formats import LOOKED_AT, named_bytes
from robomend_batch.logs.blocks import Blocks, Opened
from robomend_batch.logs.export import MAGIC as EXPORT_MAGIC
from robomend_batch.logs.export import read_export
from robomend_batch.logs.messages import read_messages
from robomend_batch.logs.parquet import read_parquet
from robomend_batch.logs.recorded import Recording
from robomend_batch.logs.samples import read_recording
from robomend_batch.logs.text import read_csv, read_ndjson
from robomend_batch.problems import LogRefused

Reader = Callable[[Path, Opened], Blocks]


def _bag(path: Path) -> Recording:
    from robomend_batch.logs.bag import open_bag  # libraries that only such logs need

    return open_bag(path)


def _mcap(path: Path) -> Recording:
    from robomend_batch.logs.mcap import open_mcap

    return open_mcap(path)


def _db3(path: Path) -> Recording:
    from robomend_batch.logs.db3 import open_db3

    return open_db3(path)


RECORDINGS: Mapping[str, Callable[[Path], Recording]] = {"bag": _bag, "mcap": _mcap, "db3": _db3}
"""Of messages."""

READERS: Mapping[str, Reader] = {
    "parquet": read_parquet,
    "csv": read_csv,
    "ndjson": read_ndjson,
    **{kind: partial(read_messages, open_recording) for kind, open_recording in RECORDINGS.items()},
    "recording": read_recording,
    "export": read_export,
}

MAGIC = {
    b"PAR1": "parquet",
    b"#ROSBAG V2.0": "bag",
    b"\x89MCAP0\r\n": "mcap",
    b"SQLite format 3": "db3",
    b'{"start":': "recording",
    EXPORT_MAGIC: "export",
}

BY_NAME = {".csv": "csv", ".ndjson": "ndjson", ".jsonl": "ndjson", ".json": "ndjson"}


def kind_of(path: Path) -> str:
    """Return the kind of a file; LogRefused if it is none that is known, or cannot be read."""
    try:
        with path.open("rb") as file:
            head = file.read(LOOKED_AT)
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
    if other := named_bytes(head):
        raise LogRefused(other, str(path))
    raise LogRefused(f"no log that is known: {', '.join(READERS)}", str(path))
