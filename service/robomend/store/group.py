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

from collections.abc import Callable, Collection, Iterable, Sequence
from functools import partial
from typing import Any, TypeVar

from sqlalchemy import Connection, Executable, bindparam, text
from sqlalchemy.dialects import postgresql

from robomend.errors import StateConflict
from robomend.store import folding, results, schema
from robomend.store.driver import DriverConnection
from robomend.store.encoding import checked, digest, from_json, to_json
from robomend.store.known import KnownRows
from robomend.store.prepared import Prepared
from robomend.store.records import IdempotencyKey
from robomend.store.rows import BATCHES, LOG, NEWEST_EVENT, ONCE, LockedRobot, Logged, Rows
from robomend.store.transaction import Transaction
from robomend_client.events import Event

T = TypeVar("T")

Answers = dict[str, tuple[str, str]]
"""Digest of an idempotency key -> digest of the request, answer."""

CHANNEL = "robomend_events"
"""PostgreSQL's notification channel; the payload is the newest id."""

# Made once: building a statement costs several times as much as running it.
_KEEP_ROW = Prepared(lambda _: schema.events.insert(), LOG)
_KEEP_REVISION = Prepared(
    lambda _: (
        schema.robot_state.update()
        .where(schema.robot_state.c.robot == bindparam("of_robot"))
        .values(revision=bindparam("to_revision"))
    ),
    ("of_robot", "to_revision"),
)
_KEEP_AUDIT = schema.audit.insert()
_NEWEST_BATCHES = ", ".join(
    "coalesce((SELECT revision FROM events WHERE events.robot = robot_state.robot"
    f" AND kind = '{kind}' ORDER BY events.id DESC LIMIT 1), 0)"
    for kind in BATCHES
)
_STATES = {
    "sqlite": f"""
        SELECT robot_state.robot, max(revision, {_NEWEST_BATCHES}), fence, owner, robots.id IS NOT NULL
        FROM robot_state LEFT JOIN robots ON robots.id = robot_state.robot
        WHERE robot_state.robot IN ({{keys}}) ORDER BY robot_state.robot
    """,
    # Read again once they are locked, so that what is in the log would be from before.
    "postgresql": """
        SELECT robot_state.robot, revision, fence, owner, robots.id IS NOT NULL
        FROM robot_state LEFT JOIN robots ON robots.id = robot_state.robot
        WHERE robot_state.robot = ANY($1) ORDER BY robot_state.robot FOR UPDATE OF robot_state
    """,
}
_REMOVALS = f"SELECT value FROM counters WHERE name = '{results.REMOVALS}'"
_LOOK_AT_ANSWERS = "SELECT digest, request, response, expires_ns FROM idempotency WHERE digest"
_ANSWERS = {
    "sqlite": f"{_LOOK_AT_ANSWERS} IN ({{keys}})",
    "postgresql": f"{_LOOK_AT_ANSWERS} = ANY($1)",
}


def _answer(kind: str) -> Executable:
    """Return the statement that keeps an answer; a key that is used again, after its time, counts as new."""
    if kind == "sqlite":
        return schema.idempotency.insert().prefix_with("OR REPLACE")
    insert = postgresql.insert(schema.idempotency)
    names = ("number", *ONCE[1:])
    return insert.on_conflict_do_update(
        index_elements=["digest"], set_={name: insert.excluded[name] for name in names}
    )


_KEEP_ANSWER = Prepared(_answer, ONCE)
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
_KEEP_NEXT_ROW = Prepared(
    lambda _: text(
        f"INSERT INTO events ({', '.join(LOG)})"
        f" SELECT value - :id, {', '.join(f':{name}' for name in LOG[1:])} FROM counters WHERE name = 'event'"
    ),
    LOG,
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
        self._last: Callable[[], int] | None = None  # returns the id of its newest event, if it has any
        self._known = known
        self.rows.states, self.answers = self._begin(robots, onces, now_ns // results.DAY_NS)

    @property
    def connection(self) -> Connection:
        """SQLAlchemy's, in the transaction."""
        return self.driver.connection

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

    def _begin(
        self, robots: Collection[str], onces: Sequence[IdempotencyKey], day: int
    ) -> tuple[dict[str, LockedRobot], Answers]:
        """Lock the robots, once it is clear whether what is known still stands, and find what was answered
        already; PostgreSQL is told to begin, and asked for all, at once.
        """
        if self.kind == "sqlite":
            self._known.look(self.driver, day)
            return self.lock(robots), self._answered(self._look_at_answers(onces))
        with self.driver.together():
            removals = self.driver.execute(_REMOVALS)
            looks, answers = self._look_at(robots), self._look_at_answers(onces)
        self._known.is_at(removals.fetchall(), day)
        return _locked(looks), self._answered(answers)

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

    def _look_at_answers(self, onces: Sequence[IdempotencyKey]) -> list[Any]:
        keys = sorted({bytes.fromhex(digest(once.whole)) for once in onces})
        return [
            self.driver.select_in(_ANSWERS, keys[start : start + 500]) for start in range(0, len(keys), 500)
        ]

    def _answered(self, looks: Iterable[Any]) -> Answers:
        return {
            key.hex(): (request.hex(), response)
            for look in looks
            for key, request, response, expires_ns in look.fetchall()
            if expires_ns > self.now_ns
        }

    def flush(self, rows: Rows) -> None:
        """Write the rows that have no id yet to get: all but audit and log."""
        if rows.obs:
            folding.KEEP.run(self.driver, [*rows.obs.values()])
            rows.obs = {}
        if rows.once:
            kept = [(bytes.fromhex(key), bytes.fromhex(row[0]), *row[1:]) for key, row in rows.once.items()]
            _KEEP_ANSWER.run(self.driver, kept)
            rows.once = {}

    def finish(self) -> None:
        """Write what is left, and give the ids. The COMMIT comes next, and then `events`."""
        rows = self.rows
        self.flush(rows)
        if rows.revised and self.kind == "postgresql":
            states = rows.states
            revised = [(robot, states[robot].revision) for robot in sorted(rows.revised)]
            _KEEP_REVISION.run(self.driver, revised)
        if rows.audit:
            last = self._count("audit", len(rows.audit))
            for id_, values in enumerate(rows.audit, last - len(rows.audit) + 1):
                values["id"] = id_
            self.connection.execute(_KEEP_AUDIT, rows.audit)
        if rows.log:
            if rows.common:
                self._give_numbers(rows.common)
            self._keep_log(rows.log)
        elif rows.turn and self.kind == "postgresql":  # on SQLite it is the transaction's own
            self._count("event", 0)
        for robot in sorted(rows.folding):
            folding.bring_up(self.driver, robot, rows.states[robot].revision)

    def _keep_log(self, log: list[Logged]) -> None:
        """Write the rows of the log; each has the id of the last of its events."""
        count, now_ns = sum([len(row.told) for row in log]), self.now_ns
        if self.kind == "postgresql":
            self._last = _NEXT_TOLD.later(self.driver, ("event", count, CHANNEL))
            place, keep, step = count, _KEEP_NEXT_ROW, -1
        else:
            place, keep, step = self._newest(), _KEEP_ROW, 1
            self._last = partial(int, place + count)
        rows = []
        for row in log:
            place += step * len(row.told)
            common = None if row.digest is None else self._number(row.digest)
            rows.append((place, now_ns, row.kind, row.robot, row.revision, row.batch, row.data, common))
        keep.run(self.driver, rows)

    def _number(self, digest: str) -> int:
        """Return the number of a result that is kept."""
        number = self._known.numbers.get(digest)
        return self._numbers[digest] if number is None else number

    def _newest(self) -> int:
        """Return the id of the newest event, on SQLite, where nobody else writes meanwhile."""
        newest = self._known.newest
        return int(self.driver.execute(NEWEST_EVENT).fetchone()[0]) if newest is None else newest

    def events(self) -> tuple[Event, ...]:
        """Return the events of the group, which is finished and committed."""
        if self._last is None:
            return ()
        told = [(kind, row.robot, data) for row in self.rows.log for kind, data in row.told]
        first, now_ns = self._last() - len(told) + 1, self.now_ns
        return tuple([Event(id_, now_ns, *event) for id_, event in enumerate(told, first)])

    def _give_numbers(self, common: dict[str, str]) -> None:
        """Keep the results that are not yet, and learn their numbers."""
        known = self._known.numbers
        new = {d: text for d, text in common.items() if d not in self._numbers and d not in known}
        if new:
            self._numbers.update(results.number(self.driver, new, self.now_ns))

    def otherwise(self) -> None:
        """Something is changed by a statement of its own: what is known may not be so any more."""
        self._known.forget()

    def learned(self) -> None:
        """The transaction was committed."""
        if self.kind == "sqlite":
            self._known.learn(self.rows.states, self._numbers, None if self._last is None else self._last())
        else:  # the robots' rows are no longer locked
            self._known.learn({}, self._numbers, None)

    def _count(self, counter: str, by: int) -> int:
        return int(_NEXT.value(self.driver, (counter, by)))


def _locked(looks: Iterable[Any]) -> dict[str, LockedRobot]:
    return {
        robot: LockedRobot(revision, fence, owner, bool(there))
        for look in looks
        for robot, revision, fence, owner, there in look.fetchall()
    }
