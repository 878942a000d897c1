"""The store as its callers see it: functions of a snapshot to read, functions of a transaction to write.

    robot = await store.read(lambda db: db.robot("r1"))

    def accept(tx: Transaction) -> int:
        revision = tx.observe("r1", accepted=entries, changed=entries)
        tx.emit(Kind.OBSERVATIONS, "r1", {"revision": revision, "changed": ["not ok(scan)"]})
        return revision

    once = IdempotencyKey("bob POST /robots/r1/observations", key, digest)
    revision = await store.write(accept, robots=("r1",), once=once)

What one function writes is kept together or not at all, its events and audit entries included; when `write`
returns, it is on disk. What different functions write is committed in groups, in the order of the calls; one
that raises takes back its own writes and nobody else's.

Rules for the functions: they run in the store's threads, so they touch neither the event loop nor state that
others change; a write function may be run again when its group has to be repeated, so its only effect is on
`tx`; both are quick, for others wait.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Protocol, TypeVar

from robomend.entry import Entry
from robomend.store.records import (
    ANY,
    AgentAction,
    ApiKey,
    AuditEntry,
    Fence,
    IdempotencyKey,
    Intent,
    Json,
    Pruned,
    Quarantine,
    RepairRequest,
    Retention,
    SignIn,
    Stop,
    StoredAssertion,
    StoredAttempt,
    StoredModel,
    StoredRepair,
    StoredRobot,
    StoreFigures,
)
from robomend.store.view import View
from robomend_client.events import Event, Kind
from robomend_client.literals import Atom

__all__ = ["Ownership", "Store", "Transaction", "View"]

T = TypeVar("T")


class Transaction(View, Protocol):
    """A snapshot that can be changed.

    `expected` is the ETag that the caller has seen: None means "it must not exist yet" (PreconditionRequired
    when it does; ABSENT says the same, and PreconditionFailed then), ANY means "whichever"; another than the
    current one is PreconditionFailed.
    """

    @property
    def now_ns(self) -> int:
        """The time that this transaction's records carry."""
        ...

    def put_model(self, name: str, source: str, *, format: str, by: str, expected: str | None) -> StoredModel:
        """Add a version and make it the current one; the text that it already has adds none."""
        ...

    def delete_model(self, name: str, *, expected: str | None = ANY) -> None:
        """Delete a model with all versions. Conflict while a robot follows it."""
        ...

    def put_robot(self, robot: str, config: Json, *, expected: str | None) -> StoredRobot:
        """Create or replace a robot. NotFound if its model does not exist."""
        ...

    def delete_robot(self, robot: str, *, expected: str | None = ANY) -> None:
        """Delete a robot with its OBS, quarantine, memory and queued actions.
        Conflict while a repair is open.

        Its history stays as long as the retention says, and its revision and fencing number go on where they
        were if it is created again.
        """
        ...

    def observe(
        self,
        robot: str,
        *,
        accepted: Sequence[Entry] = (),
        changed: Sequence[Entry] = (),
        forgotten: Sequence[Atom] = (),
        asserted: Sequence[StoredAssertion] = (),
        withdrawn: Sequence[str] = (),
        expected: int | None = None,
    ) -> int:
        """Keep one batch and return the robot's new revision, one higher than before.

        `accepted` goes into the history; `changed` and `forgotten` are what OBS ⊕ accepted changes in OBS
        (the store knows nothing of ⊕); `asserted` and `withdrawn` are named assertions.

        Raises:
            NotFound: no such robot.
            Conflict: `expected` is given and is not the revision before (code "stale-revision"): another
                instance was faster; load OBS again.
        """
        ...

    def record_diagnosis(self, robot: str, revision: int, result: Json, *, model_version: str = "") -> None:
        """Keep a diagnosis that differs from the one before."""
        ...

    def emit(self, kind: Kind, robot: str | None, data: Json) -> None:
        """Append to the event log; the id is given at the commit."""
        ...

    def note(self, entry: AuditEntry) -> None:
        """Append to the audit log; id and time are filled in."""
        ...

    # --- repairs. A write with an old fence raises Fenced: another instance has taken over; let go at once.

    def create_repair(
        self, robot: str, *, state: str, data: Json, open: bool = True, fence: Fence | None = None
    ) -> StoredRepair:
        """Begin a repair. Without a fence it only waits: its owner takes it up."""
        ...

    def update_repair(
        self, repair: str, *, state: str, data: Json, open: bool, fence: Fence
    ) -> StoredRepair: ...

    def ask(self, repair: str, what: str, *, by: str, reason: str) -> RepairRequest:
        """Leave a request for the owner of an open repair. Conflict if it has ended."""
        ...

    def answer(self, request: int, *, fence: Fence) -> None:
        """Mark a request as done."""
        ...

    def put_step(self, repair: str, step: int, *, state: str, data: Json, fence: Fence) -> None:
        """Note how far a step came."""
        ...

    def intend(
        self,
        repair: str,
        step: int,
        *,
        action: str,
        name: str,
        parameters: Sequence[str],
        timeout_s: float,
        fence: Fence,
    ) -> Intent:
        """Journal that an action will be sent. Conflict if the action id was used before."""
        ...

    def settle(self, action: str, code: int, message: str = "", *, fence: Fence) -> Intent:
        """Journal an outcome. A second one changes nothing and returns the first."""
        ...

    def remember(self, tried: StoredAttempt, *, fence: Fence) -> None:
        """Keep what an attempt came to."""
        ...

    def forget_tried(self, robot: str, component: str | None = None) -> int:
        """Forget the attempts of a robot, or those that blamed one component,
        as after it was exchanged; return how many.
        """
        ...

    def put_quarantine(self, entry: Quarantine, *, fence: Fence) -> None: ...

    def release_quarantine(self, robot: str, component: str) -> Quarantine:
        """Let the component be tried again; NotFound if it is not in quarantine.
        A person's word: needs no fence.
        """
        ...

    def count_attempt(self, robot: str, component: str, repair: str, *, fence: Fence) -> None:
        """Count an attempt to repair a component, for the limit per hour."""
        ...

    # --- agents, keys, stop

    def queue_action(
        self,
        action: str,
        robot: str,
        *,
        host: str | None,
        name: str,
        parameters: Sequence[str],
        timeout_s: float,
    ) -> AgentAction:
        """Queue an action for an agent. One with this id that is there already is returned as it is."""
        ...

    def take_action(self, robot: str, *, host: str | None, agent: str) -> AgentAction | None:
        """Hand out the oldest action of the robot that has no answer and is for this host, or for any.

        It is handed out again, to the agent that has it, until its first feedback or result: an answer lost
        on the way loses no action.
        """
        ...

    def answer_action(self, action: str) -> AgentAction:
        """Note the agent's first sign (feedback). Conflict after the result."""
        ...

    def finish_action(self, action: str, code: int, message: str) -> AgentAction:
        """Keep the result; a second one changes nothing and returns the first."""
        ...

    def withdraw_action(self, action: str, code: int, message: str) -> AgentAction:
        """Give an action that no agent has answered this result, so that it is not handed out any more."""
        ...

    def add_key(self, *, name: str, hash: str, role: str, robot: str | None, by: str) -> ApiKey:
        """Keep a key. Conflict if an unrevoked one has the name."""
        ...

    def revoke_key(self, key: str) -> ApiKey:
        """Revoke a key by its id, for good."""
        ...

    def add_sign_in(self, hash: str, key: str, *, expires_ns: int, most: int) -> SignIn:
        """Keep a browser's sign-in with the key of this id, and forget those whose time is over.

        Beyond `most` of one key, the oldest is forgotten. NotFound if the key is revoked.
        """
        ...

    def end_sign_in(self, hash: str) -> None:
        """Forget a sign-in, if there is one."""
        ...

    def set_stop(self, active: bool, *, by: str, reason: str) -> Stop: ...


class Ownership(Protocol):
    """One owner per robot at a time; see robomend.store.ownership for how.

    All methods belong to the event loop that started the store.
    """

    @property
    def instance(self) -> str:
        """The name of this instance, a new one at every start."""
        ...

    @property
    def held(self) -> Mapping[str, Fence]:
        """The robots owned now."""
        ...

    async def acquire(self, robot: str) -> Fence | None:
        """Own the robot, with a higher fencing number than ever before; None while a live instance has it.

        Owning it already gives the same fence again. NotFound if there is no such robot.
        """
        ...

    async def release(self, robot: str) -> None:
        """Let the robot go; nothing happens if it is not ours."""
        ...

    async def orphans(self) -> tuple[str, ...]:
        """Return the robots whose last owner is dead or that nobody owns,
        to be acquired: ask every second or so.
        """
        ...

    def on_lost(self, callback: Callable[[Fence], None]) -> Callable[[], None]:
        """Call back, in the event loop, for each robot lost because the database dropped our lock.

        Until then our fence may already be refused; nothing may be sent for the robot after it. Returns a
        function that ends it.
        """
        ...


class Store(Protocol):
    """Durable memory. `start` and `close` belong to one event loop;
    `read` and `write` may come from any of it.

    Errors of every method: StoreError (the database is gone or refuses; it is tried again by the next call),
    StoreFull (writes only), StoreOverloaded (too much is queued).
    """

    @property
    def url(self) -> str:
        """Where it is, without a password."""
        ...

    @property
    def ownership(self) -> Ownership: ...

    async def start(self) -> None:
        """Open the database, create or migrate its schema, start the threads."""
        ...

    async def close(self) -> None:
        """Finish what is queued, release all robots and end the threads."""
        ...

    async def read(self, query: Callable[[View], T]) -> T:
        """Return what `query` finds in one snapshot,
        in which everything is that was written before the call.
        """
        ...

    async def write(
        self,
        change: Callable[[Transaction], T],
        *,
        robots: Iterable[str] = (),
        once: IdempotencyKey | None = None,
    ) -> T:
        """Run `change` in a transaction and return its result when that is on disk.

        `robots` names the robots whose observations or repairs it writes: they are locked first, in one
        order, so that instances do not wait for each other in a circle.

        With `once`, the result must be a JSON value; a repeat returns the first result without running
        `change`, and Conflict (code "idempotency-key-reused") if the request differs.

        Being cancelled does not take back a write that is queued.
        """
        ...

    def subscribe(self, callback: Callable[[tuple[Event, ...]], None]) -> Callable[[], None]:
        """Call back, in the event loop, with every event committed
        from now on by any instance, in order of id.

        None is left out and none comes twice, also when the database was away. Returns a function that ends
        it.
        """
        ...

    async def prune(self, retention: Retention, *, slice: int = 1000) -> Pruned:
        """Remove what is older than the retention, in slices of so many records,
        between which others can write.
        """
        ...

    async def backup(self, path: Path) -> None:
        """Write a consistent copy of a SQLite database while it is in use.
        OptionRefused on PostgreSQL: use pg_dump.
        """
        ...

    def export(self) -> Iterator[str]:
        """Yield one snapshot of everything as NDJSON lines. Blocking: for commands."""
        ...

    def load(self, lines: Iterable[str]) -> int:
        """Take in an export, whole or not at all; Conflict unless the store is empty.
        Blocking. Returns the records.
        """
        ...

    def figures(self) -> StoreFigures: ...
