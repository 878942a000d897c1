"""Batches: logs that are diagnosed behind HTTP, where their files are, and how far each has come.

The files are in a folder, the job's place; who may carry it out is decided there, by a lock that the kernel
frees. So what is written here needs no fence: only an open job is changed, and one that ended stays as it is.
"""

from __future__ import annotations

from sqlalchemy import func, select

from robomend.errors import Overloaded, StateConflict
from robomend.store import schema
from robomend.store.encoding import checked, from_json, to_json
from robomend.store.records import FIRST_PAGE, Json, Page, Paging, StoredBatchJob
from robomend.store.rows import AnyRow, View
from robomend.store.transaction import Transaction

_JOBS = schema.batch_jobs


def get(view: View, job: str) -> StoredBatchJob:
    """Return a job."""
    return _job(view.one(select(_JOBS).where(_JOBS.c.id == checked(job)), f"batch {job!r}"))


def page(view: View, paging: Paging = FIRST_PAGE) -> Page[StoredBatchJob]:
    """Return them, newest first."""
    return view.newest_first(_JOBS, _job, paging)


def open_ones(view: View, place: str) -> tuple[StoredBatchJob, ...]:
    """Return the open jobs of a place, the oldest first."""
    query = select(_JOBS).where(_JOBS.c.open, _JOBS.c.place == checked(place)).order_by(_JOBS.c.number)
    return tuple(_job(row) for row in view.rows(query))


def ids(view: View, place: str) -> frozenset[str]:
    """Return which jobs of a place are known."""
    return frozenset(row.id for row in view.rows(select(_JOBS.c.id).where(_JOBS.c.place == checked(place))))


def create(tx: Transaction, job: str, *, place: str, state: str, data: Json, most: int) -> StoredBatchJob:
    """Keep a new job; Overloaded while `most` jobs of the place are open."""
    waiting = tx.rows(select(func.count()).where(_JOBS.c.open, _JOBS.c.place == checked(place)))[0][0]
    if waiting >= most:
        raise Overloaded(f"{waiting} batches wait or run already; come again when one has ended")
    row = {
        "id": checked(job),
        "place": place,
        "state": checked(state),
        "open": True,
        "data": to_json(data),
        "created_ns": tx.now_ns,
        "updated_ns": tx.now_ns,
    }
    tx.insert(_JOBS, row)
    return get(tx, job)


def update(tx: Transaction, job: str, *, state: str, open: bool, data: Json) -> StoredBatchJob:
    """Note what an open job has come to; StateConflict if it has ended."""
    still = (_JOBS.c.id == checked(job)) & _JOBS.c.open
    values = {"state": checked(state), "open": open, "data": to_json(data), "updated_ns": tx.now_ns}
    if not tx.change(_JOBS.update().where(still).values(values)):
        raise StateConflict(f"batch {job} has ended: it is {get(tx, job).state}")
    return get(tx, job)


def forget(tx: Transaction, place: str, *, keep: int, before_ns: int) -> int:
    """Forget the jobs of a place that ended before that time, and all that ended but the newest `keep`."""
    ended = select(_JOBS.c.number, _JOBS.c.updated_ns).where(~_JOBS.c.open, _JOBS.c.place == checked(place))
    rows = tx.rows(ended.order_by(_JOBS.c.number.desc()))
    old = [row.number for rank, row in enumerate(rows) if rank >= keep or row.updated_ns < before_ns]
    for start in range(0, len(old), 500):
        tx.change(_JOBS.delete().where(_JOBS.c.number.in_(old[start : start + 500])))
    return len(old)


def _job(row: AnyRow) -> StoredBatchJob:
    return StoredBatchJob(
        row.id,
        row.number,
        row.place,
        row.state,
        row.open,
        from_json(row.data),
        row.created_ns,
        row.updated_ns,
    )
