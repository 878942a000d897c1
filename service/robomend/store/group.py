"""One database transaction for a group of changes; transaction.py is what each of them sees of it.

    change ──► rows in memory (log, audit, idempotency keys) ─────────────┐
           ──► anything else: at once, inside a savepoint of its own      │
                                                                          ▼
    group: lock the robots ─► change ─► change ─► … ─► ids ─► all rows, one statement a table ─► COMMIT

The hot path, observations, thus costs no statement of its own: a group of a hundred costs the statements of
one.

Locks are taken in one order by every instance, so that none waits in a circle: robots by name, then what the
changes touch, then the counters of audit and events. The counters come last because they stop every other
writer until the COMMIT: that is what makes event ids gapless and committed in their order.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from typing import Any, TypeVar

from sqlalchemy import Connection, Insert, Select, bindparam, select, text
from sqlalchemy.dialects import postgresql

from robomend.errors import StateConflict
from robomend.store import folding, results, schema
from robomend.store.encoding import checked, digest, from_json, to_json
from robomend.store.records import IdempotencyKey
from robomend.store.rows import LOG, NEWEST_EVENT, OBS, ONCE, LockedRobot, Logged, Rows, upsert
from robomend.store.transaction import Transaction
from robomend_client.events import Event

T = TypeVar("T")

Answers = dict[str, tuple[str, str]]
"""Digest of an idempotency key -> digest of the request, answer."""

CHANNEL = "robomend_events"
"""PostgreSQL's notification channel; the payload is the newest id."""

_AT_ONCE = 500
"""Names in one statement."""

# Made once: building a statement costs several times as much as running it.
_STATE, _ROBOTS = schema.robot_state, schema.robots
_LOCK: Select[Any] = (
    select(
        _STATE.c.robot,
        _STATE.c.revision,
        *folding.newest_batches(_STATE.c.robot),
        _STATE.c.fence,
        _STATE.c.owner,
        _ROBOTS.c.id.is_not(None).label("there"),
    )
    .select_from(_STATE.outerjoin(_ROBOTS, _ROBOTS.c.id == _STATE.c.robot))
    .where(_STATE.c.robot.in_(bindparam("names", expanding=True)))
    .order_by(_STATE.c.robot)
    .with_for_update(of=_STATE)  # SQLite, where one transaction writes at a time, has no such clause
)
_ANSWERS = select(schema.idempotency).where(
    schema.idempotency.c.digest.in_(bindparam("digests", expanding=True))
)
_REVISED = _STATE.update().where(_STATE.c.robot == bindparam("of_robot")).values(revision=bindparam("to"))
_COUNT = (
    schema.counters.update()
    .where(schema.counters.c.name == bindparam("counter"))
    .values(value=schema.counters.c.value + bindparam("by"))
    .returning(schema.counters.c.value)
)
_COUNT_EVENTS = text(
    "WITH counted AS (UPDATE counters SET value = value + :by WHERE name = 'event' RETURNING value)"
    " SELECT value, pg_notify(:channel, CAST(value AS text)) FROM counted"
)
"""PostgreSQL's: the other instances hear of it at the COMMIT."""
_NEWEST_EVENT = text(NEWEST_EVENT)


def _keep_answer(kind: str) -> Insert:
    """Return the statement that keeps an answer; a key that is used again, after its time, counts as new."""
    if kind == "sqlite":
        return schema.idempotency.insert().prefix_with("OR REPLACE")
    insert = postgresql.insert(schema.idempotency)
    names = ("number", *ONCE[1:])
    return insert.on_conflict_do_update(
        index_elements=["digest"], set_={name: insert.excluded[name] for name in names}
    )


_KEEP_ANSWER = {kind: _keep_answer(kind) for kind in ("sqlite", "postgresql")}


class Group:
    """The database transaction that a group of changes shares; `connection` is in it already."""

    def __init__(
        self, connection: Connection, robots: Collection[str], onces: Sequence[IdempotencyKey], now_ns: int
    ) -> None:
        self.connection = connection
        self.kind = connection.dialect.name
        self.now_ns = now_ns
        self.rows = Rows()
        self.rows.states = self.lock(robots)
        self.answers = self._answered(onces)
        self._last: int | None = None  # the id of its newest event, if it has any

    def run(self, change: Callable[[Transaction], T], once: IdempotencyKey | None) -> T:
        """Run one change; if it raises, nothing of it is left."""
        if once is not None and (answer := self.answers.get(digest(once.whole))) is not None:
            request, response = answer
            if request != digest(once.request):
                error = StateConflict(
                    f"the idempotency key {once.key!r} was used for another request; take a new one"
                )
                error.code = "idempotency-key-reused"
                raise error
            answered: T = from_json(response)
            return answered
        tx = Transaction(self)
        try:
            result = change(tx)
            if once is not None and not tx.repeatable:
                tx.answer_once(once, to_json(result))
        except Exception:  # the caller gets it; only its writes are taken back
            if not self.connection.invalidated:  # a lost connection took everything back already
                tx.undo()
            raise
        tx.done()
        return result

    def lock(self, robots: Collection[str]) -> dict[str, LockedRobot]:
        """Lock robots, in the order of their names, and return what is known of them."""
        names = sorted({checked(robot) for robot in robots})
        return {
            row.robot: LockedRobot(folding.newest(row), row.fence, row.owner, bool(row.there))
            for start in range(0, len(names), _AT_ONCE)
            for row in self.connection.execute(_LOCK, {"names": names[start : start + _AT_ONCE]})
        }

    def _answered(self, onces: Sequence[IdempotencyKey]) -> Answers:
        """Return what was answered already."""
        keys = sorted({digest(once.whole) for once in onces})
        return {
            row.digest: (row.request, row.response)
            for start in range(0, len(keys), _AT_ONCE)
            for row in self.connection.execute(_ANSWERS, {"digests": keys[start : start + _AT_ONCE]})
            if row.expires_ns > self.now_ns
        }

    def flush(self, rows: Rows) -> None:
        """Write the rows that have no id yet to get: all but audit and log."""
        if rows.obs:
            kept = [dict(zip(OBS, row, strict=True)) for row in rows.obs.values()]
            self.connection.execute(upsert(self.kind, schema.obs), kept)
            rows.obs = {}
        if rows.once:
            answers = [dict(zip(ONCE, (key, *row), strict=True)) for key, row in rows.once.items()]
            self.connection.execute(_KEEP_ANSWER[self.kind], answers)
            rows.once = {}

    def finish(self) -> None:
        """Write what is left, and give the ids. The COMMIT comes next, and then `events`."""
        rows = self.rows
        self.flush(rows)
        if rows.revised and self.kind == "postgresql":
            revised = [
                {"of_robot": robot, "to": rows.states[robot].revision} for robot in sorted(rows.revised)
            ]
            self.connection.execute(_REVISED, revised)
        if rows.audit:
            last = self._count("audit", len(rows.audit))
            for id_, values in enumerate(rows.audit, last - len(rows.audit) + 1):
                values["id"] = id_
            self.connection.execute(schema.audit.insert(), rows.audit)
        if rows.log:
            self._keep_log(rows.log)
        elif rows.turn and self.kind == "postgresql":  # on SQLite it is the transaction's own
            self._count("event", 0)
        for robot in sorted(rows.folding):
            folding.bring_up(self.connection, robot, rows.states[robot].revision)

    def _keep_log(self, log: list[Logged]) -> None:
        """Write the rows of the log; each has the id of the last of its events."""
        numbers = results.number(self.connection, self.rows.common, self.now_ns)
        count = sum([len(row.told) for row in log])
        if self.kind == "postgresql":
            counted = self.connection.execute(_COUNT_EVENTS, {"by": count, "channel": CHANNEL})
            self._last = int(counted.scalar_one())
        else:
            self._last = int(self.connection.execute(_NEWEST_EVENT).scalar_one()) + count
        place, rows = self._last - count, []
        for row in log:
            place += len(row.told)
            common = None if row.digest is None else numbers[row.digest]
            values = (place, self.now_ns, row.kind, row.robot, row.revision, row.batch, row.data, common)
            rows.append(dict(zip(LOG, values, strict=True)))
        self.connection.execute(schema.events.insert(), rows)

    def events(self) -> tuple[Event, ...]:
        """Return the events of the group, which is finished and committed."""
        if self._last is None:
            return ()
        told = [(kind, row.robot, data) for row in self.rows.log for kind, data in row.told]
        first, now_ns = self._last - len(told) + 1, self.now_ns
        return tuple([Event(id_, now_ns, *event) for id_, event in enumerate(told, first)])

    def _count(self, counter: str, by: int) -> int:
        return int(self.connection.execute(_COUNT, {"counter": counter, "by": by}).scalar_one())
