"""One batch, from its beginning or from where a crash left it: the run, then its report.

The command is the same each time, and robomend-batch goes on where it was killed. A batch that is killed time
and again without getting on is given up. One that takes long while others wait lets them go first, and goes
on behind them: each of its turns is twice as long as the one before, so that it gets on whatever comes.
"""

from __future__ import annotations

import asyncio
import contextlib
import json
import re
import time
from collections import Counter
from collections.abc import Awaitable, Callable, Iterable, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import structlog

from robomend.batches import program
from robomend.batches.folders import BatchFolder, FileLock
from robomend.batches.log_names import check_below
from robomend.batches.program import report_arguments, run_arguments
from robomend.batches.record import BatchTrigger, progress, take
from robomend.errors import InputError, StoreError
from robomend.settings import Settings
from robomend.store import Store
from robomend.store.records import StoredBatchJob

log = structlog.get_logger("robomend.batches.one_batch")

FIRST_TURN_S = 30.0
"""Before a batch lets those go first that wait."""

LEAST_S, SECONDS_A_MB = 900.0, 10.0
"""What logs may take: so long in any case, and so much for each of their megabytes. A gigabyte of messages
takes some minutes.
"""

MOST_DEATHS = 3
"""Of the program, without a further log done in between."""

TELL_S = 1.0
"""How often it notes how far the run is."""

OK, BAD_INPUT = 0, 2


PLACE = re.compile(r"(?<![\w./])/(?:[^\s/:'\"]+/)+(?=[^\s/:'\"])")
"""The folders of an absolute path."""


def without_places(message: str, roots: Iterable[Path | str | None]) -> str:
    """Return what a program said without where things are on this computer, which readers need not know."""
    for root in roots:
        if root is not None:
            message = message.replace(f"{root}/", "").replace(str(root), ".")
    return PLACE.sub("…/", message)


class _LetsOthers(Exception):
    """Its turn is over."""


class OneBatch:
    """See the module."""

    def __init__(
        self,
        store: Store,
        settings: Settings,
        job: StoredBatchJob,
        folder: BatchFolder,
        lock: FileLock,
        others_wait: Callable[[], Awaitable[bool]],
    ) -> None:
        self._store = store
        self._settings = settings
        self._job = job
        self._folder = folder
        self._lock = lock
        self._others_wait = others_wait

    async def run(self) -> None:
        """Carry it out, or until its turn is over.

        Raises:
            StateConflict: somebody has cancelled it.
        """
        with contextlib.suppress(_LetsOthers):
            await self._run()

    async def _run(self) -> None:
        try:
            names = await asyncio.to_thread(self._names)
        except (OSError, ValueError) as error:
            await self._end(BatchTrigger.BROKEN, f"its files are gone: {error}")
            return
        except InputError as error:
            await self._end(BatchTrigger.BROKEN, str(error))
            return
        while True:
            most_s, why = await asyncio.to_thread(self._most, names)
            left_s = most_s - self._job.data["ran_s"]
            started_ns = self._job.data["started_ns"] or time.time_ns()
            self._job = await self._take(BatchTrigger.STARTED, started_ns=started_ns)
            arguments = run_arguments(
                self._job.data["options"], self._folder, names, self._settings.batch_workers
            )
            code = await self._watched(arguments, left_s)
            if code is None:
                await self._end(BatchTrigger.BROKEN, why)
                return
            if code >= 0:
                break
            log.warning("the program of a batch was killed", batch=self._job.id, signal=-code)
            deaths = self._job.data["deaths"] + 1
            if deaths >= MOST_DEATHS:
                why = f"its program was killed {deaths} times, by signal {-code} at last: {self._said()}"
                await self._end(BatchTrigger.BROKEN, why)
                return
            self._job = await self._take(BatchTrigger.INTERRUPTED, deaths=deaths)
        if code in {OK, BAD_INPUT} and self._folder.result("logs.ndjson") is not None:
            with contextlib.suppress(OSError):
                await self._program(report_arguments(self._folder), left_s)
            await self._end(BatchTrigger.FINISHED, "" if code == OK else self._said())
        else:
            await self._end(BatchTrigger.BROKEN, self._said() or f"its program ended with {code}")

    def _most(self, names: Sequence[str]) -> tuple[float, str]:
        """Return how long it may run, and what is said if that does not do."""
        folder = self._folder.logs if self._job.data["uploaded"] else Path(self._job.data["folder"])
        size = 0
        for name in names:
            with contextlib.suppress(OSError):
                size += (folder / name).stat().st_size
        hours_s = self._settings.batch_hours * 3600
        size_s = LEAST_S + SECONDS_A_MB * size / 1e6
        if size_s < hours_s:
            return (
                size_s,
                f"it ran longer than {size_s / 60:.0f} minutes, which {size / 1e6:.1f} MB never take",
            )
        return hours_s, f"it ran longer than {self._settings.batch_hours:g} hours (batch_hours)"

    def _names(self) -> list[str]:
        """Return the logs; a link may lead elsewhere since they were named."""
        names = self._folder.names
        if not self._job.data["uploaded"]:
            root = Path(self._job.data["folder"])
            for name in names:
                check_below(root, name)
        return names

    async def _program(self, arguments: list[str], timeout_s: float) -> int | None:
        uploaded = self._job.data["uploaded"]
        return await program.run(
            arguments,
            folder=self._folder.logs if uploaded else Path(self._job.data["folder"]),
            said=self._folder.said,
            lock=self._lock.file,
            most_bytes=self._settings.max_batch_bytes,
            nice=self._settings.batch_nice,
            timeout_s=max(timeout_s, 0.0),
        )

    async def _watched(self, arguments: list[str], left_s: float) -> int | None:
        """Run the program, and note meanwhile how far it is."""
        running = asyncio.ensure_future(self._program(arguments, left_s))
        began_s, ran_s, turns = time.monotonic(), self._job.data["ran_s"], self._job.data.get("turns", 0)
        try:
            while not (await asyncio.wait({running}, timeout=TELL_S))[0]:
                took_s = time.monotonic() - began_s
                await self._note(ran_s + took_s)
                if took_s >= FIRST_TURN_S * 2**turns and await self._others_wait():
                    await self._take(BatchTrigger.INTERRUPTED, turns=turns + 1)
                    raise _LetsOthers
            return running.result()
        except OSError as error:
            log.warning("the program of a batch cannot be started", batch=self._job.id, detail=str(error))
            with self._folder.said.open("a") as said:
                print(f"it cannot be started: {error}", file=said)
            return 3
        finally:
            running.cancel()
            with contextlib.suppress(asyncio.CancelledError, OSError):
                await running

    async def _note(self, ran_s: float) -> None:
        seen = await asyncio.to_thread(self._seen)
        deaths = 0 if seen["done"] > self._job.data["done"] else self._job.data["deaths"]
        data = {**seen, "ran_s": ran_s, "deaths": deaths}
        try:
            self._job = await self._store.write(partial(progress, job=self._job.id, data=data))
        except StoreError as error:  # the database is away, which does not keep the program from its work
            log.warning("not noted how far a batch is", batch=self._job.id, detail=str(error))

    def _seen(self) -> dict[str, Any]:
        """Return how far the run is, by what it has written; nothing yet if that is not there."""
        try:
            written = json.loads((self._folder.out / "manifest.json").read_bytes().decode("utf-8", "replace"))
            records = [record for file in written["files"].values() for record in file["logs"]]
            done = len(written["files"])
        except (OSError, ValueError, KeyError):
            return {name: self._job.data[name] for name in ("done", "log_states", "faulty")}
        return {
            "done": done,
            "log_states": dict(sorted(Counter(record["state"] for record in records).items())),
            "faulty": sum(
                1 for record in records if any(map(record["intervals"].get, ("faulty", "degraded")))
            ),
        }

    def _said(self) -> str:
        return program.tail(self._folder.said)

    async def _end(self, trigger: BatchTrigger, message: str) -> None:
        seen = await asyncio.to_thread(self._seen)
        roots = [self._folder.logs, self._folder.path, self._job.data["folder"]]
        await self._take(trigger, message=without_places(message, roots), **seen)

    async def _take(self, trigger: BatchTrigger, **data: Any) -> StoredBatchJob:
        return await take(self._store, self._job.id, trigger, **data)
