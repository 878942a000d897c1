"""The agent: processes, bus, observers, reports and actions of one host, in one event loop.

nodes ──messages──► broker ─────────┐
processes ──ends, evidence──► table ┴──► watch (observers) ──► reporter ──► service
service ──actions──► supervisor ──► processes
        └─settle──► watch
"""

from __future__ import annotations

import asyncio
import contextlib
import logging
from contextlib import AsyncExitStack

from robomend_client.agent.actions import Actions
from robomend_client.agent.broker import Broker, Tap
from robomend_client.agent.config import AgentConfig
from robomend_client.agent.memory import FirstResults
from robomend_client.agent.reporter import Reporter
from robomend_client.agent.supervisor import Supervisor
from robomend_client.agent.watch import Watch
from robomend_client.buffer import DiskBuffer
from robomend_client.clock import Clock
from robomend_client.observers import PROCESSES, GeneralObserver, NodeObserver, Observer
from robomend_client.outbox import AsyncOutbox
from robomend_client.rest.asynchronous import AsyncClient

log = logging.getLogger(__name__)

REPORT_TIMEOUT_S = 5.0
"""Observations that are not taken by then wait on the disk, so that little waits in memory."""

TABLE_S = 0.1
"""How often the node observer hears which processes run, changed or not; 10 Hz, as published."""


class Agent:
    """One agent; `run` returns when `stop` was called, with everything it started put away."""

    def __init__(self, config: AgentConfig) -> None:
        self.config = config
        self.bus = config.bus  # what the processes are told; known once `run` has opened it
        self.ready = asyncio.Event()
        self._stop = asyncio.Event()
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
            clock = Clock()
            watch = Watch(self._observers(), clock, lambda changes: reporter.report(changes), config.lenient)
            stack.callback(watch.close)
            reporter = Reporter(
                AsyncOutbox(reports, config.robot, buffer),
                f"agent {config.agent}",
                config.heartbeat_s,
                config.lifetime_s,
                watch.standing,
                clock,
            )
            await self._open_bus(stack, watch)
            supervisor = Supervisor(
                config.processes, config.state_dir, self.bus, config.keep_processes, self._nodes_changed.set
            )
            supervisor.open()
            stack.push_async_callback(supervisor.close)
            memory = FirstResults(config.state_dir / "results.jsonl")
            actions = Actions(
                orders, config.robot, config.agent, supervisor.processes, memory, config.host, watch
            )
            stack.push_async_callback(actions.close)
            await self._work(supervisor, watch, reporter, actions)
            await reporter.flush()

    async def _work(self, supervisor: Supervisor, watch: Watch, reporter: Reporter, actions: Actions) -> None:
        async with asyncio.TaskGroup() as group:
            tasks = [
                group.create_task(watch.run(), name="observers"),
                group.create_task(self._tables(supervisor, watch), name="processes"),
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

    def _observers(self) -> list[Observer]:
        nodes = tuple(spec.name for spec in self.config.processes)
        observers: list[Observer] = [GeneralObserver(topic, rate) for topic, rate in self.config.topics]
        observers += [spec.make() for spec in self.config.observers]
        return [*observers, NodeObserver(nodes)] if nodes else observers

    async def _tables(self, supervisor: Supervisor, watch: Watch) -> None:
        """Say which processes run: at once when one begins or ends, and now and then."""
        while True:
            watch.sample(PROCESSES, supervisor.table())
            with contextlib.suppress(TimeoutError):
                # Not wait_for: up to Python 3.11 it swallows a cancellation that comes with the event.
                async with asyncio.timeout(TABLE_S):
                    await self._nodes_changed.wait()
            self._nodes_changed.clear()

    # --- the bus ---------------------------------------------------------------------------------------

    async def _open_bus(self, stack: AsyncExitStack, watch: Watch) -> None:
        def message(topic: str, time_ns: int, data: object) -> None:
            watch.sample(topic, data)

        if self.config.joins_bus:
            tap = Tap(self.config.bus, [topic for topic, _ in self.config.topics], message)
            task = asyncio.create_task(tap.run(), name="bus")
            stack.push_async_callback(_cancelled, task)
            return
        broker = Broker(self.config.bus, message)
        await broker.open()
        stack.push_async_callback(broker.close)
        self.bus = broker.address


async def _cancelled(task: asyncio.Task[None]) -> None:
    task.cancel()
    await asyncio.gather(task, return_exceptions=True)
