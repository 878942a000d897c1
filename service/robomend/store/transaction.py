"""One database transaction for a group of changes, and the transaction that each change sees.

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

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from functools import cache
from typing import Any, NamedTuple, TypeVar

from sqlalchemy import (
    Connection,
    Delete,
    Executable,
    Insert,
    Select,
    Table,
    Update,
    bindparam,
    exists,
    or_,
    select,
    text,
)
from sqlalchemy.dialects import postgresql, sqlite

from robomend.errors import Fenced, NotFound, StateConflict
from robomend.store import results, schema
from robomend.store.encoding import Encoded, checked, checked_or_none, from_json, optional_json, to_json
from robomend.store.prepared import Prepared, select_in
from robomend.store.records import AuditEntry, Fence, IdempotencyKey, Json
from robomend.store.view import AnyRow, View
from robomend_client.events import Event, Kind

T = TypeVar("T")
Values = dict[str, Any]

CHANNEL = "robomend_events"
"""PostgreSQL's notification channel; the payload is the newest id."""


class LockedRobot(NamedTuple):
    """The locked row of a robot."""

    revision: int
    fence: int
    owner: str | None
    exists: bool


@dataclass(slots=True)
class Rows:
    """Rows that wait in memory, and what is known of the locked robots."""

    states: dict[str, LockedRobot] = field(default_factory=dict)
    revised: set[str] = field(default_factory=set)
    history: list[Values] = field(default_factory=list)
    obs: dict[tuple[str, str], Values | None] = field(default_factory=dict)  # None: forgotten
    once: dict[tuple[str, str], Values] = field(default_factory=dict)
    diagnoses: list[Values] = field(default_factory=list)
    audit: list[Values] = field(default_factory=list)
    events: list[tuple[Kind, str | None, Json, Values]] = field(default_factory=list)
    common: dict[str, str] = field(default_factory=dict)  # digest -> text, of what the rows above have
    turn: bool = False  # somebody asks only whether there is a turn to write

    def absorb(self, other: Rows) -> None:
        """Take over the rows of a change that went well."""
        self.states.update(other.states)
        self.revised |= other.revised
        self.history += other.history
        self.obs.update(other.obs)
        self.once.update(other.once)
        self.diagnoses += other.diagnoses
        self.audit += other.audit
        self.events += other.events
        self.common.update(other.common)
        self.turn |= other.turn

    def kept(self, column: str, data: Json) -> Values:
        """Return the columns that keep a value; in place of its result's number stands the digest yet."""
        if type(data) is Encoded and data.common is not None:
            self.common[data.common.digest] = data.common.text
            return {column: data.own, "common": data.common.digest}
        return {column: to_json(data), "common": None}


@cache
def upsert(kind: str, table: Table) -> Insert:
    """Return the statement that inserts a row or replaces the one with its primary key."""
    keys = [column.name for column in table.primary_key]
    others = [column.name for column in table.columns if column.name not in keys]
    if kind == "sqlite":
        into_sqlite = sqlite.insert(table)
        return into_sqlite.on_conflict_do_update(keys, set_={n: into_sqlite.excluded[n] for n in others})
    into_postgres = postgresql.insert(table)
    replaced = {name: into_postgres.excluded[name] for name in others}
    return into_postgres.on_conflict_do_update(index_elements=keys, set_=replaced)


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
_WORKED_ON = Prepared(
    lambda _: select(
        or_(
            *(
                exists().where(table.c.robot == bindparam("of_robot"), text(f"{table.name}.open"))
                for table in (schema.repairs, schema.drills)
            )
        )
    )
)
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


class Transaction(View):
    """A snapshot that can be changed: what one change sees of its group's transaction.

    What is kept in memory until the group's end (`waiting`) is put where statements see it before any runs.
    """

    def __init__(self, group: Group) -> None:
        super().__init__(group.connection)
        self._group = group
        self.waiting = Rows()
        """Observations, diagnoses, events and the like: written with the group's, one statement a table."""
        self.repeatable = False
        """Whether doing it again is harmless: then the key of the request need not be kept."""
        self._saved = False  # whether the savepoint is there

    @property
    def now_ns(self) -> int:
        """The time that this transaction's records carry."""
        return self._group.now_ns

    def emit(self, kind: Kind, robot: str | None, data: Json) -> None:
        """Append to the event log; the id is given at the commit."""
        self.waiting.events.append((kind, checked_or_none(robot), data, self.waiting.kept("data", data)))

    def note(self, entry: AuditEntry) -> None:
        """Append to the audit log; id and time are filled in."""
        self.waiting.audit.append(
            {
                "time_ns": self.now_ns,
                "actor": checked(entry.actor),
                "action": checked(entry.action),
                "subject": checked(entry.subject),
                "robot": checked_or_none(entry.robot),
                "reason": checked(entry.reason),
                "before": optional_json(entry.before),
                "after": optional_json(entry.after),
            }
        )

    def wait_turn(self) -> None:
        """Write nothing, but wait for the lock that every writer of every instance waits for."""
        self.waiting.turn = True

    # --- statements

    def rows(self, query: Select[Any]) -> list[AnyRow]:
        self._put_waiting()
        return super().rows(query)

    def change(self, statement: Insert | Update | Delete, values: Mapping[str, Any] | None = None) -> int:
        """Run a statement now and return how many rows it touched."""
        self._put_waiting()
        result = self._connection.execute(statement, dict(values) if values is not None else None)
        return int(result.rowcount)

    def insert(self, table: Table, values: Values) -> int:
        """Insert into a numbered table and return the number."""
        self._put_waiting()
        result = self._connection.execute(table.insert(), values)
        key = result.inserted_primary_key
        assert key is not None
        return int(key[0])

    def replace(self, table: Table, values: Values) -> None:
        """Insert a row, or replace the one with its primary key."""
        self.change(upsert(self._group.kind, table), values)

    def _put_waiting(self) -> None:
        """Put all rows where a statement sees them, and a savepoint before those of this change."""
        if not self._saved:
            self._group.flush(self._group.rows)
            self._connection.exec_driver_sql("SAVEPOINT change")
            self._saved = True
        self._group.flush(self.waiting)

    # --- the robots' rows, which are locked while something is written about them

    def state(self, robot: str) -> LockedRobot | None:
        """Lock the robot's row, unless it is, and return it; None if the robot was never there."""
        state = self.waiting.states.get(robot) or self._group.rows.states.get(robot)
        if state is None:
            self._put_waiting()
            state = self._group.lock([robot]).get(robot)
            if state is not None:
                self.waiting.states[robot] = state
        return state

    def existing(self, robot: str) -> LockedRobot:
        """Lock the row of a robot that must be there, and return it."""
        state = self.state(robot)
        if state is None or not state.exists:
            raise NotFound(f"there is no robot {robot!r}")
        return state

    def worked_on(self, robot: str) -> bool:
        """Return whether a repair or a drill of the robot is open."""
        return bool(_WORKED_ON.value(self._connection, {"of_robot": robot}))

    def now_is(self, robot: str, state: LockedRobot) -> None:
        """Tell those who come after, in this transaction, what the robot's row has become."""
        self.waiting.states[robot] = state

    def check_fence(self, robot: str, fence: Fence) -> None:
        """Lock the robot's row and compare; Fenced if another instance has taken over."""
        if fence.robot != robot:
            raise Fenced(f"the fence of {fence.robot!r} gives no right to write about {robot!r}")
        latest = self.existing(robot).fence
        if fence.number != latest:
            raise Fenced(
                f"{robot!r} was taken over by another instance (fence {latest}, yours is {fence.number})"
            )

    # --- for the group

    def answer_once(self, once: IdempotencyKey, response: str) -> None:
        """Keep the answer of an idempotent change beside its effect."""
        self.waiting.once[once.scope, once.key] = {
            "scope": checked(once.scope),
            "key": checked(once.key),
            "request": checked(once.request),
            "response": response,
            "expires_ns": self.now_ns + int(once.ttl_s * 1e9),
        }

    def done(self) -> None:
        """Hand the rows on to the group."""
        if self._saved:
            self._connection.exec_driver_sql("RELEASE SAVEPOINT change")
        for key, values in self.waiting.once.items():
            self._group.answers[key] = (values["request"], values["response"])
        self._group.rows.absorb(self.waiting)

    def undo(self) -> None:
        """Take back what was written at once; the rows in memory go with this object."""
        if self._saved:
            self._group.forget_numbers()
            self._connection.exec_driver_sql("ROLLBACK TO SAVEPOINT change")
            self._connection.exec_driver_sql("RELEASE SAVEPOINT change")
