"""/metrics of several workers as one: a scrape reaches any of them, and is to be told of all.

    worker 0 ── every second ──► place 0 ┐
    worker 1 ── every second ──► place 1 ├─ one file without a name ──► whoever is asked adds them up
    …                                    ┘

The file is the parent's, open in every worker, and gone with them. A place whose worker was just writing is
left out of one answer, which its checksum tells; the figures of the others are up to a second old.
"""

from __future__ import annotations

import os
import struct
import tempfile
import zlib
from collections.abc import Iterable

HEADER = struct.Struct("<QI")  # length of the text in bytes, its CRC-32
PLACE_BYTES = 16 << 20
"""Of the file, which has holes: only what is written takes room."""
EVERY_S = 1.0

LARGEST = frozenset(
    {
        "robomend_store_oldest_write_seconds",
        "robomend_store_commit_seconds",
        "robomend_request_hold_worst_seconds",
        "robomend_loop_delay_worst_seconds",
        "robomend_expected_delay_seconds",
    }
)
"""Figures of which the largest counts; the others are added up."""


def shared_file() -> int:
    """Return the descriptor of a file for all workers; close it to be rid of it."""
    with tempfile.TemporaryFile() as file:
        return os.dup(file.fileno())


class SharedFigures:
    """The file as one worker sees it."""

    def __init__(self, descriptor: int, place: int, places: int) -> None:
        os.set_inheritable(descriptor, False)
        self._descriptor, self._place, self._places = descriptor, place, places

    def leave(self, text: bytes) -> None:
        """Put this worker's figures where the others find them; too long a text is left out whole."""
        data = text if len(text) <= PLACE_BYTES - HEADER.size else b""
        header = HEADER.pack(len(data), zlib.crc32(data))
        os.pwrite(self._descriptor, header + data, self._place * PLACE_BYTES)

    def others(self) -> list[bytes]:
        """Return what the other workers left last."""
        found = (self._read(place) for place in range(self._places) if place != self._place)
        return [text for text in found if text]

    def _read(self, place: int) -> bytes:
        at = place * PLACE_BYTES
        header = os.pread(self._descriptor, HEADER.size, at)
        if len(header) < HEADER.size:
            return b""  # nobody has written here or behind yet
        length, checksum = HEADER.unpack(header)
        text = os.pread(self._descriptor, min(length, PLACE_BYTES), at + HEADER.size)
        return text if zlib.crc32(text) == checksum else b""


def added(texts: Iterable[bytes]) -> bytes:
    """Return several expositions in Prometheus' text format as one, sample by sample.

    Counts add up. The age of the oldest write and the time of a commit are the largest, the time at which a
    counter was made is the earliest.
    """
    about: dict[str, list[str]] = {}  # family -> its comments
    samples: dict[str, dict[str, float]] = {}  # family -> sample with its labels -> value
    for text in texts:
        family = ""
        told: set[str] = set()
        for line in text.decode().splitlines():
            if line.startswith("# "):
                family = line.split(" ", 3)[2]
                if family not in about:
                    about[family], samples[family] = [], {}
                    told.add(family)
                if family in told:
                    about[family].append(line)
                continue
            name, _, value = line.rpartition(" ")
            known = samples[family]
            known[name] = _join(family, known[name], float(value)) if name in known else float(value)
    lines: list[str] = []
    for family, comments in about.items():
        lines += comments
        lines += (f"{name} {value}" for name, value in samples[family].items())
    return ("\n".join(lines) + "\n").encode()


def _join(family: str, one: float, other: float) -> float:
    if family.endswith("_created"):
        return min(one, other)
    if family in LARGEST:
        return max(one, other)
    return one + other
