"""OUT/results.ndjson: the lines of all logs in the order of their names, joined while the rest is diagnosed.

What comes before all that is still to be done can be joined already:

    a.bag  b.bag  c.bag  d.bag
    done   done   …      done          a and b are joined now, d when c is

The first lines are a file that is renamed, not copied: for a run over one log these are mostly all.
"""

from __future__ import annotations

import os
from collections.abc import Iterable
from heapq import heappop, heappush
from io import BytesIO
from pathlib import Path
from shutil import copyfileobj

from robomend_batch.one_log import RESULTS, Record
from robomend_batch.parts import PIECE


class Joined:
    """See the module."""

    def __init__(self, out: Path, left: Iterable[str]) -> None:
        """`left`: the names of the files that are still to be done."""
        self._file = out / "results.ndjson"
        self._beside = self._file.with_name("results.ndjson.tmp")
        self._parts = out / RESULTS
        self._left = sorted(left, reverse=True)
        self._done: set[str] = set()
        self._waiting: list[tuple[str, tuple[str, ...]]] = []
        self._beside.unlink(missing_ok=True)

    def add(self, records: Iterable[Record]) -> None:
        """Take in the records of logs that are done."""
        for record in records:
            heappush(self._waiting, (str(record["log"]), tuple(record["parts"])))

    def finished(self, name: str, records: Iterable[Record]) -> None:
        """Take in the records of a file that was still to be done, and join what can be."""
        self.add(records)
        self._done.add(name)
        while self._left and self._left[-1] in self._done:
            self._done.remove(self._left.pop())
        while self._waiting and (not self._left or self._waiting[0][0] < self._left[-1]):
            self._join(heappop(self._waiting)[1])

    def close(self) -> None:
        """Join what is left, and rename it all."""
        while self._waiting:
            self._join(heappop(self._waiting)[1])
        self._beside.touch()
        os.replace(self._beside, self._file)

    def _join(self, parts: Iterable[str]) -> None:
        for part in parts:
            piece = (self._parts / part).with_suffix(PIECE)
            if not self._beside.exists() and piece.exists():
                os.replace(piece, self._beside)
                continue
            with self._beside.open("ab") as file:
                if piece.exists():
                    with piece.open("rb") as lines:  # a buffer of 1 MB would be new memory for each of them
                        copyfileobj(lines, file)
                    piece.unlink()
                else:  # of an earlier run
                    file.write(_lines_of(self._parts / part))


def _lines_of(part: Path) -> memoryview:
    import polars as pl

    text = BytesIO()  # so that a full disk is an OSError with its number
    pl.read_parquet(part).write_ndjson(text)
    return text.getbuffer()
