"""A log in hand, written down now and then, so that a run that is killed goes on in the middle of it.

    reader ──► Place ──► what is known of the log until there ──► OUT/results/NAME.state, beside and renamed

What is written is all that the rest of the log depends on: how far the file was read, the observers with
their samples, what the sensors show, the intervals that wait, the parts that are done. So what is left is the
same bytes as without a break. Only what is common to all logs (solvers, vocabulary, the folder) stays here.

A state is a pickle, and pickles can do anything: one that is not of the user who runs this is not looked at.
"""

from __future__ import annotations

import os
import pickle
from collections.abc import Mapping
from io import BytesIO
from math import inf
from pathlib import Path
from time import monotonic
from typing import Any

ENDING = ".state"

EVERY_S = 1.0
"""Between two of them, at least; …"""

SHARE = 20
"""… and so many times as long as writing one took."""

Stamp = tuple[int, int]
"""Size and time of a file, by which it is known."""


def stamp(name: str) -> Stamp:
    """Return size and time of a file; of one that is gone, zeros."""
    try:
        found = Path(name).stat()
    except OSError:
        return 0, 0
    return found.st_size, found.st_mtime_ns


class Unfinished:
    """The state of one log in hand."""

    def __init__(self, file: Path, stamped: Stamp, stays: Mapping[str, object], span_s: float = inf) -> None:
        """
        Args:
            file: to keep it in.
            stamped: of the log; the state of a log that has changed does not count.
            stays: what is not written but found again, by a name.
            span_s: for how long the log is in hand; the first state is written by its end.
        """
        self._file = file
        self._stamped = stamped
        self._stays = stays
        self._next_s = monotonic() + min(EVERY_S, span_s)
        self._possible = True
        self.kept = False
        """Whether there is a state."""

    @property
    def due(self) -> bool:
        """Whether it is time to write."""
        return self._possible and monotonic() >= self._next_s

    def save(self, what: object) -> None:
        """Write a state; an observer of somebody's own that cannot be written stays unwritten for good."""
        began_s = monotonic()
        data = BytesIO()
        try:
            _Pickler(data, self._stays).dump((self._stamped, what))
        except Exception:  # noqa: BLE001  # whatever an observer's own __reduce__ raises
            self._possible = False
            return
        beside = self._file.with_suffix(f".{os.getpid()}.state.tmp")
        beside.write_bytes(data.getbuffer())
        os.replace(beside, self._file)
        self.kept = True
        now_s = monotonic()
        self._next_s = now_s + max(EVERY_S, SHARE * (now_s - began_s))

    def load(self) -> Any:
        """Return what was saved last; None if there is nothing that can be gone on with."""
        try:
            if self._file.stat().st_uid != os.geteuid():
                return None
            with self._file.open("rb") as file:
                stamped, found = _Unpickler(file, self._stays).load()
        except FileNotFoundError:
            return None
        except Exception:  # noqa: BLE001  # of another version of a library, or of an observer of a FILE.py
            self._possible = False  # the log is read in one go
            return None
        self.kept = stamped == self._stamped
        return found if self.kept else None


class _Pickler(pickle.Pickler):
    def __init__(self, file: BytesIO, stays: Mapping[str, object]) -> None:
        super().__init__(file, protocol=pickle.HIGHEST_PROTOCOL)
        self._names = {id(one): name for name, one in stays.items() if one is not None}

    def persistent_id(self, found: object) -> str | None:
        return self._names.get(id(found))


class _Unpickler(pickle.Unpickler):
    def __init__(self, file: Any, stays: Mapping[str, object]) -> None:
        super().__init__(file)
        self._stays = stays

    def persistent_load(self, name: str) -> object:
        return self._stays[name]
