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
import time
from collections.abc import Collection, Coroutine, Sequence
from contextlib import AsyncExitStack
from functools import partial
from typing import Any

from robomend_client.agent.actions import Actions
from robomend_client.agent.broker import Broker, Tap, TopicMessage
from robomend_client.agent.config import AgentConfig
from robomend_client.agent.executors.base import Executors
from robomend_client.agent.executors.ros_programs import Before
from robomend_client.agent.executors.supervised import drilled, supervised
from robomend_client.agent.feeds import AgentParts, Bridge, Feed, Reads, Samples
from robomend_client.agent.memory import FirstResults
from robomend_client.agent.moments import Moments, Watched
from robomend_client.agent.planted import PlantedFaults, TopicFaults
from robomend_client.agent.reporter import VerdictReporter
from robomend_client.agent.supervisor import Supervisor
from robomend_client.agent.usage import PERIOD_S, Usage
from robomend_client.agent.usual import Usual
from robomend_client.agent.watch import Watch
from robomend_client.beats import until_beat_s
from robomend_client.buffer import DiskBuffer
from robomend_client.clock import Clock
from robomend_client.observers import PROCESSES, Change, Contact
from robomend_client.outbox import Outbox
from robomend_client.python310 import end, timeout
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
        self._told: set[str] = set()  # sources that a message did not have

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
            bridges = [feed for feed, _ in config.feeds if isinstance(feed, Bridge)]

            moments = Moments(
                config.moments,
                config.robot,
                config.agent,
                config.state_dir / "moments",
                clock,
                [Watched(spec.atoms, spec.sources) for spec in config.observers],
            )

            def on_changes(changes: Sequence[Change]) -> None:
                reporter.report(changes)
                if config.moments.keep:
                    moments.changed(changes)
                usual.changed(changes)
                for bridge in bridges:
                    bridge.changed(changes)

            observers = [spec.make() for spec in config.observers]
            usual = Usual(config.state_dir, observers)
            stack.callback(usual.write)
            watch = Watch(
                observers,
                clock,
                on_changes,
                config.lenient,
                config.recording,
                moments.sample if config.moments.keep else None,
                [usual, moments.ring] if config.moments.keep else [usual],
                config.starved,
            )
            for feed, sources in config.feeds:
                if isinstance(feed, Reads):
                    watch.read(feed, sources)
            stack.callback(watch.close)
            reporter = VerdictReporter(
                Outbox(reports, config.robot, buffer),
                f"agent {config.agent}",
                config.heartbeat_s,
                config.lifetime_s,
                watch.standing,
                clock,
            )
            topics = await self._open_bus(stack, watch, moments)
            supervisor = Supervisor(
                config.processes, config.state_dir, self.bus, config.keep_processes, self._nodes_changed.set
            )
            supervisor.open()
            stack.push_async_callback(supervisor.close)
            moments.processes = supervisor.processes
            stack.push_async_callback(moments.close)
            memory = FirstResults(config.state_dir / "results.jsonl")
            planted = PlantedFaults(
                config.state_dir / "planted.json", supervisor.processes, partial(_is_stopped, orders), topics
            )
            stack.push_async_callback(planted.close)
            executors = Executors(
                config.agent,
                [
                    *supervised(supervisor.processes),
                    *drilled(tuple(supervisor.processes), planted),
                    *(spec.make() for spec in config.actions),
                ],
            )
            for executor in executors:
                if isinstance(before := getattr(executor, "before", None), Before):
                    before.keep_in(config.state_dir)
            actions = Actions(orders, config.robot, config.agent, executors, memory, config.host, watch)
            stack.push_async_callback(actions.close)
            for bridge in bridges:
                bridge.attach(
                    AgentParts(
                        robot=config.robot,
                        agent=config.agent,
                        state_dir=config.state_dir,
                        client=await stack.enter_async_context(AsyncClient(service.url, key, timeout_s=10.0)),
                        clock=clock,
                        executors=executors,
                        actions=actions,
                        standing=watch.standing,
                        heartbeat_s=config.heartbeat_s,
                        buffer_bytes=config.buffer_bytes,
                        tap=moments.ring.tap if config.moments.keep else None,
                        keeps_all=config.moments.record,
                    )
                )
            send_moments = moments.send(orders, lambda: reporter.quiet)
            beside = moments.run(), send_moments, usual.run()
            await self._work(supervisor, watch, reporter, actions, planted, *beside)
            await reporter.flush()

    async def _work(
        self,
        supervisor: Supervisor,
        watch: Watch,
        reporter: VerdictReporter,
        actions: Actions,
        planted: PlantedFaults,
        *beside: Coroutine[Any, Any, None],
    ) -> None:
        work = {
            "observers": watch.run(),
            "processes": self._tables(supervisor, watch),
            "reporter": reporter.run(),
            "actions": actions.pull(),
            "initial processes": supervisor.start_initial(),
            "planted faults": planted.run(),
        }
        tasks = [asyncio.create_task(work, name=name) for name, work in work.items()]
        tasks += [asyncio.create_task(part, name="moments and what is usual") for part in beside]
        tasks += [asyncio.create_task(_fed(feed, sources, watch)) for feed, sources in self.config.feeds]
        self.ready.set()
        log.info("agent %s of %s is up; bus %s", self.config.agent, self.config.robot, self.bus)
        await _until(self._stop, tasks)

    # --- what the agent knows itself ---------------------------------------------------------------------

    async def _tables(self, supervisor: Supervisor, watch: Watch) -> None:
        """Say which processes run: at once when one begins or ends, and now and then."""
        wanted = PROCESSES in self.config.sources(own=True)
        usage = Usage(self.config.sources(own=True) - {PROCESSES}, supervisor.processes)
        measure_at = 0.0
        period_s = TABLE_S if wanted or usage.wanted else PERIOD_S
        while True:
            if wanted:
                watch.sample(PROCESSES, supervisor.table())
            if time.monotonic() >= measure_at:
                measure_at = time.monotonic() + PERIOD_S
                supervisor.trim_outputs()
                if usage.wanted:
                    for source, value in usage.measure(supervisor.leaders()).items():
                        watch.sample(source, value)
            with contextlib.suppress(TimeoutError):
                # Not wait_for: up to Python 3.11 it swallows a cancellation that comes with the event.
                async with timeout(until_beat_s(period_s, time.time_ns())):
                    await self._nodes_changed.wait()
            self._nodes_changed.clear()

    # --- feeds -----------------------------------------------------------------------------------------

    async def _open_bus(self, stack: AsyncExitStack, watch: Watch, moments: Moments) -> TopicFaults | None:
        """Listen to the bus; return what a drill may do to it, where it is ours."""
        sources = self.config.sources(own=False)
        samples = Samples(sources, watch.sample, self._missing_field)

        def on_message(message: TopicMessage) -> None:
            if self.config.moments.keep and (message.data is not None or message.fields):
                said = message.fields if message.data is None else message.data
                moments.said(message.topic, message.time_ns, said)
            samples.message(message.topic, message.data, message.time_ns, message.fields)

        if self.config.joins_bus:
            tap = Tap(self.config.bus, list(samples.topics), on_message, partial(watch.look, sources))
            watch.read(tap, sources)
            task = asyncio.create_task(tap.run(), name="bus")
            stack.push_async_callback(end, [task])
            return None
        broker = Broker(self.config.bus, on_message)
        await broker.open()
        stack.push_async_callback(broker.close)
        self.bus = broker.address
        return TopicFaults(broker, samples.topics)

    def _missing_field(self, source: str, why: str) -> None:
        if source not in self._told:
            self._told.add(source)
            log.warning("%s: a message of this topic has %s", source, why)


async def _is_stopped(client: AsyncClient) -> bool:
    return (await client.stopped())["active"]


async def _fed(feed: Feed, sources: Collection[str], watch: Watch) -> None:
    """Run a feed; one that ends leaves the agent as it is, and what it fed turns unknown."""
    try:
        await feed.run(watch.sample)
    except Exception:  # a feed may be anybody's
        log.exception("the feed %s failed", type(feed).__name__)
    watch.look(sources, Contact.LOST)


async def _until(stop: asyncio.Event, tasks: list[asyncio.Task[None]]) -> None:
    """Let all work until `stop`, or until one of them fails; then end them all."""
    stopped: asyncio.Task[Any] = asyncio.create_task(stop.wait())
    try:
        while not stopped.done():
            waited_for = [stopped, *(task for task in tasks if not task.done())]
            await asyncio.wait(waited_for, return_when=asyncio.FIRST_COMPLETED)
            for task in tasks:
                if task.done():
                    task.result()
    finally:
        await end([stopped, *tasks])
