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

from collections.abc import Callable, Collection, Iterable, Sequence
from typing import Any, TypeVar

from sqlalchemy import Connection, Executable, Table, bindparam, select, text

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
    "postgresql": f"{_LOOK_AT_ROBOTS} WHERE robot_state.robot = ANY($1) ORDER BY robot_state.robot"
    " FOR UPDATE OF robot_state",
}
_REMOVALS = f"SELECT value FROM counters WHERE name = '{results.REMOVALS}'"
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
_KEEP_NEXT_EVENT = Prepared(
    lambda _: text(
        "INSERT INTO events (id, time_ns, kind, robot, data, common)"
        " SELECT value - :id, :time_ns, :kind, :robot, :data, :common FROM counters WHERE name = 'event'"
    ),
    EVENTS,
)
"""In place of its id stands how far it is below the counter, which only the server knows yet."""


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
        self.kind = driver.kind
        self.now_ns = now_ns
        self.rows = Rows()
        self._numbers: dict[str, int] = {}  # of results that this group found or wrote, by digest
        self._last: Callable[[], int] = lambda: 0  # the id of the newest event, once that is known
        self._known = known
        self.rows.states = self._begin(robots, now_ns // results.DAY_NS)
        self.answers = self._answers(onces) if onces else {}

    @property
    def connection(self) -> Connection:
        """SQLAlchemy's, in the transaction."""
        return self.driver.connection

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

    def _begin(self, robots: Collection[str], day: int) -> dict[str, LockedRobot]:
        """Lock the robots, once it is clear whether what is known still stands; PostgreSQL is told to begin,
        and asked for both, at once.
        """
        if self.kind == "sqlite":
            self._known.look(self.driver, day)
            return self.lock(robots)
        with self.driver.together():
            removals = self.driver.execute(_REMOVALS)
            looks = self._look_at(robots)
        self._known.is_at(removals.fetchall(), day)
        return _locked(looks)

    def lock(self, robots: Collection[str]) -> dict[str, LockedRobot]:
        """Lock robots, in the order of their names, and return what is known of them."""
        known = self._known.robots
        found = {robot: known[robot] for robot in robots if robot in known}
        if len(found) < len(robots):
            found |= _locked(self._look_at(robot for robot in robots if robot not in found))
        return found

    def _look_at(self, robots: Iterable[str]) -> list[Any]:
        names = sorted({checked(robot) for robot in robots})
        return [
            self.driver.select_in(_STATES, names[start : start + 500]) for start in range(0, len(names), 500)
        ]

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
        driver = self.driver
        if rows.history:
            _KEEP_BATCH.run(driver, rows.history)
            rows.history = []
        if rows.obs:
            kept = [values for values in rows.obs.values() if values is not None]
            if kept:
                _KEEP_OBS.run(driver, kept)
            if len(kept) < len(rows.obs):
                gone = [key for key, values in rows.obs.items() if values is None]
                self.connection.execute(
                    _FORGET, [{"of_robot": robot, "of_atom": atom} for robot, atom in gone]
                )
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
            self.connection.execute(upsert(self.kind, schema.idempotency), list(rows.once.values()))
            rows.once = {}

    def finish(self) -> None:
        """Write what is left, and give the ids. The COMMIT comes next, and then `events`."""
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
            return
        count, now_ns = len(pending), self.now_ns
        if self.kind == "postgresql":
            self._last = _NEXT_TOLD.later(self.driver, ("event", count, CHANNEL))
            places, keep = range(count - 1, -1, -1), _KEEP_NEXT_EVENT
        else:
            last = self._count("event", count)
            self._last = lambda: last
            places, keep = range(last - count + 1, last + 1), _KEEP_EVENT
        rows = [
            self._numbered((place, now_ns, str(kind), robot, own, digest))
            for place, (kind, robot, _, own, digest) in zip(places, pending, strict=True)
        ]
        keep.run(self.driver, rows)

    def events(self) -> tuple[Event, ...]:
        """Return the events of the group, which is finished and committed."""
        pending = self.rows.events
        first = self._last() - len(pending) + 1
        return tuple(
            [
                Event(id_, self.now_ns, kind, robot, data)
                for id_, (kind, robot, data, _, _) in enumerate(pending, first)
            ]
        )

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
        states = self.rows.states if self.kind == "sqlite" else {}  # no longer locked
        self._known.learn(states, self._numbers)

    def forget_numbers(self) -> None:
        """Some of the results were taken back."""
        self._numbers.clear()

    def _count(self, counter: str, by: int) -> int:
        return int(_NEXT.value(self.driver, (counter, by)))


def _locked(looks: Iterable[Any]) -> dict[str, LockedRobot]:
    return {
        robot: LockedRobot(revision, fence, owner, bool(there))
        for look in looks
        for robot, revision, fence, owner, there in look.fetchall()
    }
