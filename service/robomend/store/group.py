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

from collections.abc import Callable, Collection, Sequence
from typing import TypeVar

from sqlalchemy import Executable, Table, bindparam, select, text

from robomend.errors import StateConflict
from robomend.store import results, schema
from robomend.store.driver import DriverConnection
from robomend.store.encoding import checked, from_json, to_json
from robomend.store.known import KnownRows
from robomend.store.prepared import Prepared
from robomend.store.records import IdempotencyKey
from robomend.store.rows import DIAGNOSES, EVENTS, HISTORY, OBS, LockedRobot, Row, Rows, upsert
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


def _inserts(table: Table, columns: Sequence[str]) -> Prepared:
    return Prepared(lambda _: table.insert(), columns)


# Made once: building a statement costs several times as much as running it.
_KEEP_BATCH = _inserts(schema.observations, HISTORY)
_KEEP_DIAGNOSIS = _inserts(schema.diagnoses, DIAGNOSES)
_KEEP_EVENT = _inserts(schema.events, EVENTS)
_KEEP_OBS = Prepared(lambda kind: upsert(kind, schema.obs), OBS)
_KEEP_REVISION = Prepared(_revise, ("of_robot", "to_revision"))
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
_NEXT = Prepared(lambda _: _COUNT, ("counter", "by"))
_TELL = """
    WITH counted AS (UPDATE counters SET value = value + :by WHERE name = :counter RETURNING value)
    SELECT value, pg_notify(:channel, CAST(value AS text)) FROM counted
"""
_NEXT_TOLD = Prepared(
    lambda _: text(_TELL), ("counter", "by", "channel")
)  # the others hear of it at the COMMIT


class Group:
    """The database transaction that a group of changes shares; `connection` is in it already."""

    def __init__(
        self,
        driver: DriverConnection,
        known: KnownRows,
        robots: Collection[str],
        onces: Sequence[IdempotencyKey],
        now_ns: int,
    ) -> None:
        """`known`: what need not be looked up; whoever fails to commit the group has it forgotten."""
        self.driver = driver
        self.connection = driver.connection
        self.kind = driver.kind
        self.now_ns = now_ns
        self.rows = Rows()
        self._numbers: dict[str, int] = {}  # of results that this group found or wrote, by digest
        self._known = known
        known.look(driver, now_ns // results.DAY_NS)
        self.rows.states = self.lock(robots)
        self.answers = self._answers(onces) if onces else {}

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

    def lock(self, robots: Collection[str]) -> dict[str, LockedRobot]:
        """Lock robots, in the order of their names, and return what is known of them."""
        known = self._known.robots
        found = {robot: known[robot] for robot in robots if robot in known}
        if len(found) == len(robots):
            return found
        names = sorted({checked(robot) for robot in robots if robot not in found})
        for start in range(0, len(names), 500):
            some = names[start : start + 500]
            for robot, revision, fence, owner, there in self.driver.select_in(_STATES, some):
                found[robot] = LockedRobot(revision, fence, owner, bool(there))
        return found

    def _answers(self, onces: Sequence[IdempotencyKey]) -> dict[tuple[str, str], tuple[str, str]]:
        keys = sorted({checked(once.key) for once in onces})
        answers = {}
        for start in range(0, len(keys), 500):
            some = {"keys": keys[start : start + 500], "now_ns": self.now_ns}
            for row in self.connection.execute(_ANSWERS, some):
                answers[row.scope, row.key] = (row.request, row.response)
        return answers

    def flush(self, rows: Rows) -> None:
        """Write the rows that have no id yet to get: all but audit and events."""
        execute, driver = self.connection.execute, self.driver
        if rows.history:
            _KEEP_BATCH.run(driver, rows.history)
            rows.history = []
        if rows.obs:
            kept = [values for values in rows.obs.values() if values is not None]
            if kept:
                _KEEP_OBS.run(driver, kept)
            if len(kept) < len(rows.obs):
                gone = [key for key, values in rows.obs.items() if values is None]
                execute(_FORGET, [{"of_robot": robot, "of_atom": atom} for robot, atom in gone])
            rows.obs = {}
        if rows.revised:
            states = rows.states
            _KEEP_REVISION.run(driver, [(robot, states[robot].revision) for robot in sorted(rows.revised)])
            rows.revised = set()
        if rows.common:
            self._give_numbers(rows.common)
        if rows.diagnoses:
            _KEEP_DIAGNOSIS.run(driver, [self._numbered(row) for row in rows.diagnoses])
            rows.diagnoses = []
        if rows.once:
            execute(upsert(self.kind, schema.idempotency), list(rows.once.values()))
            rows.once = {}

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
        if self.kind == "postgresql":
            last = int(_NEXT_TOLD.value(self.driver, ("event", len(pending), CHANNEL)))
        else:
            last = self._count("event", len(pending))
        now_ns, events, rows = self.now_ns, [], []
        for id_, (kind, robot, data, own, digest) in enumerate(pending, last - len(pending) + 1):
            events.append(Event(id_, now_ns, kind, robot, data))
            rows.append(self._numbered((id_, now_ns, str(kind), robot, own, digest)))
        _KEEP_EVENT.run(self.driver, rows)
        return tuple(events)

    def _give_numbers(self, common: dict[str, str]) -> None:
        """Keep the results that are not yet, and learn their numbers."""
        known = self._known.numbers
        new = {d: text for d, text in common.items() if d not in self._numbers and d not in known}
        if new:
            self._numbers.update(results.number(self.driver, new, self.now_ns))

    def _numbered(self, row: Row) -> Row:
        """Return a row of which the last column is the number of its result, in place of its digest."""
        digest = row[-1]
        if digest is None:
            return row
        number = self._numbers.get(digest)
        return (*row[:-1], self._known.numbers[digest] if number is None else number)

    def otherwise(self) -> None:
        """Something is changed by a statement of its own: what is known may not be so any more."""
        self._known.forget()

    def learned(self) -> None:
        """The transaction was committed."""
        self._known.learn(self.rows.states, self._numbers)

    def forget_numbers(self) -> None:
        """Some of the results were taken back."""
        self._numbers.clear()

    def _count(self, counter: str, by: int) -> int:
        return int(_NEXT.value(self.driver, (counter, by)))
