"""Batches that say nothing new, as observers send every second: they renew what is held, and that is all.

    a batch ──⊕──► OBS changes? ── yes ──► a revision: history, event, diagnosis (robots.py)
                        │ no
                        ▼
                   evidence and lifetimes in memory; lifetimes on the disk, in place

So a robot to which nothing happens adds nothing to the database, however often it says so. Kept in full are:
the first report of a key and source since the start, so that the history and the audit log have who reports;
what comes while a repair or a drill is open, as each report is evidence then, which is looked for in the
history after a crash and from other instances; what comes while a write is under way, as it may fail.
"""

from __future__ import annotations

from collections.abc import Sequence

from robomend.entry import Entry
from robomend.robots.batches import Update
from robomend.robots.diagnosing import Diagnosing
from robomend.robots.reporters import Reporter, Reports
from robomend.robots.robot import Robot
from robomend.store import Store, Transaction, observations
from robomend.store.records import IdempotencyKey, Json


class Renewing:
    """See the module. Belongs to one event loop."""

    def __init__(self, store: Store, diagnosing: Diagnosing, reports: Reports) -> None:
        self._store = store
        self._diagnosing = diagnosing
        self._reports = reports

    async def keep(
        self,
        robot: Robot,
        update: Update,
        renewed: Sequence[Entry],
        by: Reporter,
        once: IdempotencyKey | None,
    ) -> Json | None:
        """Keep an update that OBS in memory has taken in, and that changed nothing; return what to answer.

        None: it is to be kept in full.

        Raises:
            StateConflict: another instance was faster (code "stale-revision").
        """
        more = update.retracted or update.asserted or update.withdrawn
        if more or robot.writing or not self._reports.known(robot.id, by, update):
            return None
        revision, ran = robot.revision, False

        def renew(tx: Transaction) -> Json:
            nonlocal ran
            ran = True
            tx.repeatable = update.dated
            kept = observations.renew(tx, robot.id, renewed, expected=revision)
            if not kept:
                tx.repeatable = True  # the write in full has the key
            return {"revision": revision, "changed": []} if kept else {}

        try:
            said = await self._store.write(renew, robots=(robot.id,), once=once)
        except BaseException:  # a cancellation too: nobody knows then whether it is on disk
            robot.not_kept()
            raise
        if not ran:  # a request with the same key was: what memory has is not what the store has
            robot.half_applied()
        elif said:
            self._diagnosing.confirm(robot)
            robot.observed.wake()
        return said or None
