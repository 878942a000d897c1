"""What the store keeps, as frozen values: its callers never see a row, a column or a JSON text.

Times are integer nanoseconds since the epoch by the clock of the service. They are kept for people and for
retention; nothing is ever ordered by them, since clocks jump. Order comes from revisions, ids and numbers.

To keep another kind of thing: a record here, a table in schema.py with a migration, and a module of functions
that read and write it.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Generic, TypeVar

from robomend.entry import Entry

T = TypeVar("T")

Json = Mapping[str, Any]
"""A JSON object: strings, numbers, booleans, None, lists and objects of them."""

ANY = "*"
"""As an expected ETag: whatever the current version is, as `If-Match: *`."""

ABSENT = " absent"
"""As an expected ETag: it must not exist yet, as `If-None-Match: *`. No ETag has a space."""


@dataclass(frozen=True, slots=True)
class StoredStart:
    """One start of a node: how long until a topic of it was heard, in nanoseconds."""

    took_ns: int  # since the node began to run
    own_ns: int  # of it since the last of its inputs was there; all of it where nobody knows
    held_up: bool  # whether something that came later may have held it up
    powered: bool = False  # … which may have been a device that had just got its power


@dataclass(frozen=True, slots=True)
class Page(Generic[T]):
    """One page of a list; `next` asks for the following one and is None on the last."""

    items: tuple[T, ...]
    next: str | None


@dataclass(frozen=True, slots=True)
class Paging:
    """Which page is wanted. A cursor is opaque: it comes from `Page.next` of the same list."""

    cursor: str | None = None
    limit: int = 100  # 1 to 1000
    since_ns: int | None = None  # of lists over time: only what is not older …
    until_ns: int | None = None  # … and older than this


FIRST_PAGE = Paging()


@dataclass(frozen=True, slots=True)
class StoredModel:
    """One version of a model, as it was written."""

    name: str
    version: str  # a hash of format and source: the ETag
    number: int  # 1, 2, … within the name; a model put back to an older text gets a new number
    format: str  # "component", "five-key" or "bench"
    source: str
    created_ns: int
    by: str


@dataclass(frozen=True, slots=True)
class StoredRobot:
    """A robot's configuration. `config` is the object that HTTP puts and gets;
    the store reads its "model" only.
    """

    id: str
    config: Json
    etag: str
    created_ns: int
    updated_ns: int

    @property
    def model(self) -> str | None:
        """The model that the robot follows."""
        model = self.config.get("model")
        return model if isinstance(model, str) else None


@dataclass(frozen=True, slots=True)
class StoredAssertion:
    """A named sentence, kept until it is withdrawn."""

    name: str
    sentence: str
    source: str
    time_ns: int
    expires_ns: int | None = None


@dataclass(frozen=True, slots=True)
class StoredObs:
    """OBS of one robot as it stood at one revision."""

    revision: int  # 0: nothing was ever accepted
    entries: tuple[Entry, ...] = ()  # in the order of their atoms
    assertions: tuple[StoredAssertion, ...] = ()  # in the order of their names


@dataclass(frozen=True, slots=True)
class StoredBatch:
    """One accepted batch of the history: what was sent, whether or not it changed OBS."""

    robot: str
    revision: int
    time_ns: int  # when it was accepted
    entries: tuple[Entry, ...]
    asserted: tuple[StoredAssertion, ...] = ()
    withdrawn: tuple[str, ...] = ()  # names of assertions
    by: str = ""  # the name of the key that reported it; empty: nobody noted it


@dataclass(frozen=True, slots=True)
class StoredDiagnosis:
    """A diagnosis that differs from the one before it."""

    robot: str
    revision: int  # of OBS, from which it was made
    model_version: str
    time_ns: int
    result: Json


@dataclass(frozen=True, slots=True)
class EventRange:
    """The events that are kept: all ids from `oldest` to `newest`. None kept: oldest is newest + 1."""

    oldest: int
    newest: int


@dataclass(frozen=True, slots=True)
class Fence:
    """Proof of owning a robot. Every write about its repairs carries it;
    an older one than the latest is refused.
    """

    robot: str
    number: int


@dataclass(frozen=True, slots=True)
class Instance:
    """A service process that uses this database. Information for people: ownership does not rest on it."""

    id: str
    host: str
    pid: int
    started_ns: int
    heartbeat_ns: int


@dataclass(frozen=True, slots=True)
class StoredRepair:
    """A repair. The execution decides the states and the rest of `data`;
    the store needs to know which are open.
    """

    id: str  # short and never used twice, e.g. "r-7k2m9x4q"
    number: int  # order of creation
    robot: str
    state: str
    open: bool  # it may still act: what a restart takes up again
    data: Json  # diagnosis, plan, reason, by, round, …
    created_ns: int
    updated_ns: int


@dataclass(frozen=True, slots=True)
class RepairRequest:
    """What somebody asks of a repair that another instance may own:
    "approve" or "cancel". The owner carries it out.
    """

    number: int
    repair: str
    robot: str
    what: str
    by: str
    reason: str
    time_ns: int
    done: bool = False


@dataclass(frozen=True, slots=True)
class DrillRequest:
    """What somebody asks of a drill: "cancel", "done" or "abandon". Its owner carries it out."""

    what: str
    by: str
    reason: str
    time_ns: int


@dataclass(frozen=True, slots=True)
class StoredDrill:
    """A drill: one planted fault, and its undo. The store needs to know which are open."""

    id: str  # e.g. "d-7k2m9x4q"
    number: int  # order of creation
    robot: str
    state: str
    open: bool  # something of it may still have to be undone: what a restart takes up again
    watched: bool  # the fault is there, for repairs to answer; else a drill that is open keeps them away
    asked: DrillRequest | None
    data: Json  # fault, component, undo, by, reason, what was seen, …
    created_ns: int
    updated_ns: int


@dataclass(frozen=True, slots=True)
class StoredBatchJob:
    """Logs that are diagnosed behind HTTP. Their files are in a folder that has a name of its own, its place:
    whoever works with that folder carries the job out.
    """

    id: str  # e.g. "b-7k2m9x4q"
    number: int  # order of creation
    place: str
    state: str
    open: bool  # something is still to be done: what a restart takes up again
    data: Json  # model, logs, options, by, how far it is, …
    created_ns: int
    updated_ns: int


@dataclass(frozen=True, slots=True)
class StoredMoment:
    """What an agent kept of the moment in which something turned bad; its frame and recording are apart."""

    id: str  # e.g. "m-4f1d6a…", the same for what the same agent sends again
    number: int  # order of arrival
    robot: str
    agent: str
    at_ns: int  # by the agent's clock
    literals: tuple[Json, ...]  # what turned bad, with its reading
    complete: bool  # nothing will be added to the frame any more
    size: int | None  # of the recording in bytes; None: there is none
    have: int  # how much of it has come
    bytes: int  # what all of it takes
    created_ns: int
    updated_ns: int


@dataclass(frozen=True, slots=True)
class MomentBounds:
    """How many moments are kept of one robot, and how many bytes of all."""

    of_robot: int
    bytes: int


@dataclass(frozen=True, slots=True)
class StepRecord:
    """How far a step of a repair came; `data` is the execution's report."""

    repair: str
    step: int
    state: str
    data: Json
    updated_ns: int


@dataclass(frozen=True, slots=True)
class Intent:
    """An entry of the action journal: written before the action is sent, completed when its outcome is known.

    `code` None: the outcome is not known. After a crash that means nobody knows whether it acted.
    """

    id: str  # the action id, `repair:step`
    repair: str
    step: int
    robot: str
    name: str
    parameters: tuple[str, ...]
    timeout_s: float
    fence: int
    intended_ns: int
    code: int | None = None
    message: str = ""
    settled_ns: int | None = None


@dataclass(frozen=True, slots=True)
class StoredAttempt:
    """The memory of one repair attempt: which diagnosis was repaired how, and what came of it."""

    robot: str
    bad: tuple[str, ...]  # the diagnosis that was repaired
    actions: tuple[str, ...]  # as text, `power_up(jaguar)`
    helped: bool
    effect_seen: bool
    repair: str | None
    time_ns: int
    data: Json = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class Quarantine:
    """A component that is not tried again until a time, or until a person releases it (until_ns None)."""

    robot: str
    component: str
    reason: str
    failures: int
    since_ns: int
    until_ns: int | None

    def over(self, now_ns: int) -> bool:
        """Return whether its time is over."""
        return self.until_ns is not None and self.until_ns <= now_ns


@dataclass(frozen=True, slots=True)
class AuditEntry:
    """Who did what to what and why, with what it was before and after. `id` is 0 until it is kept."""

    actor: str  # the key's name, "robomend" for the loop itself
    action: str  # e.g. "robot.put", "repair.approve", "action.sent"
    subject: str  # what it was done to
    robot: str | None = None
    reason: str = ""
    before: Json | None = None
    after: Json | None = None
    time_ns: int = 0
    id: int = 0


@dataclass(frozen=True, slots=True)
class StoredNotification:
    """Something that one recipient is told. `due_ns` is None when it has arrived or was given up."""

    number: int
    recipient: str  # a name of the settings
    data: Json
    created_ns: int
    tries: int
    due_ns: int | None
    state: str  # "waiting", "delivered", "given-up"
    answer: str  # of the last try


@dataclass(frozen=True, slots=True)
class Newest:
    """The versions of all that a robot's diagnosis rests on."""

    revision: int  # of OBS
    etag: str  # of the configuration
    model_version: str | None


@dataclass(frozen=True, slots=True)
class ApiKey:
    """A bearer key, of which only the hash is kept."""

    id: str
    name: str
    hash: str
    role: str  # viewer, robot, operator or admin
    robot: str | None
    created_ns: int
    by: str
    revoked_ns: int | None = None


@dataclass(frozen=True, slots=True)
class SignIn:
    """A browser that a key let in; of its cookie only the hash is kept."""

    hash: str
    key: ApiKey
    created_ns: int
    expires_ns: int


@dataclass(frozen=True, slots=True)
class Stop:
    """The global stop."""

    active: bool = False
    by: str | None = None
    reason: str = ""
    since_ns: int | None = None
    revision: int = 0  # one more at each change, whoever makes it


@dataclass(frozen=True, slots=True)
class AgentAction:
    """An action that waits for a robot's agent, is with it, or has its result."""

    id: str  # the action id, `repair:step`
    robot: str
    host: str | None  # which of the robot's agents; None: any
    name: str
    parameters: tuple[str, ...]
    timeout_s: float
    queued_ns: int
    expires_ns: int  # not handed out after this
    taken_by: str | None = None
    taken_ns: int | None = None
    answered: bool = False  # the agent has said something: it is not handed out again
    code: int | None = None
    message: str = ""
    settled_ns: int | None = None


@dataclass(frozen=True, slots=True)
class IdempotencyKey:
    """An idempotency key: the effect happens at most once, and a repeat gets the first answer.

    `request` is a hash of the whole request; the same key with another request is a StateConflict.
    """

    scope: str  # who and where, e.g. "key-name POST /robots/r1/observations"
    key: str
    request: str
    ttl_s: float = 86400.0

    @property
    def whole(self) -> str:
        """Scope and key, as one text that no other scope and key have."""
        return f"{len(self.scope)} {self.scope}{self.key}"


@dataclass(frozen=True, slots=True)
class Retention:
    """How long what is kept, in days; None keeps for ever. What is current is always kept."""

    observations_days: float | None = 30.0
    diagnoses_days: float | None = 30.0
    events_days: float | None = 7.0
    repairs_days: float | None = 365.0
    tried_days: float | None = 30.0
    audit_days: float | None = None
    moments_days: float | None = 30.0


@dataclass(frozen=True, slots=True)
class Pruned:
    """How many records a pruning removed."""

    observations: int = 0  # batches, and those of changes
    diagnoses: int = 0  # on their own; that of a change goes with its batch
    results: int = 0
    events: int = 0  # others
    repairs: int = 0
    tried: int = 0
    audit: int = 0
    idempotency: int = 0
    agent_actions: int = 0
    notifications: int = 0
    drills: int = 0
    moments: int = 0  # and pieces of recordings


@dataclass(frozen=True, slots=True)
class StoreFigures:
    """For metrics and readiness."""

    queued_writes: int
    oldest_write_s: float  # how long the oldest that is not on disk has waited, in a group that hangs too
    commits: int
    writes: int
    last_commit_s: float  # how long the last transaction took, with its fsync
