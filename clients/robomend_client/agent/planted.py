"""The faults that a drill has planted through an agent, each with the time after which it is undone.

    plant ──► on disk, with its lease ──► the process is killed, halted or replaced, the topic disturbed
    undo  ──► it runs, or goes on, or passes ──► off the disk
    the lease is over, or the agent was restarted ──► undone by the agent itself

What is on the disk (state_dir/planted.json) was perhaps not planted; what was planted is on the disk. So a
crash at any moment leaves nothing that nobody knows of: undoing what is not there does no harm.

The global stop forbids acts, and undoing is one. So before the agent undoes something by itself it asks
whether the stop is active, and waits if it is; where the service cannot be asked, what it said last counts.
"""

from __future__ import annotations

import asyncio
import contextlib
import json
import logging
import os
import sys
import time
from collections import deque
from collections.abc import Awaitable, Callable, Mapping
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any

from robomend_client.actions import FAILED, OK, REFUSED, UNDONE_BEFORE, ActionResult
from robomend_client.agent.broker import Broker, TopicMessage
from robomend_client.agent.processes import SupervisedProcess
from robomend_client.agent.spawn import Handle, NotStarted, boot_id, spawn
from robomend_client.python310 import timeout
from robomend_client.rest.errors import ClientError

# --- topics of the local bus -------------------------------------------------------------------------------
#
#     topic-dropped    nothing of the topic reaches observers or subscribers
#     topic-delayed    messages wait until BUNCH_S after the first one, then come all at once, in their order,
#                      as over a line that is too slow
#
# They are of the broker, in memory: an agent that ends takes them along.

DROPPED, DELAYED = "topic-dropped", "topic-delayed"
TOPIC_KINDS = (DROPPED, DELAYED)

BUNCH_S = 2.0
"""Longer than the silence that observers usually take for a fault."""

MOST_HELD = 10_000
"""Messages of one topic; the newest are dropped beyond, as for any subscriber that is too slow."""

MOST_BYTES = 4 * 1024 * 1024


class TopicFaults:
    """The disturbed topics of one bus; belongs to its event loop."""

    def __init__(self, broker: Broker, topics: tuple[str, ...]) -> None:
        """`topics` are those that may be disturbed."""
        self.topics = topics
        self._broker = broker
        self._held: dict[str, deque[tuple[TopicMessage, bytes]]] = {}
        self._bytes = 0
        self._timers: dict[str, asyncio.TimerHandle] = {}

    def plant(self, topic: str, kind: str) -> None:
        """Disturb a topic from now on."""
        if kind == DROPPED:
            self._broker.divert(topic, _nowhere)
        else:
            self._held[topic] = deque()
            self._broker.divert(topic, lambda message, line: self._hold(topic, message, line))

    def undo(self, topic: str) -> None:
        """Let it pass again, what was held back first; nothing happens to one that is not disturbed."""
        self._broker.divert(topic, None)
        if (timer := self._timers.pop(topic, None)) is not None:
            timer.cancel()
        if topic in self._held:
            self._release(topic)
            del self._held[topic]

    def _hold(self, topic: str, message: TopicMessage, line: bytes) -> None:
        held = self._held[topic]
        if len(held) >= MOST_HELD or self._bytes + len(line) > MOST_BYTES:
            self._broker.dropped += 1
            return
        if not held:
            self._timers[topic] = asyncio.get_running_loop().call_later(BUNCH_S, self._release, topic)
        held.append((message, line))
        self._bytes += len(line)

    def _release(self, topic: str) -> None:
        held = self._held[topic]
        while held:
            message, line = held.popleft()
            self._bytes -= len(line)
            self._broker.deliver(message, line)


def _nowhere(message: TopicMessage, line: bytes) -> None:
    """Drop a message."""


log = logging.getLogger(__name__)

KILLED, FROZEN, MUTE = "node-killed", "node-frozen", "node-mute"
KINDS = (KILLED, FROZEN, MUTE)
"""Of processes; those of topics are TOPIC_KINDS."""

MOST = 16
"""Planted faults at a time; the service plants one."""

AGAIN_S = 1.0
"""Between two tries to undo, and between two looks at the stop."""

UNDO_S = 30.0
"""For one try of the agent's own."""

BEYOND_S = 60.0
"""A stand-in ends by itself so long after its lease."""

MUTE_PROCESS = "import sys, time; time.sleep(float(sys.argv[1]))  # stand_in of a drill of robomend"
"""What stands in a node's place. It imports nothing of ours, so that it is there at once; the comment is for
whoever lists processes."""


@dataclass(frozen=True)
class Lease:
    """One planted fault."""

    component: str  # or the topic
    kind: str
    until_ns: int  # by this computer's clock; for people, and after a restart it is over anyway
    pid: int | None = None  # the process that was halted, or stands in
    start_ticks: int = 0
    boot: str = ""
    deadline_s: float = field(default=0.0, compare=False)  # monotonic, of this agent

    @property
    def key(self) -> tuple[bool, str]:
        """What has one fault at a time: a node, or a topic, which may have the same name."""
        return self.kind in TOPIC_KINDS, self.component


class PlantedFaults:
    """See the module."""

    def __init__(
        self,
        file: Path,
        processes: Mapping[str, SupervisedProcess],
        stopped: Callable[[], Awaitable[bool]],
        topics: TopicFaults | None = None,
    ) -> None:
        """
        Args:
            stopped: asks the service for the global stop: ClientError where that does not answer.
            topics: of the bus that is ours; None: it is another agent's.
        """
        self._file = file
        self._processes = processes
        self._ask_for_stop = stopped
        self._topics = topics
        self._stopped = False  # as the service said last
        self._leases: dict[tuple[bool, str], Lease] = {}
        self._turn = asyncio.Lock()
        self._changed = asyncio.Event()
        self._load()

    @property
    def leases(self) -> tuple[Lease, ...]:
        """What is planted now, or was being planted when the agent ended."""
        return tuple(self._leases.values())

    @property
    def topics(self) -> tuple[str, ...]:
        """The topics that may be disturbed."""
        return () if self._topics is None else self._topics.topics

    async def plant(self, component: str, kind: str, lease_s: float) -> ActionResult:
        """Plant a fault in a node's process or a topic; refused where it does not run, or has one already."""
        async with self._turn:
            lease = Lease(
                component,
                kind,
                time.time_ns() + int(lease_s * 1e9),
                boot=boot_id(),
                deadline_s=time.monotonic() + lease_s,
            )
            if lease.key in self._leases:
                return ActionResult(REFUSED, f"{component} has a planted fault already")
            if len(self._leases) >= MOST:
                return ActionResult(REFUSED, f"{MOST} faults are planted already")
            try:
                planted = await (
                    self._disturb(lease) if kind in TOPIC_KINDS else self._plant_in_process(lease, lease_s)
                )
            except OSError as error:  # what is not on disk is not planted
                return ActionResult(REFUSED, f"{self._file}: {error.strerror}: nothing is planted")
            except NotStarted as error:
                return ActionResult(REFUSED, f"no stand-in: {error}")
            if not planted:
                return ActionResult(REFUSED, f"{component} does not run, so that there is nothing to plant")
            return ActionResult(OK, f"{component}: {kind}, for {lease_s:g} s at most")

    async def undo(self, component: str, kind: str, timeout_s: float) -> ActionResult:
        """Undo a fault; nothing happens where it is not planted."""
        async with self._turn:
            lease = self._leases.get((kind in TOPIC_KINDS, component))
            if lease is None or lease.kind != kind:
                return ActionResult(UNDONE_BEFORE, f"{component}: no {kind} is planted (any more)")
            return await self._undo(lease, timeout_s)

    async def run(self) -> None:
        """Undo what an earlier agent left, and later what is over, for ever."""
        while True:
            self._changed.clear()
            now = time.monotonic()
            due = [lease for lease in self._leases.values() if lease.deadline_s <= now]
            if due and not await self._is_stopped():
                for lease in due:
                    async with self._turn:
                        if self._leases.get(lease.key) is lease:
                            log.warning("%s: its %s is undone by the agent", lease.component, lease.kind)
                            result = await self._undo(lease, UNDO_S)
                            if not result.ok:
                                log.error("%s", result.message)
            waits = [max(AGAIN_S, lease.deadline_s - now) for lease in self._leases.values()]
            with contextlib.suppress(TimeoutError):
                async with timeout(min(waits, default=3600.0)):
                    await self._changed.wait()

    async def close(self) -> None:
        """Let go on what is halted, so that it can end in order, and let pass what is disturbed.

        What was killed or replaced is for the next agent: a stand-in ends with this one.
        """
        async with self._turn:
            for lease in self.leases:
                if lease.kind not in {KILLED, MUTE}:
                    await self._undo(lease, UNDO_S)

    # --- inside

    async def _disturb(self, lease: Lease) -> bool:
        assert self._topics is not None  # the executors offer no topics otherwise
        self._begin(lease)
        self._topics.plant(lease.component, lease.kind)
        return True

    async def _plant_in_process(self, lease: Lease, lease_s: float) -> bool:
        """Return whether there was a process to plant it in."""
        process = self._processes[lease.component]
        handle = process.handle
        if handle is None or not process.running:
            return False
        if lease.kind == MUTE:
            return await self._replace(process, lease, lease_s)
        self._begin(_of_process(lease, handle))
        await (process.kill() if lease.kind == KILLED else process.freeze())
        return True

    async def _replace(self, process: SupervisedProcess, lease: Lease, lease_s: float) -> bool:
        """Put a mute process in a node's place; it ends with this agent, whatever the others do."""
        words = (sys.executable, "-I", "-S", "-c", MUTE_PROCESS, str(lease_s + BEYOND_S))
        other = spawn(words, None, {}, dies_with_agent=True)
        try:
            self._begin(_of_process(lease, other))
        except OSError:
            other.reap()
            other.close()
            raise
        replaced = await process.replace(other)
        if not replaced:
            self._keep(self._without(lease))
        return replaced

    def _begin(self, lease: Lease) -> None:
        """Write a lease down, before the act."""
        self._keep({**self._leases, lease.key: lease})
        self._changed.set()

    def _without(self, lease: Lease) -> dict[tuple[bool, str], Lease]:
        return {key: other for key, other in self._leases.items() if key != lease.key}

    async def _undo(self, lease: Lease, timeout_s: float) -> ActionResult:
        result = ActionResult(OK, f"{lease.component}: {lease.kind} is undone")
        process = self._processes.get(lease.component)
        if lease.kind in TOPIC_KINDS:
            if self._topics is not None:
                self._topics.undo(lease.component)
        elif process is not None and lease.kind == FROZEN:
            if process.handle is not None and lease.pid == process.handle.pid:
                process.thaw()
            # Else that process is gone, and a new one was never halted.
        elif process is not None:
            # One that stands in goes; a new one that a repair has started stays.
            if process.handle is not None and lease.kind == MUTE and lease.pid == process.handle.pid:
                await process.kill()
            try:
                result = await process.start(_quiet, timeout_s)
            except TimeoutError:
                result = ActionResult(FAILED, f"{lease.component} was not started within {timeout_s:g} s")
        if result.ok:
            try:
                self._keep(self._without(lease))
            except OSError as error:
                return ActionResult(FAILED, f"{self._file}: {error.strerror}")
        return result

    async def _is_stopped(self) -> bool:
        try:
            async with timeout(UNDO_S):
                stopped = await self._ask_for_stop()
        except (ClientError, TimeoutError) as error:
            log.debug("the global stop could not be asked for: %s", error)
            return self._stopped
        if stopped != self._stopped:
            self._stopped = stopped
            with contextlib.suppress(OSError):
                self._keep(self._leases)
        return stopped

    def _keep(self, leases: dict[tuple[bool, str], Lease]) -> None:
        rows = [{k: v for k, v in asdict(lease).items() if k != "deadline_s"} for lease in leases.values()]
        temporary = self._file.with_suffix(".new")
        with temporary.open("w") as file:
            json.dump({"stopped": self._stopped, "faults": rows}, file)
            file.flush()
            os.fsync(file.fileno())
        temporary.replace(self._file)
        folder = os.open(self._file.parent, os.O_RDONLY)
        try:
            os.fsync(folder)
        finally:
            os.close(folder)
        self._leases = leases

    def _load(self) -> None:
        """Take over what an earlier agent planted: it is due at once."""
        try:
            found: dict[str, Any] = json.loads(self._file.read_text())
            self._stopped = bool(found["stopped"])
            leases = [Lease(**row) for row in found["faults"]]
        except FileNotFoundError:
            return
        except (OSError, ValueError, KeyError, TypeError) as error:
            log.error("%s cannot be read (%s): what was planted is not known", self._file, error)
            return
        # A process number of another boot means nothing; nor does what is halted then.
        here = boot_id()
        self._leases = {one.key: one for one in leases if one.kind in {KILLED, MUTE} or one.boot == here}


def _of_process(lease: Lease, handle: Handle) -> Lease:
    return replace(lease, pid=handle.pid, start_ticks=handle.start_ticks)


def _quiet(number: int, message: str) -> None:
    log.debug("%s", message)
