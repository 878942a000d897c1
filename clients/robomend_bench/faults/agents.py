"""The agents of a simulated robot: the real protocol, reports and actions; only the processes are simulated.

HostObservers ──► VerdictReporter ──► Outbox ──► POST …/observations      (robomend_client's own)
POST …/actions/next ──► Actions ──► the simulated robot ──► POST …/result (the same)
"""

from __future__ import annotations

import asyncio
import random
import time
from collections.abc import Awaitable, Callable, Collection, Mapping
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any, TypeVar

from robomend_bench.faults.classes import Reporting
from robomend_bench.faults.condition import Act
from robomend_bench.faults.observing import HostObservers
from robomend_client.actions import Action, ActionResult, Feedback
from robomend_client.agent.actions import Actions
from robomend_client.agent.executors.base import Executors
from robomend_client.agent.memory import FirstResults
from robomend_client.agent.reporter import VerdictReporter
from robomend_client.buffer import DiskBuffer
from robomend_client.clock import Clock
from robomend_client.outbox import Outbox
from robomend_client.rest.asynchronous import AsyncClient
from robomend_client.rest.calls import Call
from robomend_client.rest.errors import Unreachable
from robomend_client.rest.retry import Retry

USUAL = Reporting()

CUT_S = 0.2
"""How long it takes to see that nobody can be reached."""

T = TypeVar("T")

CarryOut = Callable[[Act, str], Awaitable[ActionResult]]
"""Does an act on the simulated robot, for the agent of this name."""


class Line(AsyncClient):
    """The way from an agent to the service: it may be cut, held up, slow, and of an agent of long ago.

    Everything that the agent sends goes this way; `noted` is told of each batch of observations that arrived,
    and how many seconds its answer took.
    """

    def __init__(
        self,
        client: AsyncClient,
        reporting: Reporting,
        seed: str,
        noted: Callable[[Mapping[str, Any], float], None] = lambda batch, took_s: None,
    ) -> None:
        # Not a connection of its own: `client` has it.
        self._client = client
        self._reporting = reporting
        self._chance = random.Random(f"line {seed}")
        self._noted = noted
        self.open = asyncio.Event()  # the agent runs
        self.open.set()
        self.cut = False  # nothing gets through

    async def send(self, call: Call[T], retry: Retry | None = None) -> T:
        """Send one call, as the line allows."""
        reports = call.path.endswith("/observations")
        if reports and self._reporting.late_s:
            await asyncio.sleep(self._chance.random() * self._reporting.late_s)
        await self.open.wait()
        if self.cut:
            await asyncio.sleep(CUT_S)
            raise Unreachable("the link is down")
        sent_s = time.monotonic()
        answer = await self._client.send(self._as_of_old(call) if self._reporting.old else call, retry)
        took_s = time.monotonic() - sent_s
        await self.open.wait()
        if reports:
            self._noted(call.json, took_s)
        return answer

    def _as_of_old(self, call: Call[T]) -> Call[T]:
        if not isinstance(call.json, dict):
            return call
        unknown_then = {"since", "onset", "settled", "readings", "observes", "can"}
        return replace(call, json={key: v for key, v in call.json.items() if key not in unknown_then})


class HostAgent:
    """One agent; `start` begins its work, `stop` ends it and may be followed by another `start`."""

    def __init__(
        self,
        robot: str,
        host: str | None,
        clients: tuple[AsyncClient, AsyncClient],
        folder: Path,
        knows: Collection[Act],
        carry_out: CarryOut,
        reporting: Reporting = USUAL,
        noted: Callable[[str, Mapping[str, Any], float], None] = lambda agent, batch, took_s: None,
    ) -> None:
        """`clients` are for reports and for orders; `knows` are the acts that this host can do."""
        self.host = host
        self.name = host or "onboard"
        self._robot = robot
        self._reporting = reporting
        self._reports, self._orders = self.lines = [
            Line(client, reporting, f"{robot} {self.name}", partial(noted, self.name)) for client in clients
        ]
        self._folder = folder / self.name
        self._knows = frozenset(knows)
        self._carry_out = carry_out
        self._tasks: list[asyncio.Task[None]] = []
        self._buffer: DiskBuffer | None = None
        self._actions: Actions | None = None
        self.observers: HostObservers | None = None
        self.reporter: VerdictReporter | None = None

    def start(self, observers: HostObservers) -> None:
        """Report what these observers see, and pull actions."""
        self._folder.mkdir(parents=True, exist_ok=True)
        self._buffer = DiskBuffer(self._folder / "buffer", 1024 * 1024)
        self.observers = observers
        outbox = Outbox(self._reports, self._robot, self._buffer)
        self.reporter = VerdictReporter(
            outbox,
            f"agent {self.name}",
            self._reporting.heartbeat_s,
            self._reporting.lifetime_s,
            observers.standing,
            _ObserversClock(observers),
        )
        memory = FirstResults(self._folder / "results.jsonl")
        acts = sorted(self._knows, key=str)
        executors = Executors(self.name, [_SimulatedExecutor(a, self.name, self._carry_out) for a in acts])
        watch = None if self._reporting.old else observers
        self._actions = Actions(self._orders, self._robot, self.name, executors, memory, self.host, watch)
        self._tasks = [
            asyncio.create_task(self.reporter.run(), name=f"reports of {self._robot}"),
            asyncio.create_task(self._actions.pull(), name=f"orders of {self._robot}"),
        ]

    @property
    def broken(self) -> str:
        """Why a part of it has ended although nobody stopped it; empty if none has."""
        for task in self._tasks:
            if task.done() and not task.cancelled():
                return f"{task.get_name()}: {task.exception()!r}"
        return ""

    async def stop(self) -> None:
        """End what it does; its actions under way are given up."""
        self.observers = self.reporter = None
        tasks, self._tasks = self._tasks, []
        for task in tasks:
            task.cancel()
        await asyncio.gather(*tasks, return_exceptions=True)
        if self._actions is not None:
            await self._actions.close()
            self._actions = None
        if self._buffer is not None:
            self._buffer.close()
            self._buffer = None


class _ObserversClock(Clock):
    """The time up to which the observers have seen everything: what stands is stamped with that."""

    def __init__(self, observers: HostObservers) -> None:
        super().__init__()
        self._observers = observers

    def now_ns(self) -> int:
        return self._observers.now_ns()


class _SimulatedExecutor:
    """Does one act, with simulated processes."""

    def __init__(self, act: Act, agent: str, carry_out: CarryOut) -> None:
        self.name = act.name
        self.parameters = tuple((parameter,) for parameter in act.parameters)
        self.gives_up = act.name == "start_node"
        self._act, self._agent, self._do = act, agent, carry_out

    async def execute(self, action: Action, feedback: Feedback) -> ActionResult:
        feedback(1, f"{self._act} begins")
        return await self._do(self._act, self._agent)
