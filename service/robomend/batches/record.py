"""The states of a batch, how each comes from the one before, and what is written of it. Each write has its
event, and changes of state an audit entry: who asked for it, who cancelled it, what became of it.

docs/batch.md draws the table.
"""

from __future__ import annotations

from collections.abc import Mapping
from enum import StrEnum
from functools import partial
from typing import Any

from robomend.store import Store, Transaction, batch_jobs
from robomend.store.records import AuditEntry, Json, StoredBatchJob
from robomend.transitions import after
from robomend_client.events import Kind


class BatchState(StrEnum):
    """What a batch is in."""

    WAITING = "waiting"  # until one of those that run has ended
    RUNNING = "running"
    DONE = "done"  # there are results; of bad logs they say what is wrong
    FAILED = "failed"  # there are none, or not of all logs
    CANCELLED = "cancelled"


OPEN = (BatchState.WAITING, BatchState.RUNNING)
ENDS = frozenset({BatchState.DONE, BatchState.FAILED, BatchState.CANCELLED})


class BatchTrigger(StrEnum):
    """What happens to a batch."""

    STARTED = "its program is started"
    INTERRUPTED = (
        "its program ended with the service, was killed, or let others go first; the same command goes on"
    )
    FINISHED = "its program has written the results"
    BROKEN = "its program failed, or was killed time and again, or ran too long"
    CANCELLED = "a person cancelled it"


INITIAL = BatchState.WAITING

BATCH: dict[tuple[BatchState, BatchTrigger], BatchState] = {
    (BatchState.WAITING, BatchTrigger.STARTED): BatchState.RUNNING,
    (BatchState.WAITING, BatchTrigger.BROKEN): BatchState.FAILED,
    (BatchState.WAITING, BatchTrigger.CANCELLED): BatchState.CANCELLED,
    (BatchState.RUNNING, BatchTrigger.INTERRUPTED): BatchState.RUNNING,
    (BatchState.RUNNING, BatchTrigger.STARTED): BatchState.RUNNING,
    (BatchState.RUNNING, BatchTrigger.FINISHED): BatchState.DONE,
    (BatchState.RUNNING, BatchTrigger.BROKEN): BatchState.FAILED,
    (BatchState.RUNNING, BatchTrigger.CANCELLED): BatchState.CANCELLED,
}


LOOP = "robomend"

SHOWN = (
    "model", "logs", "bytes", "uploaded", "options", "host", "by", "reason", "done", "log_states", "faulty",
    "message",
)  # fmt: skip


def batch_json(job: StoredBatchJob) -> dict[str, Any]:
    """Return a batch as HTTP shows it."""
    return {
        "id": job.id,
        "state": job.state,
        **{name: job.data[name] for name in SHOWN},
        "created_ns": job.created_ns,
        "updated_ns": job.updated_ns,
        "started_ns": job.data["started_ns"],
        "finished_ns": None if job.open else job.updated_ns,
    }


def new_batch(tx: Transaction, job: str, *, place: str, data: Mapping[str, Any], most: int) -> StoredBatchJob:
    """Write a new batch. `data`: who asked for what; the rest is as at the beginning."""
    begun = {
        "done": 0,
        "log_states": {},
        "faulty": 0,
        "message": "",
        "started_ns": None,
        "deaths": 0,
        "ran_s": 0.0,
        "turns": 0,  # after which it let others go first
    }
    made = batch_jobs.create(tx, job, place=place, state=INITIAL, data={**begun, **data}, most=most)
    _tell(tx, made)
    about = {"model": data["model"], "logs": data["logs"], "bytes": data["bytes"]}
    tx.note(AuditEntry(data["by"], "batch.create", job, None, data["reason"], after=about))
    return made


def change(
    tx: Transaction, job: str, trigger: BatchTrigger, *, by: str = LOOP, reason: str = "", **data: Any
) -> StoredBatchJob:
    """Take a batch to its next state; StateConflict if it has ended."""
    before = batch_jobs.get(tx, job)
    if BatchState(before.state) in ENDS:
        return batch_jobs.update(tx, job, state=before.state, open=False, data=before.data)  # says so
    state = after(BATCH, BatchState(before.state), trigger)
    changed = batch_jobs.update(tx, job, state=state, open=state not in ENDS, data={**before.data, **data})
    _tell(tx, changed)
    told = {key: value for key, value in data.items() if key in {"message", "log_states"} and value}
    tx.note(AuditEntry(by, f"batch.{_WORDS[trigger]}", job, None, reason, after=told or None))
    return changed


def progress(tx: Transaction, job: str, data: Json) -> StoredBatchJob:
    """Note how far an open batch is; StateConflict if it has ended."""
    before = batch_jobs.get(tx, job)
    changed = batch_jobs.update(tx, job, state=before.state, open=True, data={**before.data, **data})
    if {key: before.data[key] for key in SHOWN} != {key: changed.data[key] for key in SHOWN}:
        _tell(tx, changed)
    return changed


async def take(store: Store, job: str, trigger: BatchTrigger, **data: Any) -> StoredBatchJob:
    """Take a batch to its next state, in a transaction of its own."""
    return await store.write(partial(change, job=job, trigger=trigger, **data))


def _tell(tx: Transaction, job: StoredBatchJob) -> None:
    tx.emit(Kind.BATCH, None, {"batch": job.id, "state": job.state, "done": job.data["done"]})


_WORDS = {
    BatchTrigger.STARTED: "started",
    BatchTrigger.INTERRUPTED: "interrupted",
    BatchTrigger.FINISHED: "done",
    BatchTrigger.BROKEN: "failed",
    BatchTrigger.CANCELLED: "cancel",
}
