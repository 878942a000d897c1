"""The tables. What they mean is said in records.py; here is how they are kept.

- JSON is text: the store never looks inside, and it is the same text on both databases.
- An atom is the JSON array of its predicate and arguments, so that no parser stands between OBS and the disk.
- Ids of events and audit entries have no gaps and are committed in their order (a database sequence promises
  neither). They come from `counters`, in the transaction that writes them; on SQLite, where one transaction
  writes at a time, those of events from the log itself, and their counter may be behind it.
- A change is one row: a batch, its diagnosis and their two events are one row of `events`. OBS and, on
  SQLite, a robot's revision are behind the log by some batches of each robot; folding.py has the rules.
- Other numbers are the database's own.
- A row of `robot_state` outlives its robot: revisions and fencing numbers never go back.

A change here needs a migration in migrations/versions/ and HEAD set to it; a test compares the two with what
releases left (tests/store/older/).
"""

from __future__ import annotations

import zlib
from typing import Any

from sqlalchemy import (
    BigInteger,
    Boolean,
    Column,
    Float,
    Index,
    Integer,
    LargeBinary,
    MetaData,
    String,
    Table,
    Text,
    TypeDecorator,
    text,
)

HEAD = "2"
"""The schema version that this program reads and writes."""

metadata = MetaData()

_UNSETTLED = text("settled_ns IS NULL")
_OPEN = text("open")
_NOT_DONE = text("NOT done")
_DUE = text("due_ns IS NOT NULL")

_NUMBER = BigInteger().with_variant(Integer(), "sqlite")  # SQLite counts up INTEGER keys only


# Bytewise order on both databases, so that lists and their cursors agree whatever the server's locale is.
_TEXT = Text().with_variant(Text(collation="C"), "postgresql")


class _Hex(TypeDecorator[str]):
    """Bytes, which are their hexadecimal digits to the program and in exports."""

    impl = LargeBinary
    cache_ok = True

    def process_bind_param(self, value: str | None, dialect: Any) -> bytes | None:
        return None if value is None else bytes.fromhex(value)

    def process_result_value(self, value: bytes | None, dialect: Any) -> str | None:
        return None if value is None else value.hex()


def packed(value: str) -> bytes:
    """Return a text as a column keeps it that compresses where it lies."""
    return zlib.compress(value.encode())


class _Packed(TypeDecorator[str]):
    """A text that is compressed where it lies."""

    impl = LargeBinary
    cache_ok = True

    def process_bind_param(self, value: str | None, dialect: Any) -> bytes | None:
        return None if value is None else packed(value)

    def process_result_value(self, value: bytes | None, dialect: Any) -> str | None:
        return None if value is None else zlib.decompress(value).decode()


def _name(column: str, **options: bool) -> Column[str]:
    return Column(column, _TEXT, **options)  # type: ignore[arg-type]  # flags of Column, by name


def _time(column: str, *, nullable: bool = False) -> Column[int]:
    return Column(column, BigInteger, nullable=nullable)


def _numbered(table: str, *parts: Column[Any] | Index) -> Table:
    """A table that the database numbers; a number is not used twice, even after its row was removed."""
    number = Column("number", _NUMBER, primary_key=True, autoincrement=True)
    return Table(table, metadata, number, *parts, sqlite_autoincrement=True)


version = Table("alembic_version", metadata, Column("version_num", String(32), primary_key=True))

counters = Table("counters", metadata, _name("name", primary_key=True), _time("value"))

models = Table(
    "models",
    metadata,
    _name("name", primary_key=True),
    Column("current", Integer, nullable=False),  # the number of the version in use
)

model_versions = Table(
    "model_versions",
    metadata,
    _name("name", primary_key=True),
    Column("number", Integer, primary_key=True, autoincrement=False),
    _name("version", nullable=False),
    _name("format", nullable=False),
    _name("source", nullable=False),
    _time("created_ns"),
    _name("by", nullable=False),
)

robots = Table(
    "robots",
    metadata,
    _name("id", primary_key=True),
    _name("config", nullable=False),
    _name("etag", nullable=False),
    _name("model", index=True),
    _time("created_ns"),
    _time("updated_ns"),
)

robot_state = Table(
    "robot_state",
    metadata,
    _name("robot", primary_key=True),
    _time("revision"),  # on SQLite no newer than `folded`: newer ones are in the log
    _time("folded"),  # the revision up to which `obs` has all batches
    _time("fence"),
    _name("owner", index=True),  # the instance, None when nobody owns it
)

obs = Table(
    "obs",
    metadata,
    _name("robot", primary_key=True),
    _name("atom", primary_key=True),
    Column("positive", Boolean, nullable=False),
    _name("source", nullable=False),
    _time("time_ns"),
    _time("expires_ns", nullable=True),
    _time("since_ns", nullable=True),
    _time("onset_ns", nullable=True),
    _time("settled", nullable=True),
    _name("more"),  # what few entries have: encoding.more_of
    _time("revision"),  # the latest that the row has: batches of older ones do not change it any more
    sqlite_with_rowid=False,
)

assertions = Table(
    "assertions",
    metadata,
    _name("robot", primary_key=True),
    _name("name", primary_key=True),
    _name("sentence", nullable=False),
    _name("source", nullable=False),
    _time("time_ns"),
    _time("expires_ns", nullable=True),
    sqlite_with_rowid=False,
)

results = _numbered(
    "results",
    Column("digest", _Hex(), nullable=False, unique=True),  # of data
    Column("used_day", Integer, nullable=False, index=True),  # the latest of the rows that have its number
    Column("data", _Packed(), nullable=False),
)

events = Table(
    "events",
    metadata,
    Column("id", _NUMBER, primary_key=True, autoincrement=False),  # of the last event that the row is
    _time("time_ns"),
    _name("kind", nullable=False),  # of the event, or `change`: a batch and its diagnosis, two events
    _name("robot"),
    _time("revision", nullable=True),  # of OBS, where it is a batch or a diagnosis
    _name("batch"),  # what was accepted
    _name("data"),  # of a diagnosis, or any other event; with a hole where `common` goes, if there is one
    Column("common", BigInteger),  # a number of `results`
    Index("ix_events_robot", "robot", "kind", "id"),
)

audit = Table(
    "audit",
    metadata,
    Column("id", _NUMBER, primary_key=True, autoincrement=False),
    _time("time_ns"),
    _name("actor", nullable=False),
    _name("action", nullable=False),
    _name("subject", nullable=False),
    _name("robot"),
    _name("reason", nullable=False),
    _name("before"),
    _name("after"),
    Index("ix_audit_robot", "robot", "id"),
)

idempotency = Table(
    "idempotency",
    metadata,
    Column(
        "number", _NUMBER, primary_key=True, autoincrement=True
    ),  # a key that is used again gets a new one
    Column("digest", _Hex(), nullable=False, unique=True),  # of scope and key
    Column("request", _Hex(), nullable=False),  # its digest
    _name("response", nullable=False),
    _time("expires_ns"),
)

repairs = _numbered(
    "repairs",
    _name("id", nullable=False, unique=True),
    _name("robot", nullable=False),
    _name("state", nullable=False),
    Column("open", Boolean, nullable=False),
    _name("data", nullable=False),
    _time("created_ns"),
    _time("updated_ns"),
    Index("ix_repairs_robot", "robot", "number"),
    Index("ix_repairs_open", "robot", postgresql_where=_OPEN, sqlite_where=_OPEN),
)

repair_requests = _numbered(
    "repair_requests",
    _name("repair", nullable=False, index=True),
    _name("robot", nullable=False),
    _name("what", nullable=False),
    _name("by", nullable=False),
    _name("reason", nullable=False),
    _time("time_ns"),
    Column("done", Boolean, nullable=False),
    Index("ix_repair_requests_open", "robot", postgresql_where=_NOT_DONE, sqlite_where=_NOT_DONE),
)

repair_steps = Table(
    "repair_steps",
    metadata,
    _name("repair", primary_key=True),
    Column("step", Integer, primary_key=True, autoincrement=False),
    _name("state", nullable=False),
    _name("data", nullable=False),
    _time("updated_ns"),
)

journal = _numbered(
    "journal",
    _name("id", nullable=False, unique=True),
    _name("repair", nullable=False, index=True),
    Column("step", Integer, nullable=False),
    _name("robot", nullable=False),
    _name("name", nullable=False),
    _name("parameters", nullable=False),
    Column("timeout_s", Float, nullable=False),
    _time("fence"),
    _time("intended_ns"),
    Column("code", BigInteger),
    _name("message", nullable=False),
    _time("settled_ns", nullable=True),
    Index("ix_journal_unsettled", "robot", postgresql_where=_UNSETTLED, sqlite_where=_UNSETTLED),
)

drills = _numbered(
    "drills",
    _name("id", nullable=False, unique=True),
    _name("robot", nullable=False),
    _name("state", nullable=False),
    Column("open", Boolean, nullable=False),
    Column("watched", Boolean, nullable=False),  # the fault is there, for repairs to answer
    _name("asked"),
    _name("data", nullable=False),
    _time("created_ns"),
    _time("updated_ns"),
    Index("ix_drills_robot", "robot", "number"),
    Index("ix_drills_open", "robot", postgresql_where=_OPEN, sqlite_where=_OPEN),
)

tried = _numbered(
    "tried",
    _name("robot", nullable=False),
    _name("bad", nullable=False),
    _name("actions", nullable=False),
    Column("helped", Boolean, nullable=False),
    Column("effect_seen", Boolean, nullable=False),
    _name("repair"),
    _time("time_ns"),
    _name("data", nullable=False),
    Index("ix_tried_robot", "robot", "number"),
)

quarantine = Table(
    "quarantine",
    metadata,
    _name("robot", primary_key=True),
    _name("component", primary_key=True),
    _name("reason", nullable=False),
    Column("failures", Integer, nullable=False),
    _time("since_ns"),
    _time("until_ns", nullable=True),
)

start_ups = Table(
    "start_ups",
    metadata,
    _name("robot", primary_key=True),
    _name("topic", primary_key=True),
    _name("took", nullable=False),
    sqlite_with_rowid=False,
)

attempts = _numbered(
    "attempts",
    _name("robot", nullable=False),
    _name("component", nullable=False),
    _name("repair", nullable=False),
    _time("time_ns"),
    Index("ix_attempts_robot", "robot", "time_ns"),
)

api_keys = _numbered(
    "api_keys",
    _name("id", nullable=False, unique=True),
    _name("name", nullable=False),
    _name("hash", nullable=False, unique=True),
    _name("role", nullable=False),
    _name("robot"),
    _time("created_ns"),
    _name("by", nullable=False),
    _time("revoked_ns", nullable=True),
)

sign_ins = Table(
    "sign_ins",
    metadata,
    _name("hash", primary_key=True),
    _name("key", nullable=False, index=True),
    _time("created_ns"),
    _time("expires_ns"),
)

settings = Table("settings", metadata, _name("name", primary_key=True), _name("value", nullable=False))

notifications = _numbered(
    "notifications",
    _name("recipient", nullable=False),
    _name("key", nullable=False),  # what it tells: once per recipient, for a while
    _name("data", nullable=False),
    _time("created_ns"),
    Column("tries", Integer, nullable=False),
    _time("due_ns", nullable=True),  # None: it is done with
    _name("state", nullable=False),
    _name("answer", nullable=False),
    Index("ix_notifications_key", "key", "recipient"),
    Index("ix_notifications_due", "due_ns", postgresql_where=_DUE, sqlite_where=_DUE),
)

moments = _numbered(
    "moments",
    _name("id", nullable=False, unique=True),
    _name("robot", nullable=False),
    _name("agent", nullable=False),
    _time("at_ns"),  # by the agent's clock
    _name("literals", nullable=False),  # what turned bad, for lists
    Column("complete", Boolean, nullable=False),
    Column("size", BigInteger),  # of the recording, in bytes; None: there is none
    Column("have", BigInteger, nullable=False),  # how much of it has come
    Column("bytes", BigInteger, nullable=False),  # what all of it takes, once it has come
    _time("created_ns"),
    _time("updated_ns"),
    Index("ix_moments_robot", "robot", "number"),
)

moment_pieces = _numbered(
    "moment_pieces",
    Column("moment", BigInteger, nullable=False),  # a number of `moments`; none of that number: to be removed
    Column("at", BigInteger, nullable=False),  # where it begins in the recording; -1: it is the frame, packed
    Column("data", LargeBinary, nullable=False),
    Index("ix_moment_pieces_moment", "moment", "at", unique=True),
)

batch_jobs = _numbered(
    "batch_jobs",
    _name("id", nullable=False, unique=True),
    _name("place", nullable=False),  # whose folder has its files
    _name("state", nullable=False),
    Column("open", Boolean, nullable=False),
    _name("data", nullable=False),
    _time("created_ns"),
    _time("updated_ns"),
    Index("ix_batch_jobs_open", "place", postgresql_where=_OPEN, sqlite_where=_OPEN),
)

agent_actions = _numbered(
    "agent_actions",
    _name("id", nullable=False, unique=True),
    _name("robot", nullable=False),
    _name("host"),
    _name("name", nullable=False),
    _name("parameters", nullable=False),
    Column("timeout_s", Float, nullable=False),
    _time("queued_ns"),
    _time("expires_ns"),
    _name("taken_by"),
    _time("taken_ns", nullable=True),
    Column("answered", Boolean, nullable=False),
    Column("code", BigInteger),
    _name("message", nullable=False),
    _time("settled_ns", nullable=True),
    Index("ix_agent_actions_waiting", "robot", postgresql_where=_UNSETTLED, sqlite_where=_UNSETTLED),
)

instances = Table(
    "instances",
    metadata,
    _name("id", primary_key=True),
    _name("host", nullable=False),
    Column("pid", Integer, nullable=False),
    _time("started_ns"),
    _time("heartbeat_ns"),
)
