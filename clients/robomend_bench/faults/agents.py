"""The agents of a simulated robot: the real protocol, reports and actions; only the processes are simulated.

HostObservers ──► Reporter ──► AsyncOutbox ──► POST …/observations      (robomend_client's own)
GET …/actions/next ──► Actions ──► the simulated robot ──► POST …/result (the same)
"""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable, Collection
from pathlib import Path

from robomend_bench.faults.condition import Act
from robomend_bench.faults.observing import HostObservers
from robomend_client.actions import FAILED, REFUSED, TIMED_OUT, Action, ActionResult, Feedback
from robomend_client.agent.actions import Actions
from robomend_client.agent.memory import FirstResults
from robomend_client.agent.reporter import Reporter
from robomend_client.buffer import DiskBuffer
from robomend_client.outbox import AsyncOutbox
from robomend_client.rest.asynchronous import AsyncClient

HEARTBEAT_S, LIFETIME_S = 1.0, 5.0
"""The agent's defaults."""

CarryOut = Callable[[Act, str], Awaitable[ActionResult]]
"""Does an act on the simulated robot, for the agent of this name."""


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
    ) -> None:
        """`clients` are for reports and for orders; `knows` are the acts that this host can do."""
        self.host = host
        self.name = host or "onboard"
        self._robot = robot
        self._reports, self._orders = clients
        self._folder = folder / self.name
        self._knows = frozenset(knows)
        self._carry_out = carry_out
        self._tasks: list[asyncio.Task[None]] = []
        self._buffer: DiskBuffer | None = None
        self._actions: _SimulatedActions | None = None
        self.observers: HostObservers | None = None
        self.reporter: Reporter | None = None

    def start(self, observers: HostObservers) -> None:
        """Report what these observers see, and pull actions."""
        self._folder.mkdir(parents=True, exist_ok=True)
        self._buffer = DiskBuffer(self._folder / "buffer", 1024 * 1024)
        self.observers = observers
        outbox = AsyncOutbox(self._reports, self._robot, self._buffer)
        self.reporter = Reporter(outbox, f"agent {self.name}", HEARTBEAT_S, LIFETIME_S)
        memory = FirstResults(self._folder / "results.jsonl")
        self._actions = _SimulatedActions(
            self._orders, self._robot, self.name, memory, self.host, self._knows, self._carry_out
        )
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


class _SimulatedActions(Actions):
    """The agent's own handling of actions, with simulated processes."""

    def __init__(
        self,
        client: AsyncClient,
        robot: str,
        agent: str,
        memory: FirstResults,
        host: str | None,
        knows: frozenset[Act],
        carry_out: CarryOut,
    ) -> None:
        super().__init__(client, robot, agent, {}, memory, host)
        self._name = agent
        self._knows = knows
        self._do = carry_out

    async def run(self, action: Action, feedback: Feedback) -> ActionResult:
        act = Act(action.name, action.parameters)
        if act not in self._knows:
            return ActionResult(REFUSED, f"agent {self._name} cannot do {act}")
        feedback(1, f"{act} begins")
        try:
            async with asyncio.timeout(action.timeout_s):
                return await self._do(act, self._name)
        except TimeoutError:
            return ActionResult(TIMED_OUT, f"{act} was not done within {action.timeout_s:g} s")
        except OSError as error:
            return ActionResult(FAILED, f"{act}: {error}")
