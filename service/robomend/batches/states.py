"""The states of a batch, and how each comes from the one before; docs/batch.md draws the table."""

from __future__ import annotations

from enum import StrEnum


class BatchState(StrEnum):
    """What a batch is in."""

    WAITING = "waiting"  # until one of those that run has ended
    RUNNING = "running"
    DONE = "done"  # there are results; of bad logs they say what is wrong
    FAILED = "failed"  # there are none, or not of all logs
    CANCELLED = "cancelled"


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
