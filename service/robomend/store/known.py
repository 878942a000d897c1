"""What a writer knows without asking, for as long as nobody else has changed it.

Every group would have to look up its robots' rows, the numbers of its results and the newest event. SQLite
tells in one word and without the disk whether another connection has committed anything (`data_version`): if
none has, what our own last groups found and wrote is what is there. When we change anything else ourselves, a
robot's owner say, all is forgotten, and so it is when a group fails.

PostgreSQL has no such word, and locks the robots' rows by reading them. With them comes how often results
were removed (results.py); while that is the same, their numbers are.
"""

from __future__ import annotations

from collections.abc import Mapping

from robomend.store.driver import DriverConnection
from robomend.store.rows import LockedRobot

MOST = 20_000
"""Robots, and results; beyond, all are forgotten."""


class KnownRows:
    """See the module. Belongs to the writer's thread."""

    def __init__(self) -> None:
        self.robots: dict[str, LockedRobot] = {}
        self.numbers: dict[str, int] = {}
        """Of results that are marked as used on this day, by digest."""
        self.newest: int | None = None
        """The id of the newest event."""
        self._version: object = None
        self._day = -1

    def look(self, driver: DriverConnection, day: int) -> None:
        """A transaction of SQLite's has begun, on this day: forget what may have changed since the last."""
        self.is_at(driver.execute("PRAGMA data_version").fetchone(), day)

    def is_at(self, version: object, day: int) -> None:
        """The database is at this version, on this day: forget what is known of another."""
        if version != self._version or day != self._day:
            self.forget()
            self._version, self._day = version, day

    def learn(
        self, robots: Mapping[str, LockedRobot], numbers: Mapping[str, int], newest: int | None
    ) -> None:
        """A transaction that changed nothing else was committed, and left this; `newest`: if it told any."""
        if self._version is None:
            return
        if newest is not None:
            self.newest = newest
        if len(self.robots) + len(self.numbers) > MOST:
            self.robots.clear()
            self.numbers.clear()
        self.robots.update(robots)
        self.numbers.update(numbers)

    def forget(self) -> None:
        """Forget all; what is learned next counts only after the next look."""
        self.robots.clear()
        self.numbers.clear()
        self.newest = self._version = None
