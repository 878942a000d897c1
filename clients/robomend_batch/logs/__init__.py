"""The kinds of logs. Each yields blocks of rows (rows.py), and says what is wrong with a log and where."""

from __future__ import annotations

COMPRESSED = (".zstd", ".zst", ".gz", ".bz2")
"""Of names, behind that of the log itself."""


def without_ending(name: str) -> str:
    """Return what a log is called unpacked."""
    ending = next((one for one in COMPRESSED if name.lower().endswith(one)), "")
    return name[: len(name) - len(ending)]
