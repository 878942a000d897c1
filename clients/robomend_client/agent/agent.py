"""The agent: processes, bus, observers, reports and actions of one host, in one event loop.

    nodes ──messages──► broker ──times──► general observers ─┐
    processes ──ends, evidence──► node observer ─────────────┴──► reporter ──► service
    service ──actions──► supervisor ──► processes

The observers are pure; this is the edge that feeds them and asks them. A check that comes late (the machine
was busy) first lets the event loop take in what arrived in the meantime: our own lateness is no silence of
the robot.
"""

from __future__ import annotations

import asyncio
import logging
import time
from contextlib import AsyncExitStack

from robomend_client.agent.actions import Actions
from robomend_client.agent.broker import Broker, Tap
from robomend_client.agent.config import AgentConfig
from robomend_client.agent.memory import FirstResults
from robomend_client.agent.reporter import Reporter
from robomend_client.agent.supervisor import Supervisor
from robomend_client.buffer import DiskBuffer
from robomend_client.literals import Atom
from robomend_client.observers import PROCESSES, SECOND, GeneralObserver, NodeObserver, Observer
from robomend_client.outbox import AsyncOutbox
from robomend_client.rest.asynchronous import AsyncClient

log = logging.getLogger(__name__)

REPORT_TIMEOUT_S = 5.0
"""Observations that are not taken by then wait on the disk, so that little waits in memory."""


class Agent:
    """One agent; `run` returns when `stop` was called, with everything it started put away."""

    def __init__(self, config: AgentConfig) -> None:
        self.config = config
        self.bus = config.bus  # what the processes are told; known once `run` has opened it
        self.ready = asyncio.Event()
        self._stop = asyncio.Event()
        self._topics: dict[str, GeneralObserver] = {}
        self._checks: list[_Check] = []
        self._nodes_changed = asyncio.Event()

    def stop(self) -> None:
        """End, in order."""
        self._stop.set()

    async def run(self) -> None:
        config = self.config
        config.state_dir.mkdir(parents=True, exist_ok=True)
        async with AsyncExitStack() as stack:
            # The buffer's lock is the agent's: a second one with this state directory ends here.
            buffer = DiskBuffer(config.state_dir / "buffer", config.buffer_bytes)
            stack.callback(buffer.close)
            service, key = config.service, config.service.key()
            reports = await stack.enter_async_context(
                AsyncClient(service.url, key, timeout_s=REPORT_TIMEOUT_S)
            )
            orders = await stack.enter_async_context(AsyncClient(service.url, key, timeout_s=10.0))
            reporter = Reporter(
                AsyncOutbox(reports, config.robot, buffer),
                f"agent {config.agent}",
                config.heartbeat_s,
                config.lifetime_s,
            )
            self._observe(reporter)
            await self._open_bus(stack)
            supervisor = Supervisor(
                config.processes, config.state_dir, self.bus, config.keep_processes, self._nodes_changed.set
            )
            supervisor.open()
            stack.push_async_callback(supervisor.close)
            memory = FirstResults(config.state_dir / "results.jsonl")
            actions = Actions(orders, config.robot, config.agent, supervisor.processes, memory, config.host)
            stack.push_async_callback(actions.close)
            await self._work(supervisor, reporter, actions)
            await reporter.flush()

    async def _work(self, supervisor: Supervisor, reporter: Reporter, actions: Actions) -> None:
        async with asyncio.TaskGroup() as group:
            tasks = [
                group.create_task(self._watch(supervisor, reporter), name="observers"),
                group.create_task(reporter.run(), name="reporter"),
                group.create_task(actions.pull(), name="actions"),
                group.create_task(supervisor.start_initial(), name="initial processes"),
            ]
            self.ready.set()
            log.info("agent %s of %s is up; bus %s", self.config.agent, self.config.robot, self.bus)
            await self._stop.wait()
            while not all(task.done() for task in tasks):
                for task in tasks:
                    task.cancel()  # again, should a library in between have swallowed it
                await asyncio.wait(tasks, timeout=1.0)

    # --- observers -----------------------------------------------------------------------------------

    def _observe(self, reporter: Reporter) -> None:
        start_ns = time.monotonic_ns()
        for topic, expected in self.config.topics:
            observer = GeneralObserver(topic, expected, start_ns=start_ns)
            self._topics[topic] = observer
            self._checks.append(_Check(observer, (Atom("ok", (topic,)),), start_ns))
        names = tuple(spec.name for spec in self.config.processes)
        atoms = tuple(Atom("running", (name,)) for name in names)
        self._nodes = _Check(NodeObserver(names), atoms, start_ns)
        self._checks.append(self._nodes)

    def _message(self, topic: str, time_ns: int, data: object) -> None:
        observer = self._topics.get(topic)
        if observer is not None:
            observer.feed(topic, time_ns, data)

    async def _watch(self, supervisor: Supervisor, reporter: Reporter) -> None:
        while True:
            now_ns = time.monotonic_ns()
            wait_s = (min(check.due_ns for check in self._checks) - now_ns) / SECOND
            try:
                # Not wait_for: up to Python 3.11 it swallows a cancellation that comes with the event.
                async with asyncio.timeout(max(wait_s, 0.0)):
                    await self._nodes_changed.wait()
                self._nodes_changed.clear()
                self._nodes.due_ns = 0  # a process began or ended: say so now, not at the next beat
            except TimeoutError:
                pass
            await asyncio.sleep(0)  # twice round the loop: what has arrived is taken in first
            now_ns = time.monotonic_ns()
            due = [check for check in self._checks if check.due_ns <= now_ns]
            if self._nodes in due:
                self._nodes.observer.feed(PROCESSES, now_ns, supervisor.running())
            for check in due:
                check.next_after(now_ns)
            reporter.update(
                (atom for check in due for atom in check.atoms),
                [literal for check in due for literal in check.observer.check(now_ns)],
            )

    # --- the bus ---------------------------------------------------------------------------------------

    async def _open_bus(self, stack: AsyncExitStack) -> None:
        if self.config.joins_bus:
            tap = Tap(self.config.bus, list(self._topics), self._message)
            task = asyncio.create_task(tap.run(), name="bus")
            stack.push_async_callback(_cancelled, task)
            return
        broker = Broker(self.config.bus, self._message)
        await broker.open()
        stack.push_async_callback(broker.close)
        self.bus = broker.address


class _Check:
    """An observer and when it is to be asked next."""

    def __init__(self, observer: Observer, atoms: tuple[Atom, ...], start_ns: int) -> None:
        self.observer = observer
        self.atoms = atoms
        self.due_ns = start_ns

    def next_after(self, now_ns: int) -> None:
        """Keep to the beat; beats that were missed are not made up for."""
        period_ns = self.observer.period_ns
        # On one grid for all observers, so that equal periods share one wake-up.
        self.due_ns = (now_ns // period_ns + 1) * period_ns


async def _cancelled(task: asyncio.Task[None]) -> None:
    task.cancel()
    await asyncio.gather(task, return_exceptions=True)
