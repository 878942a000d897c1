"""One database transaction for a group of changes (`Group`), and what each sees of it (`Transaction`).

    change ──► rows in memory (log, audit, idempotency keys) ─────────────┐
           ──► anything else: at once, inside a savepoint of its own      │
                                                                          ▼
    group: lock the robots ─► change ─► change ─► … ─► ids ─► all rows, one statement a table ─► COMMIT

The hot path, observations, thus costs no statement of its own: a group of a hundred costs the statements of
one. A change that asks the database something has those rows put there first that need no id, so it sees
them; from then on it is inside a savepoint of its own.

Locks are taken in one order by every instance, so that none waits in a circle: robots by name, then what the
changes touch, then the counters of audit and events. The counters come last because they stop every other
writer until the COMMIT: that is what makes event ids gapless and committed in their order.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from typing import Any, TypeVar

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
from sqlalchemy.dialects import postgresql

from robomend.errors import Fenced, NotFound, PreconditionFailed, PreconditionRequired, StateConflict
from robomend.store import folding, schema
from robomend.store.encoding import checked, checked_or_none, digest, from_json, optional_json, to_json
from robomend.store.records import ABSENT, ANY, AuditEntry, Fence, IdempotencyKey, Json
from robomend.store.rows import (
    LOG,
    NEWEST_EVENT,
    OBS,
    ONCE,
    AnyRow,
    LockedRobot,
    Logged,
    Rows,
    Values,
    View,
    numbers_of,
    upsert,
)
from robomend_client.events import Event, Kind

_WORKED_ON = select(
    or_(
        *(
            exists().where(table.c.robot == bindparam("of_robot"), text(f"{table.name}.open"))
            for table in (schema.repairs, schema.drills)
        )
    )
)


class Transaction(View):
    """A snapshot that can be changed: what one change sees of its group's transaction.

    What is kept in memory until the group's end (`waiting`) is put where statements see it before any runs.
    """

    def __init__(self, group: Group) -> None:
        self._group = group
        self.waiting = Rows()
        """What is written with the group's, one statement a table."""
        self.repeatable = False
        """Whether doing it again is harmless: then the key of the request need not be kept."""
        self._saved = False  # whether the savepoint is there

    @property
    def connection(self) -> Connection:
        return self._group.connection

    @property
    def now_ns(self) -> int:
        """The time that this transaction's records carry."""
        return self._group.now_ns

    def emit(self, kind: Kind, robot: str | None, data: Json) -> None:
        """Append to the event log; the id is given at the commit.

        Not what observations.py and diagnoses.py write, which is more than its event.
        """
        own, digest = self.waiting.kept(data)
        row = Logged(kind, checked_or_none(robot), None, None, own, digest, ((kind, data),))
        self.waiting.log.append(row)

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

    def rows(self, query: Executable, values: Mapping[str, Any] | None = None) -> list[AnyRow]:
        self._put_waiting()
        return super().rows(query, values)

    def of_log(self, query: Executable, values: Mapping[str, Any] | None = None) -> list[AnyRow]:
        raise RuntimeError("the log is written at the end of a group: read it before the change, or after it")

    def change(self, statement: Insert | Update | Delete, values: Mapping[str, Any] | None = None) -> int:
        """Run a statement now and return how many rows it touched."""
        self._put_waiting()
        result = self.connection.execute(statement, dict(values) if values is not None else None)
        return int(result.rowcount)

    def insert(self, table: Table, values: Values) -> int:
        """Insert into a numbered table and return the number."""
        self._put_waiting()
        result = self.connection.execute(table.insert(), values)
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
            self.connection.exec_driver_sql("SAVEPOINT change")
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
        return bool(self.connection.execute(_WORKED_ON, {"of_robot": robot}).scalar_one())

    def bring_up(self, robot: str) -> None:
        """Have the robot's rows of OBS brought up to the log, at the group's end."""
        if self.state(robot) is not None:
            self.waiting.folding.add(robot)

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
        expires_ns = self.now_ns + int(once.ttl_s * 1e9)
        self.waiting.once[digest(once.whole)] = (digest(once.request), response, expires_ns)

    def done(self) -> None:
        """Hand the rows on to the group."""
        if self._saved:
            self.connection.exec_driver_sql("RELEASE SAVEPOINT change")
        for key, (request, response, _) in self.waiting.once.items():
            self._group.answers[key] = (request, response)
        self._group.rows.absorb(self.waiting)

    def undo(self) -> None:
        """Take back what was written at once; the rows in memory go with this object."""
        if self._saved:
            self.connection.exec_driver_sql("ROLLBACK TO SAVEPOINT change")
            self.connection.exec_driver_sql("RELEASE SAVEPOINT change")


def check_seen(what: str, expected: str | None, current: str | None, *, wanted: str | None = None) -> None:
    """Compare the ETag that the writer of a model or robot has seen, `expected`, with the current one.

    None is "it must not exist yet" in both. ABSENT says the same, as `If-None-Match: *` does; ANY says
    "whichever". What is `wanted` already, is so (RFC 9110, 13.1.1): it is asked for again, as the answer of
    the first time got lost.

    Raises:
        PreconditionRequired: `expected` is None, and it exists.
        PreconditionFailed: it is at another version, exists in spite of ABSENT, or does not exist.
    """
    if current is None:
        if expected not in (None, ABSENT):
            raise PreconditionFailed(f"{what} does not exist; leave If-Match out to create it")
    elif expected != ABSENT and current == wanted:
        return
    elif expected is None:
        raise PreconditionRequired(f"{what} exists; send its ETag as If-Match to replace it")
    elif expected == ABSENT:
        raise PreconditionFailed(f"{what} exists already")
    elif expected not in (ANY, current):
        raise PreconditionFailed(f"{what} is at version {current}, not {expected}; read it again")


# --- the group

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
        numbers = numbers_of(self.connection, self.rows.common, self.now_ns)
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
