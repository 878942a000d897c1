"""What is wrong outside, told once for each place: until it is over, or turns into something else."""

from __future__ import annotations

import logging
import time
from collections import Counter

log = logging.getLogger(__name__)

MOST_PLACES = 1000
MOST_MESSAGES = 20
"""Of one place: what goes to and fro between a few (no answer, no way there) is not told each time."""

MIXED_S = 10.0
"""Messages that can be read may come among those that cannot; it is over once all of them can for so long."""


class Complaint(Exception):
    """What is wrong with what somebody sent.

    `kind` is the same each time; `seen` (a length, an excerpt) is what it was this time. Garbage is seldom
    the same twice, and is one problem all the same.
    """

    def __init__(self, kind: str, seen: str = "") -> None:
        super().__init__(kind, seen)
        self.kind = kind
        self.seen = seen

    def __str__(self) -> str:
        return f"{self.kind}: {self.seen}" if self.seen else self.kind


class Problems:
    """The problems of one bridge."""

    def __init__(self, where: str) -> None:
        """`where` is what the bridge leads to: ROS 1, ROS 2."""
        self._where = where
        self.counts: Counter[str] = Counter()  # place -> how often something was wrong there
        self._told: dict[str, set[str]] = {}
        self._newest_s: dict[str, float] = {}

    def tell(self, place: str, problem: str | Exception) -> None:
        """Something is wrong at a place: a topic, a publisher, the master."""
        if place not in self.counts and len(self.counts) >= MOST_PLACES:
            return
        self.counts[place] += 1
        self._newest_s[place] = time.monotonic()
        kind = problem.kind if isinstance(problem, Complaint) else str(problem)
        told = self._told.setdefault(place, set())
        if kind not in told and len(told) < MOST_MESSAGES:
            told.add(kind)
            # One line, whatever a peer or a parser wrote.
            log.warning("%s, %s: %s", self._where, place, " ".join(str(problem).split()))

    def over(self, place: str, quiet_s: float = 0) -> None:
        """It is well again: what goes wrong next is told again.

        With `quiet_s`, only when nothing was wrong there for so long: good and bad messages may come mixed.
        """
        if place in self._told and time.monotonic() - self._newest_s[place] >= quiet_s:
            del self._told[place], self._newest_s[place]
            log.info("%s, %s: well again", self._where, place)
