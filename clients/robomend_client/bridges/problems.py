"""What is wrong outside, told once for each place: until it is over, or turns into something else."""

from __future__ import annotations

import logging
from collections import Counter

log = logging.getLogger(__name__)

MOST_PLACES = 1000
MOST_MESSAGES = 20
"""Of one place: what goes to and fro between a few (no answer, no way there) is not told each time."""


class Problems:
    """The problems of one bridge."""

    def __init__(self, where: str) -> None:
        """`where` is what the bridge leads to: ROS 1, ROS 2."""
        self._where = where
        self.counts: Counter[str] = Counter()  # place -> how often something was wrong there
        self._told: dict[str, set[str]] = {}

    def tell(self, place: str, message: str) -> None:
        """Something is wrong at a place: a topic, a publisher, the master."""
        if place not in self.counts and len(self.counts) >= MOST_PLACES:
            return
        self.counts[place] += 1
        told = self._told.setdefault(place, set())
        if message not in told and len(told) < MOST_MESSAGES:
            told.add(message)
            log.warning("%s, %s: %s", self._where, place, message)

    def over(self, place: str) -> None:
        """It is well again: what goes wrong next is told again."""
        if self._told.pop(place, None) is not None:
            log.info("%s, %s: well again", self._where, place)
