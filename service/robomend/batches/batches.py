"""The batches of this computer's folder: kept, carried out, cancelled; what the HTTP interface asks of them.

    POST ──► files in a folder of their own ──► a row: waiting ──► running ──► done │ failed │ cancelled

Every process of the service looks for open batches of its folder, when it begins and whenever an event tells
of one. Whoever holds the batch's lock and a slot carries it out; both are the kernel's, so that what a killed
process had in hand is taken up by the next. Instances on one database with folders of their own carry out
theirs: every one of them lists all batches, and says on which computer the files of another's are.
"""

from __future__ import annotations

import asyncio
import contextlib
import socket
import time
from collections.abc import AsyncIterator, Callable, Coroutine, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import structlog

from robomend.batches import program
from robomend.batches.folders import LOCK, BatchFolder, BatchFolders, FileLock, hold, of_disk
from robomend.batches.log_names import find_below
from robomend.batches.one_batch import OneBatch
from robomend.batches.program import BatchOptions
from robomend.batches.record import BatchState, BatchTrigger, batch_json, change, new_batch
from robomend.errors import BackendError, NotFound, Overloaded, Refused, RobomendError, StateConflict
from robomend.poller import Seeker
from robomend.settings import Settings
from robomend.store import Store, batch_jobs
from robomend.store.records import Json, Page, Paging, StoredBatchJob
from robomend_client.events import Event, Kind

log = structlog.get_logger("robomend.batches.batches")

LOOK_S = 2.0
"""How often open batches are looked for that nobody carries out; most are found by their event."""

TIDY_S = 600.0
"""How often what ended long ago is removed."""

CLOSE_S = 10.0

UPLOADS = 4
"""That come in at once."""

RESULTS = {
    "ndjson": "results.ndjson",
    "logs": "logs.ndjson",
    "parquet": "results.parquet",
    "report": "report.html",
}
"""What there is of a batch that is done -> its file."""


class BatchUnavailable(BackendError):
    """What diagnoses logs is not installed."""

    code = "batch-not-installed"


@dataclass
class NewBatch:
    """A batch whose files are being written; `close` lets go, and removes them unless it was kept."""

    id: str
    folder: BatchFolder
    lock: FileLock
    kept: bool = False

    def close(self) -> None:
        """See the class; waits for the disk."""
        if not self.kept:
            self.folder.remove()
        self.lock.close()


class Batches:
    """See the module. Belongs to one event loop."""

    def __init__(self, store: Store, settings: Settings) -> None:
        self._store = store
        self._settings = settings
        self._folders = BatchFolders(settings.data.expanduser().resolve() / "batches")
        self._place: str | None = None
        self._running: dict[str, asyncio.Task[None]] = {}
        self._uploads = 0
        self._tidy_at = 0.0
        self._seeker = Seeker(self._seek, "batches", LOOK_S)
        self._end: Callable[[], None] = lambda: None

    async def start(self) -> None:
        """Take up what a crash left, and what is asked for from now on."""
        self._end = self._store.subscribe(self._follow, (Kind.BATCH,))
        self._seeker.start()

    async def close(self) -> None:
        """End what runs; it is taken up again by the next process."""
        self._end()
        await self._seeker.close(self._running.values(), CLOSE_S)

    def _follow(self, events: Sequence[Event]) -> None:
        if any(event.kind is Kind.BATCH for event in events):
            self._seeker.wake()

    # --- carrying out

    async def _seek(self) -> None:
        if self._place is None and not self._folders.root.exists():
            return  # nobody has asked for a batch here yet
        place = await self._our_place()
        if time.monotonic() >= self._tidy_at:
            await self._tidy(place)
            self._tidy_at = time.monotonic() + TIDY_S
        await self._attend(place)

    async def _our_place(self) -> str:
        if self._place is None:
            self._place = await self._on_disk(self._folders.place)
        return self._place

    async def _attend(self, place: str) -> None:
        """Begin what is open and nobody does; end what was cancelled."""
        open_ones = await self._store.read(batch_jobs.open_ones, place)
        open_ones = tuple(sorted(open_ones, key=lambda one: one.data.get("turns", 0)))  # then the oldest
        known = {job.id for job in open_ones}
        for job, task in [*self._running.items()]:
            if job not in known and await self._cancelled(job):
                task.cancel()
        for one in open_ones:
            if one.id in self._running:
                continue
            slot = await asyncio.to_thread(self._folders.slot, self._settings.batches_at_once)
            if slot is None:
                return
            folder = self._folders.of(one.id)
            lock = await asyncio.to_thread(hold, folder.path / LOCK)
            if lock is None and folder.path.exists():  # another process has it
                slot.close()
                continue
            task = asyncio.create_task(self._run(one, folder, lock, slot), name=f"batch {one.id}")
            self._running[one.id] = task
            task.add_done_callback(partial(self._ended, one.id))

    async def _cancelled(self, job: str) -> bool:
        """Return whether a batch was cancelled; one that has ended by itself still removes what was read."""
        try:
            return (await self._store.read(batch_jobs.get, job)).state == BatchState.CANCELLED
        except NotFound:
            return True

    async def _run(
        self, job: StoredBatchJob, folder: BatchFolder, lock: FileLock | None, slot: FileLock
    ) -> None:
        try:
            if lock is None:
                await self._store.write(
                    partial(change, job=job.id, trigger=BatchTrigger.BROKEN, message="its folder is gone")
                )
                return
            # Another process may have ended it between our look and our lock.
            job = await self._store.read(batch_jobs.get, job.id)
            if job.open:
                waits = partial(self._others_wait, job.place)
                await OneBatch(self._store, self._settings, job, folder, lock, waits).run()
            if not (await self._store.read(batch_jobs.get, job.id)).open:
                await asyncio.to_thread(folder.forget_uploads)
        except StateConflict:
            log.info("a batch was cancelled", batch=job.id)
        except RobomendError as error:  # the database is away: it is taken up again
            log.warning("batch", batch=job.id, code=error.code, detail=str(error))
            await asyncio.sleep(LOOK_S)
        except Exception:  # of one batch: the others go on
            log.exception("batch", batch=job.id)
            await asyncio.sleep(LOOK_S)
        finally:
            if lock is not None:
                lock.close()
            slot.close()

    async def _others_wait(self, place: str) -> bool:
        """Return whether a batch waits for a slot."""
        open_ones = await self._store.read(batch_jobs.open_ones, place)
        return len(open_ones) > self._settings.batches_at_once

    def _ended(self, job: str, _: asyncio.Task[None]) -> None:
        del self._running[job]
        self._seeker.wake()

    async def _tidy(self, place: str) -> None:
        """Forget what ended long ago, and remove the files that nobody knows."""
        before_ns = time.time_ns() - int(self._settings.batches_days * 86_400e9)
        keep = self._settings.batches_kept
        await self._store.write(partial(batch_jobs.forget, place=place, keep=keep, before_ns=before_ns))
        loop = asyncio.get_running_loop()

        def known() -> frozenset[str]:
            asked = asyncio.run_coroutine_threadsafe(self._store.read(batch_jobs.ids, place), loop)
            return asked.result(60)

        await self._on_disk(lambda: self._folders.sweep(known))
        for job in (await self._store.read(batch_jobs.page, Paging(limit=1000))).items:
            if job.place == place and not job.open and job.data["uploaded"]:
                await asyncio.to_thread(self._folders.of(job.id).forget_uploads)

    async def _on_disk(self, work: Callable[[], Any]) -> Any:
        try:
            return await asyncio.to_thread(work)
        except OSError as error:
            raise of_disk(error) from error

    # --- for HTTP

    def check_installed(self) -> None:
        """Refuse (BatchUnavailable) where robomend-batch cannot run."""
        part = program.missing()
        if part is not None:
            raise BatchUnavailable(
                f"{part} is not installed: pip install 'robomend[batch]' where the service runs"
            )

    @contextlib.asynccontextmanager
    async def new(self) -> AsyncIterator[NewBatch]:
        """Make the folder of a new batch, for its files to be written; what is not kept is removed.

        Raises:
            Overloaded: too many come in at once.
            StoreFull, StoreError: the disk is full, or refuses; of what is done in the block as well.
        """
        if self._uploads >= UPLOADS:
            raise Overloaded(f"{UPLOADS} batches are being handed in already")
        self._uploads += 1
        try:
            await self._our_place()
            job, folder, lock = await self._on_disk(self._folders.make)
            made = NewBatch(job, folder, lock)
            try:
                yield made
            except OSError as error:
                raise of_disk(error) from error
            finally:
                await asyncio.shield(asyncio.to_thread(made.close))
        finally:
            self._uploads -= 1
            self._seeker.wake()

    async def below_folder(self, patterns: Sequence[str]) -> tuple[Path, list[str]]:
        """Return the folder of the setting, and the logs below it that patterns mean.

        Raises:
            Refused: the setting is not there, or a path leads out of it.
            NotFound, InputError: see find_below.
        """
        folder = self._settings.batch_folder
        if folder is None:
            raise Refused("logs are taken by upload only: the setting batch_folder names no folder of logs")
        root = folder.expanduser().resolve()
        most = self._settings.max_batch_logs
        return root, await self._on_disk(lambda: find_below(root, patterns, most))

    async def keep(
        self,
        new: NewBatch,
        *,
        model: str,
        source: str,
        observers: str | None,
        names: list[str],
        folder: Path | None,
        size: int,
        options: BatchOptions,
        by: str,
        reason: str,
    ) -> Json:
        """Write down a batch whose logs are there, and return it.

        Args:
            new: its folder.
            model: as it is called.
            source: the model's text.
            observers: the text of an agent's file, or its observers.
            names: of the logs, relative to `folder`.
            folder: where the logs are; None: they were uploaded.
            size: bytes of an upload.
            options: see there.
            by: who asks.
            reason: why.

        Raises:
            Overloaded: too many wait.
        """

        def write() -> None:
            new.folder.model.write_text(source, encoding="utf-8")
            if observers is not None:
                new.folder.observers.write_text(observers, encoding="utf-8")
            new.folder.write_names(names)

        await self._on_disk(write)
        data = {
            "model": model,
            "logs": len(names),
            "bytes": size,
            "uploaded": folder is None,
            "folder": None if folder is None else str(folder),
            "options": options.json(),
            "host": socket.gethostname(),
            "by": by,
            "reason": reason,
        }
        place, most = await self._our_place(), self._settings.batches_waiting
        written = self._store.write(partial(new_batch, job=new.id, place=place, data=data, most=most))
        keeping = asyncio.ensure_future(_kept(new, written))
        try:
            return batch_json(await asyncio.shield(keeping))
        except asyncio.CancelledError:  # who asked has gone; whether it is kept must be known before we go
            await asyncio.wait({keeping})
            raise

    async def page(self, paging: Paging) -> Page[Json]:
        """Return batches, newest first."""
        found = await self._store.read(batch_jobs.page, paging)
        return Page(tuple(batch_json(job) for job in found.items), found.next)

    async def batch(self, job: str) -> Json:
        """Return one."""
        return batch_json(await self._store.read(batch_jobs.get, job))

    async def cancel(self, job: str, *, by: str, reason: str) -> Json:
        """Cancel one that is open; its processes are ended by whoever carries it out."""
        trigger = BatchTrigger.CANCELLED
        done = await self._store.write(partial(change, job=job, trigger=trigger, by=by, reason=reason))
        task = self._running.get(job)
        if task is not None:
            task.cancel()
            await asyncio.wait({task}, timeout=CLOSE_S)
        if done.data["uploaded"] and done.place == self._place:
            await asyncio.to_thread(self._folders.of(job).forget_uploads)
        return batch_json(done)

    async def result(self, job: str, form: str) -> Path:
        """Return the file with the results, in a form of RESULTS.

        Raises:
            StateConflict: there are none yet, or they are on another computer.
            NotFound: there is no such batch, or nothing of this form.
        """
        found = await self._store.read(batch_jobs.get, job)
        if found.open:
            raise StateConflict(f"batch {job} is {found.state}: there are no results yet")
        if found.place != await self._our_place():
            raise StateConflict(
                f"the files of batch {job} are on {found.data['host']}: ask the service there"
            )
        file = await asyncio.to_thread(self._folders.of(job).result, RESULTS[form])
        if file is None:
            raise NotFound(f"batch {job} is {found.state}, and has no {RESULTS[form]}")
        return file


async def _kept(new: NewBatch, written: Coroutine[Any, Any, StoredBatchJob]) -> StoredBatchJob:
    """Wait for the row: what it speaks of is not removed."""
    made = await written
    new.kept = True
    return made
