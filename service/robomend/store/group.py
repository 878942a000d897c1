"""One database transaction for a group of changes; transaction.py is what each of them sees of it.

    change ──► rows in memory (observations, events, audit, idempotency keys) ──┐
           ──► anything else: at once, inside a savepoint of its own            │
                                                                                ▼
    group: lock the robots ─► change ─► change ─► … ─► all rows, one statement a table ─► ids ─► COMMIT

The hot path, observations, thus costs no statement of its own: a group of a hundred costs the statements of
one. A change that asks the database something first has the rows put there, so it sees them.

Locks are taken in one order by every instance, so that none waits in a circle: robots by name, then what the
changes touch, then the counters of audit and events. The counters come last because they stop every other
writer until the COMMIT: that is what makes event ids gapless and committed in their order.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import TypeVar

from sqlalchemy import Connection, Executable, Table, bindparam, select, text

from robomend.errors import StateConflict
from robomend.store import results, schema
from robomend.store.encoding import checked, from_json, to_json
from robomend.store.prepared import Prepared, select_in
from robomend.store.records import IdempotencyKey
from robomend.store.rows import LockedRobot, Rows, Values, upsert
from robomend.store.transaction import Transaction
from robomend_client.events import Event

T = TypeVar("T")

CHANNEL = "robomend_events"
"""PostgreSQL's notification channel; the payload is the newest id."""

_FORGET = schema.obs.delete().where(
    schema.obs.c.robot == bindparam("of_robot"), schema.obs.c.atom == bindparam("of_atom")
)


def _revise(kind: str) -> Executable:
    """Return the statement that moves a robot's revision on; of SQLite's, one with many VALUES moves many."""
    if kind == "sqlite":
        return text(
            "WITH revised (robot, revision) AS (VALUES (:of_robot, :to_revision))"
            " UPDATE robot_state SET revision = revised.revision FROM revised"
            " WHERE robot_state.robot = revised.robot"
        )
    table = schema.robot_state
    of_robot = table.c.robot == bindparam("of_robot")
    return table.update().where(of_robot).values(revision=bindparam("to_revision"))


def _inserts(table: Table) -> Prepared:
    columns = [column.name for column in table.columns if column.name != "number"]
    return Prepared(lambda _: table.insert(), columns)


# Made once: building a statement costs several times as much as running it.
_KEEP_BATCH = _inserts(schema.observations)
_KEEP_DIAGNOSIS = _inserts(schema.diagnoses)
_KEEP_EVENT = _inserts(schema.events)
_KEEP_OBS = Prepared(lambda kind: upsert(kind, schema.obs), schema.obs.columns.keys())
_KEEP_REVISION = Prepared(_revise)
_KEEP_AUDIT = schema.audit.insert()
_LOOK_AT_ROBOTS = """
    SELECT robot_state.robot, revision, fence, owner, robots.id IS NOT NULL
    FROM robot_state LEFT JOIN robots ON robots.id = robot_state.robot
"""
_STATES = {
    "sqlite": f"{_LOOK_AT_ROBOTS} WHERE robot_state.robot IN ({{keys}}) ORDER BY robot_state.robot",
    "postgresql": f"{_LOOK_AT_ROBOTS} WHERE robot_state.robot = ANY(%s) ORDER BY robot_state.robot"
    " FOR UPDATE OF robot_state",
}
_ANSWERS = select(schema.idempotency).where(
    schema.idempotency.c.key.in_(bindparam("keys", expanding=True)),
    schema.idempotency.c.expires_ns > bindparam("now_ns"),
)
_COUNT = (
    schema.counters.update()
    .where(schema.counters.c.name == bindparam("counter"))
    .values(value=schema.counters.c.value + bindparam("by"))
    .returning(schema.counters.c.value)
)
_NEXT = Prepared(lambda _: _COUNT)
_NOTIFY = text("SELECT pg_notify(:c, :id)")


class Group:
    """The database transaction that a group of changes shares; `connection` is in it already."""

    def __init__(
        self, connection: Connection, robots: Iterable[str], onces: Iterable[IdempotencyKey], now_ns: int
    ) -> None:
        self.connection = connection
        self.kind = connection.dialect.name
        self.now_ns = now_ns
        self.rows = Rows()
        self.rows.states.update(self.lock(robots))
        self._numbers: dict[str, int] = {}  # of results, by digest
        self.answers = self._answers(onces)

    def run(self, change: Callable[[Transaction], T], once: IdempotencyKey | None) -> T:
        """Run one change; if it raises, nothing of it is left."""
        if once is not None and (answer := self.answers.get((once.scope, once.key))) is not None:
            request, response = answer
            if request != once.request:
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

    def lock(self, robots: Iterable[str]) -> dict[str, LockedRobot]:
        """Lock robots, in the order of their names, and return what is known of them."""
        names = sorted({checked(robot) for robot in robots})
        found: dict[str, LockedRobot] = {}
        for start in range(0, len(names), 500):
            for robot, revision, fence, owner, there in select_in(
                self.connection, _STATES, names[start : start + 500]
            ):
                found[robot] = LockedRobot(revision, fence, owner, bool(there))
        return found

    def _answers(self, onces: Iterable[IdempotencyKey]) -> dict[tuple[str, str], tuple[str, str]]:
        keys = sorted({checked(once.key) for once in onces})
        answers = {}
        for start in range(0, len(keys), 500):
            some = {"keys": keys[start : start + 500], "now_ns": self.now_ns}
            for row in self.connection.execute(_ANSWERS, some):
                answers[row.scope, row.key] = (row.request, row.response)
        return answers

    def flush(self, rows: Rows) -> None:
        """Write the rows that have no id yet to get: all but audit and events."""
        execute = self.connection.execute
        if rows.history:
            _KEEP_BATCH.run(self.connection, rows.history)
        kept = [values for values in rows.obs.values() if values is not None]
        if kept:
            _KEEP_OBS.run(self.connection, kept)
        if len(kept) < len(rows.obs):
            gone = [key for key, values in rows.obs.items() if values is None]
            execute(_FORGET, [{"of_robot": robot, "of_atom": atom} for robot, atom in gone])
        if rows.revised:
            states = rows.states
            revised = [{"of_robot": r, "to_revision": states[r].revision} for r in sorted(rows.revised)]
            _KEEP_REVISION.run(self.connection, revised)
        self._give_numbers(rows.common)
        if rows.diagnoses:
            _KEEP_DIAGNOSIS.run(self.connection, [self._numbered(values) for values in rows.diagnoses])
        if rows.once:
            execute(upsert(self.kind, schema.idempotency), list(rows.once.values()))
        rows.history, rows.obs, rows.revised, rows.once, rows.diagnoses = [], {}, set(), {}, []

    def finish(self) -> tuple[Event, ...]:
        """Write what is left, give the ids, and return the events. The COMMIT comes next."""
        self.flush(self.rows)
        audit, pending = self.rows.audit, self.rows.events
        if audit:
            last = self._count("audit", len(audit))
            for id_, values in enumerate(audit, last - len(audit) + 1):
                values["id"] = id_
            self.connection.execute(_KEEP_AUDIT, audit)
        if not pending:
            if self.rows.turn and self.kind == "postgresql":  # on SQLite it is the transaction's own
                self._count("event", 0)
            return ()
        last = self._count("event", len(pending))
        events = tuple(
            Event(id_, self.now_ns, kind, robot, data)
            for id_, (kind, robot, data, _) in enumerate(pending, last - len(pending) + 1)
        )
        _KEEP_EVENT.run(
            self.connection,
            [
                {
                    "id": e.id,
                    "time_ns": e.time_ns,
                    "kind": e.kind.value,
                    "robot": e.robot,
                    **self._numbered(kept),
                }
                for e, (_, _, _, kept) in zip(events, pending, strict=True)
            ],
        )
        if self.kind == "postgresql":
            self.connection.execute(_NOTIFY, {"c": CHANNEL, "id": str(last)})
        return events

    def _give_numbers(self, common: dict[str, str]) -> None:
        """Keep the results that are not yet, and learn their numbers."""
        new = {digest: text for digest, text in common.items() if digest not in self._numbers}
        if new:
            self._numbers.update(results.number(self.connection, new, self.now_ns))

    def _numbered(self, values: Values) -> Values:
        digest = values["common"]
        return values if digest is None else {**values, "common": self._numbers[digest]}

    def forget_numbers(self) -> None:
        """Some of the results were taken back."""
        self._numbers.clear()

    def _count(self, counter: str, by: int) -> int:
        return int(_NEXT.value(self.connection, {"counter": counter, "by": by}))
