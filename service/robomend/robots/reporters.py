"""Who reports what of a robot, for the audit log.

The history has the key of each batch. The audit log has what people look for after an incident:

    a sentence asserted or withdrawn         each time
    observations by another key              that it does so in the robot's place, once a minute for each
    observations by the robot's own key      that it reports, once an hour for each source

So a bridge that reports for a thousand robots with one key does not fill the disk.
"""

from __future__ import annotations

import time
from collections import OrderedDict
from typing import NamedTuple

from robomend.robots.batches import Update
from robomend.store import Transaction
from robomend.store.records import AuditEntry

AGAIN_S = 3600.0
"""Between two entries that say that a robot's own key reports."""

OTHERS_AGAIN_S = 60.0
"""Between two entries that say that another key reports in its place."""

REMEMBERED = 100_000
"""Robots, keys and sources whose latest entry is remembered."""

SHOWN = 20
"""Literals of a batch in its entry; the history has them all."""


class Reporter(NamedTuple):
    """Whoever reports observations or the result of an action."""

    name: str  # of the key
    own: bool = True  # False: a key that is not the robot's
    reason: str = ""


OURSELVES = Reporter("robomend")
"""What a board says, and what the service itself takes in."""


class Reports:
    """Whose reports are in the audit log, lately."""

    def __init__(self) -> None:
        self._noted: OrderedDict[tuple[str, str, str], float] = OrderedDict()

    def due(self, robot: str, by: Reporter, update: Update) -> bool:
        """Return whether the literals of an update are to have an entry."""
        if not update.entries or by is OURSELVES:
            return False
        noted = self._noted.get((robot, by.name, update.entries[0].source))
        return noted is None or time.monotonic() - noted >= (AGAIN_S if by.own else OTHERS_AGAIN_S)

    def known(self, robot: str, by: Reporter, update: Update) -> bool:
        """Return whether there is an entry of who reports these literals, since this instance started."""
        return by is OURSELVES or (robot, by.name, update.entries[0].source) in self._noted

    def noted(self, robot: str, by: Reporter, update: Update) -> None:
        """The entry of an update is written, if it was due."""
        if self.due(robot, by, update):
            who = (robot, by.name, update.entries[0].source)
            self._noted[who] = time.monotonic()
            self._noted.move_to_end(who)
            while len(self._noted) > REMEMBERED:
                self._noted.popitem(last=False)


def note(tx: Transaction, robot: str, by: Reporter, update: Update, revision: int, reports: bool) -> None:
    """Tell the audit log of an update; `reports`: of its literals, too."""
    if reports:
        told = [str(entry.literal) for entry in update.entries[:SHOWN]]
        after = {"revision": revision, "observations": told, "in_place_of_the_robot": not by.own}
        if len(update.entries) > SHOWN:
            after["of"] = len(update.entries)
        tx.note(AuditEntry(by.name, "observations.report", update.entries[0].source, robot, after=after))
    for assertion, record in update.asserted:
        said = {"revision": revision, "sentence": record.sentence, "source": record.source}
        tx.note(AuditEntry(by.name, "assertion.put", assertion.name, robot, after=said))
    for name in update.withdrawn:
        after = {"revision": revision}
        tx.note(AuditEntry(by.name, "assertion.withdraw", name, robot, by.reason, after=after))
