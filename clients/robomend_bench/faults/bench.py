"""Runs many trials side by side against one service: its process, the clock tick, the events, the load.

    ticker, every TICK_S ──► every robot under trial
    events of the service ──► the robot that they are of

How late the ticker was is noted in every record, and how long the service waited for a processor. A trial
during which either came to more than LATE_S is no measurement of the service, and is counted as such. Where
it may, the bench goes before other processes: robots do not wait for a busy computer.
"""

from __future__ import annotations

import asyncio
import contextlib
import gc
import math
import os
import random
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import AsyncIterator, Callable, Iterator, Sequence
from contextlib import asynccontextmanager, contextmanager
from pathlib import Path

from robomend_bench.faults.field import BY_NAME
from robomend_bench.faults.live import LiveRobot
from robomend_bench.faults.record import Record, Trial
from robomend_bench.faults.stretches import STRETCH_BY_NAME
from robomend_bench.faults.trial import Terms, play, scenario_of
from robomend_bench.service.process import NotReady, Served, start
from robomend_client.rest.asynchronous import AsyncClient
from robomend_client.rest.errors import ClientError

TICK_S = 0.01
LOOK_AFTER_S = 0.2

LATE_S = 0.3
"""A trial with a later tick than this is left out, or with a service that was kept waiting so long."""

STARVED_OVER_S = 0.5
"""… in so much time. It is the kernel that says so, of the thread that answers requests."""

FIRST = -10
"""The bench's own priority (nice), where it may choose; the service has the usual one."""

MEMORY = Path("/dev/shm")
"""Where the agents keep their files, if it is there: each waits for the disk after each result, and with so
many in one process all would wait. The service's data is on a disk."""

BUSY = """
import os, sys, time
parent = int(sys.argv[1])
while os.getppid() == parent:
    end = time.monotonic() + 0.5
    while time.monotonic() < end:
        pass
"""

STARVED_FOR_S, STARVED_EACH_S = 30.0, 45.0

Done = Callable[[Record], None]


@contextmanager
def busy(loops: int) -> Iterator[None]:
    """Run so many busy loops beside; they end with us."""
    running = [
        subprocess.Popen(
            [sys.executable, "-c", BUSY, str(os.getpid())],
            stdin=subprocess.DEVNULL,
            process_group=0,  # Ctrl-C is for us, who end them
        )
        for _ in range(loops)
    ]
    try:
        yield
    finally:
        for process in running:
            process.kill()
            process.wait()


class Bench:
    """One service and the robots under trial."""

    def __init__(self, data: Path, agents: Path, priority: int) -> None:
        """`data` is the service's folder, `agents` that of all the agents, `priority` the service's."""
        self.folder = agents
        self.url = ""
        self.ticks: list[float] = []  # how late each was
        self.deaths: list[str] = []  # of the service, not those that a stretch is about
        self._data = data
        self._priority = priority
        self._live: dict[str, LiveRobot] = {}
        self._models: dict[str, asyncio.Task[None]] = {}
        self._served: Served | None = None
        self._restarting = asyncio.Lock()

    def clock(self) -> float:
        """Return the time of the bench."""
        return time.monotonic()

    @property
    def service_pid(self) -> int:
        """The service's process; 0 while there is none."""
        return 0 if self._served is None else self._served.pid

    def join(self, live: LiveRobot) -> None:
        """Let time pass for a robot, and hand it its events."""
        self._live[live.id] = live

    def leave(self, live: LiveRobot) -> None:
        """Let no more time pass for it."""
        self._live.pop(live.id, None)

    async def model(self, client: AsyncClient, name: str, text: str) -> None:
        """Put a model, once."""
        if name not in self._models:
            self._models[name] = asyncio.create_task(_put_model(client, name, text))
        await self._models[name]

    @asynccontextmanager
    async def running(self) -> AsyncIterator[None]:
        """Run the service, the ticker and the stream of events."""
        tasks: list[asyncio.Task[None]] = []
        orderly = False
        try:
            await self._start(0)
            parts = (self._tick(), self._follow(), self._keep_looking(), self._note_starvation())
            tasks += [asyncio.create_task(part) for part in parts]
            yield
            for task in tasks:
                if task.done():
                    task.result()  # without it nothing that was measured since means anything
            orderly = True
        finally:
            for task in tasks:
                task.cancel()
            await asyncio.gather(*tasks, return_exceptions=True)
            # After Ctrl-C nobody wants its data, and on a busy computer an orderly end takes its time.
            await asyncio.to_thread(self._end_service, kill=not orderly)

    async def _start(self, port: int) -> None:
        arguments = ["--port", str(port)] if port else []
        begun = _Begun()
        start_at = asyncio.to_thread(_start_at, self._priority, self._data, arguments, begun)
        starting = asyncio.ensure_future(start_at)
        try:
            self._served = await asyncio.shield(starting)
        except asyncio.CancelledError:
            begun.give_up()  # on a busy computer it may take minutes to announce itself
            with contextlib.suppress(NotReady):
                self._served = await starting  # it had announced itself already, and so has to be ended
            raise
        self.url = self._served.url

    def _end_service(self, *, kill: bool) -> None:
        if self._served is None:
            return
        if self._served.process.poll() is None:
            if kill:
                self._served.kill()
            else:
                try:
                    self._served.stop()
                except subprocess.TimeoutExpired:
                    self._served.kill()
        assert self._served.process.stdout is not None
        self._served.process.stdout.close()
        self._served = None

    async def restart_service(self, *, kill: bool) -> None:
        """End the service, or kill it, and start it again on the same port and data."""
        async with self._restarting:
            await self._restart(kill=kill)

    async def _restart(self, *, kill: bool) -> None:
        port = int(self.url.rpartition(":")[2])
        await asyncio.to_thread(self._end_service, kill=kill)
        await self._start(port)

    async def look_after(self) -> None:
        """Start the service again if it has died, and note that it has."""
        async with self._restarting:
            if self._served is None or self._served.process.poll() is None:
                return
            log = (self._data / "log").read_text(errors="replace")[-2000:]
            self.deaths.append(f"the service died: {log}")
            await self._restart(kill=True)

    async def _keep_looking(self) -> None:
        while True:
            await asyncio.sleep(LOOK_AFTER_S)
            await self.look_after()

    async def _note_starvation(self) -> None:
        """Note for how much of each half second the service waited for a processor."""
        before: tuple[Served | None, float] = (None, 0.0)
        while True:
            now = (self._served, 0.0 if self._served is None else _waited_s(self._served.pid))
            if now[0] is not None and now[0] is before[0]:
                for live in self._live.values():
                    live.record.starved_s = max(live.record.starved_s, now[1] - before[1])
            before = now
            await asyncio.sleep(STARVED_OVER_S)

    async def _tick(self) -> None:
        due_s = self.clock()
        while True:
            now_s = self.clock()
            late_s = now_s - due_s
            self.ticks.append(late_s)
            for live in tuple(self._live.values()):
                try:
                    live.tick(now_s, late_s)
                except Exception as error:  # noqa: BLE001  # an error of ours in one robot: the others go on
                    live.record.error = f"the bench failed: {type(error).__name__}: {error}"
                    self.leave(live)
            due_s = max(due_s + TICK_S, self.clock())
            await asyncio.sleep(due_s - self.clock())

    async def _follow(self) -> None:
        """Hand each event to its robot; the service's stamps and our clock are of one machine."""
        ahead_s = time.time() - self.clock()
        while True:
            with contextlib.suppress(ClientError):
                async with AsyncClient(self.url) as client:
                    async for event in client.events():
                        live = self._live.get(event.robot or "")
                        if live is not None:
                            live.event(event, event.time_ns / 1e9 - ahead_s)
            await asyncio.sleep(0.1)


class _Begun:
    """The process of a service that is being started in a thread: whoever waits for it may give it up."""

    def __init__(self) -> None:
        self._process: subprocess.Popen[str] | None = None
        self._unwanted = False

    def __call__(self, process: subprocess.Popen[str]) -> None:
        """Note it; called in that thread."""
        self._process = process
        if self._unwanted:
            process.kill()

    def give_up(self) -> None:
        """Kill it, now or as soon as there is one."""
        self._unwanted = True
        if self._process is not None:
            self._process.kill()


def _start_at(priority: int, data: Path, arguments: Sequence[str], begun: _Begun) -> Served:
    """Start the service with a priority of its own, in a thread, whose priority it inherits."""
    with contextlib.suppress(PermissionError):
        os.setpriority(os.PRIO_PROCESS, 0, priority)  # of this thread alone, on Linux
    return start(data, arguments, begun=begun)


@contextmanager
def going_first() -> Iterator[int]:
    """Go before other processes, if we may, and what is begun meanwhile too; yield the usual priority."""
    before = os.getpriority(os.PRIO_PROCESS, 0)
    with contextlib.suppress(PermissionError):
        os.setpriority(os.PRIO_PROCESS, 0, FIRST)
    try:
        yield before
    finally:
        os.setpriority(os.PRIO_PROCESS, 0, before)


def _waited_s(process: int) -> float:
    """Return how long a process' first thread has waited for a processor; 0 where the kernel does not say."""
    try:
        return int(Path(f"/proc/{process}/schedstat").read_bytes().split()[1]) / 1e9
    except (OSError, IndexError):
        return 0.0


async def _put_model(client: AsyncClient, name: str, text: str) -> None:
    await client.put_model(name, text)


async def run_trials(
    trials: Sequence[Trial],
    terms: Terms,
    *,
    jobs: int,
    load: int = 0,
    done: Done = lambda record: None,
    until_s: float = math.inf,
) -> tuple[list[Record], list[float]]:
    """Play trials, `jobs` at a time; return their records, in the order of the trials, and the ticks.

    Stretches in which the service restarts share services of their own, after everything else. `until_s`, by
    the monotonic clock: after it no trial is begun; those that were not have no record.
    """
    by_service: dict[str, list[Trial]] = {"": []}
    for trial in trials:
        by_service.setdefault(_to_service(trial), []).append(trial)
    shared = by_service.pop("")
    found: dict[Trial, Record] = {}
    ticks: list[float] = []
    for trial in trials:
        scenario_of(trial)  # while nobody waits for the tick
    gc.collect()
    gc.freeze()
    with busy(load), going_first() as usual:
        groups = [shared] if shared else []
        for own in by_service.values():
            groups += [own[at : at + jobs] for at in range(0, len(own), jobs)]
        for group in groups:
            if time.monotonic() >= until_s:
                break
            with _folder() as data, _folder(MEMORY) as agents:
                bench = Bench(data, agents, usual)
                async with bench.running():
                    await _run_group(bench, group, terms, jobs, found, done, until_s)
                ticks += bench.ticks
    return [found[trial] for trial in trials if trial in found], ticks


async def _run_group(
    bench: Bench,
    group: Sequence[Trial],
    terms: Terms,
    jobs: int,
    found: dict[Trial, Record],
    done: Done,
    until_s: float,
) -> None:
    waiting = list(enumerate(group))[::-1]
    what = _to_service(group[0])
    disturbing = asyncio.create_task(DISTURBANCES[what](bench, group)) if what else None

    async def work(number: int) -> None:
        # Not all at once: robots that boot together are a load of their own.
        await asyncio.sleep(0.5 * number)
        while waiting and time.monotonic() < until_s:
            index, trial = waiting.pop()
            deaths = len(bench.deaths)
            record = await play(trial, terms, bench, index)
            await bench.look_after()
            if len(bench.deaths) > deaths:
                record.error = bench.deaths[-1]  # whatever came of it, it was no measurement
            found[trial] = record
            done(record)

    try:
        await asyncio.gather(*(work(number) for number in range(min(jobs, len(group)))))
    finally:
        if disturbing is not None:
            disturbing.cancel()
            await asyncio.gather(disturbing, return_exceptions=True)


@contextmanager
def _folder(within: Path | None = None) -> Iterator[Path]:
    where = within if within is not None and os.access(within, os.W_OK) else None
    with tempfile.TemporaryDirectory(prefix="robomend-bench-", dir=where) as folder:
        yield Path(folder)


def _to_service(trial: Trial) -> str:
    """Return what is done to the service of a trial."""
    return (STRETCH_BY_NAME.get(trial.cls) or BY_NAME[trial.cls]).to_service


async def _restarts(bench: Bench, group: Sequence[Trial]) -> None:
    """Restart the service of a group, now and then, ended and killed in turn."""
    chance = random.Random(f"restarts {group[0]}")
    await asyncio.sleep(10.0)
    for number in range(2):
        await asyncio.sleep(chance.uniform(3.0, 8.0))
        with contextlib.suppress(NotReady):
            await bench.restart_service(kill=bool(number % 2))


async def _starve_owner(bench: Bench, group: Sequence[Trial]) -> None:
    """Leave the service's main process a tenth of a core for 30 s of each 45."""
    await _starve(bench, lambda: [bench.service_pid])


async def _starve_workers(bench: Bench, group: Sequence[Trial]) -> None:
    """The same of its workers: planners and engines."""
    await _starve(bench, lambda: descendants(bench.service_pid))


async def _starve(bench: Bench, processes: Callable[[], list[int]]) -> None:
    stopped: list[int] = []
    try:
        while True:
            await asyncio.sleep(STARVED_EACH_S - STARVED_FOR_S)
            for _ in range(round(STARVED_FOR_S)):
                stopped = [one for one in processes() if one]
                _signal(stopped, signal.SIGSTOP)
                await asyncio.sleep(0.9)
                _signal(stopped, signal.SIGCONT)
                stopped = []
                await asyncio.sleep(0.1)
    finally:
        _signal(stopped, signal.SIGCONT)


def _signal(processes: Sequence[int], what: signal.Signals) -> None:
    for process in processes:
        with contextlib.suppress(ProcessLookupError):
            os.kill(process, what)


def descendants(process: int) -> list[int]:
    """Return the processes that a process has begun, and those that these have."""
    found: list[int] = []
    for file in Path(f"/proc/{process}/task").glob("*/children"):
        with contextlib.suppress(OSError):
            for child in map(int, file.read_text().split()):
                found += [child, *descendants(child)]
    return found


DISTURBANCES = {
    "restart": _restarts,
    "starve the owner": _starve_owner,
    "starve the workers": _starve_workers,
}
"""What is done to services that have trials of their own."""
