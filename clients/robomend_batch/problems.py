"""What is wrong with a log: reason and place, told once and counted."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from robomend.errors import InputError

MOST = 50
"""Different problems of one log that are kept; the rest is counted."""


class LogRefused(InputError):
    """A log that cannot be diagnosed at all."""

    code = "log-refused"

    def __init__(self, reason: str, place: str) -> None:
        super().__init__(reason, place)
        self.reason = reason
        self.place = place

    def __str__(self) -> str:
        return f"{self.place}: {self.reason}"


class Problems:
    """The problems of one log."""

    def __init__(self) -> None:
        self._count: Counter[tuple[str, str]] = Counter()
        self._bad: set[tuple[str, str]] = set()
        self.left_out = 0
        self.called = "", ""
        """A path, and what it is called in its place: that of an unpacked log."""

    def add(self, place: str, reason: str, *, bad: bool) -> None:
        """Note a problem.

        Args:
            place: file, and line, row or topic.
            reason: in words; on one line, whatever a library's error looks like.
            bad: it makes the log a bad one; otherwise it is worth knowing only.
        """
        path, name = self.called
        if path != name:
            place, reason = place.replace(path, name), reason.replace(path, name)
        reason = " ".join(reason.split())
        key = place, reason
        if key not in self._count and len(self._count) >= MOST:
            self.left_out += 1
            return
        self._count[key] += 1
        if bad:
            self._bad.add(key)

    @contextmanager
    def told_before(self, before: bool = True) -> Iterator[None]:
        """What is added meanwhile was added before, if so, and counts once."""
        count, bad, left_out = self._count.copy(), set(self._bad), self.left_out
        yield
        if before:
            self._count, self._bad, self.left_out = count, bad, left_out

    @property
    def bad(self) -> bool:
        """Whether any of them makes the log a bad one."""
        return bool(self._bad)

    def json(self) -> list[dict[str, Any]]:
        """Return them in the order in which they were met."""
        found = [
            {"place": place, "reason": reason, "bad": (place, reason) in self._bad, "count": count}
            for (place, reason), count in self._count.items()
        ]
        if self.left_out:
            found.append({"place": "", "reason": "further problems", "bad": False, "count": self.left_out})
        return found
