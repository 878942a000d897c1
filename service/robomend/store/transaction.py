"""What one change sees of its group's transaction (group.py): a snapshot that it can change.

Rows of the log, of audit and idempotency keys wait in memory, to be written with the group's, one statement a
table. A change that asks the database something has those put there first that need no id, so it sees them;
from then on it is inside a savepoint of its own.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from sqlalchemy import (
    Connection,
    Delete,
    Executable,
    Insert,
    Table,
    Update,
    bindparam,
    exists,
    or_,
    select,
    text,
)

from robomend.errors import Fenced, NotFound, PreconditionFailed, PreconditionRequired
from robomend.store import schema
from robomend.store.encoding import checked, checked_or_none, digest, optional_json
from robomend.store.records import ABSENT, ANY, AuditEntry, Fence, IdempotencyKey, Json
from robomend.store.rows import LockedRobot, Logged, Rows, Values, upsert
from robomend.store.view import AnyRow, View
from robomend_client.events import Kind

if TYPE_CHECKING:
    from robomend.store.group import Group

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


def check_seen(what: str, expected: str | None, current: str | None) -> None:
    """Compare the ETag that the writer of a model or robot has seen, `expected`, with the current one.

    None is "it must not exist yet" in both. ABSENT says the same, as `If-None-Match: *` does; ANY says
    "whichever".

    Raises:
        PreconditionRequired: `expected` is None, and it exists.
        PreconditionFailed: it is at another version, exists in spite of ABSENT, or does not exist.
    """
    if current is None:
        if expected not in (None, ABSENT):
            raise PreconditionFailed(f"{what} does not exist; leave If-Match out to create it")
    elif expected is None:
        raise PreconditionRequired(f"{what} exists; send its ETag as If-Match to replace it")
    elif expected == ABSENT:
        raise PreconditionFailed(f"{what} exists already")
    elif expected not in (ANY, current):
        raise PreconditionFailed(f"{what} is at version {current}, not {expected}; read it again")
