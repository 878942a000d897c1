"""Actions that an agent on the robot pulls, carries out and reports; they wait in the store.

    execute ──► queue_action ──► POST …/actions/next hands it out ──► POST …/result ──► execute returns
                    │ event                                              │ event
                    └──── wakes the agent's long poll                    └──── wakes execute, anywhere

While an agent acts it sends feedback every second; 409 tells it that the action has been withdrawn.

The queue is durable and the result is kept with the action, so that neither a restart of the service nor a
second instance loses an answer; a repeated id gets the first result.
"""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import Callable, Collection, Mapping
from typing import Any

from robomend.errors import RobomendError, StoreError
from robomend.store import Store, Transaction, agent_actions
from robomend.store.records import AgentAction
from robomend_client.actions import CANCELLED, TIMED_OUT, UNREACHABLE, Action, ActionResult, Feedback
from robomend_client.events import Event, Kind

LOOK_AGAIN_S = 1.0
"""Events wake us; this is for an event that was lost with its database connection."""


class AgentQueue:
    """The agents' side of one store: what waits for whom, and who waits for what. One per instance."""

    def __init__(self, store: Store) -> None:
        self._store = store
        self._changed: dict[str, asyncio.Event] = {}  # robot -> something about its actions changed
        self._end: Callable[[], None] | None = None
        self._ending = False

    def start(self) -> None:
        """Follow the store's events, whichever instance wrote them."""
        self._end = self._store.subscribe(self._notice)

    def end_waits(self) -> None:
        """Let every waiting agent go with nothing to do: a server that ends need not wait for them."""
        self._ending = True
        for change in self._changed.values():
            change.set()

    def close(self) -> None:
        """Stop following."""
        if self._end is not None:
            self._end()

    def _notice(self, events: tuple[Event, ...]) -> None:
        for event in events:
            if event.kind is Kind.ACTION and event.robot is not None:
                waiting = self._changed.pop(event.robot, None)
                if waiting is not None:
                    waiting.set()

    def watch(self, robot: str) -> asyncio.Event:
        """Return what will be set at the next change of the robot's actions: watch first, then look."""
        return self._changed.setdefault(robot, asyncio.Event())

    async def put(self, robot: str, host: str | None, action: Action) -> AgentAction:
        """Queue an action for the agent on `host` (None: any of the robot's)."""

        def queue(tx: Transaction) -> AgentAction:
            queued = agent_actions.queue(
                tx,
                action.id,
                robot,
                host=host,
                name=action.name,
                parameters=action.parameters,
                timeout_s=action.timeout_s,
            )
            tx.emit(Kind.ACTION, robot, describe(queued, "queued"))
            return queued

        return await self._store.write(queue, robots=(robot,))

    async def take(
        self,
        robot: str,
        host: str | None,
        wait_s: float,
        *,
        agent: str | None = None,
        can: Collection[str] | None = None,
    ) -> AgentAction | None:
        """Hand out the next action that an agent can do (None: anything), waiting up to `wait_s`."""
        name = agent or host or "agent"
        deadline = asyncio.get_running_loop().time() + wait_s
        while True:
            change = self.watch(robot)
            queued = await self._store.read(agent_actions.waiting, robot)
            if any(agent_actions.meant_for(a, host, can) for a in queued if not a.answered):
                taken = await self._store.write(
                    lambda tx: agent_actions.take(tx, robot, host=host, agent=name, can=can),
                    robots=(robot,),
                )
                if taken is not None:
                    return taken
            left = deadline - asyncio.get_running_loop().time()
            if left <= 0 or self._ending:
                return None
            await _wait(change, min(left, 5 * LOOK_AGAIN_S))

    async def answered(self, action_id: str) -> AgentAction:
        """Note that an agent has begun; Conflict after the result, also when that is a cancellation."""
        known = await self._store.read(agent_actions.get, action_id)
        if known.answered and known.code is None:
            return known  # each second of a long action; nothing new to write

        def answer(tx: Transaction) -> AgentAction:
            action = agent_actions.answer(tx, action_id)
            tx.emit(Kind.ACTION, action.robot, describe(action, "running"))
            return action

        return await self._store.write(answer)

    async def finish(self, action_id: str, code: int, message: str) -> AgentAction:
        """Keep the agent's result; a second one gets the first."""

        def finish(tx: Transaction) -> AgentAction:
            first = agent_actions.get(tx, action_id).code is None
            action = agent_actions.finish(tx, action_id, code, message)
            if first:
                tx.emit(Kind.ACTION, action.robot, describe(action, "done"))
            return action

        return await self._store.write(finish)

    async def withdraw(self, action_id: str, why: str) -> AgentAction:
        """Take back an action that no agent has begun; one that has begun is returned as it is.

        One that an agent has taken, without having said so far that it begins, may be acted on all the same:
        it gets TIMED_OUT (unknown); the others UNREACHABLE (did not act).
        """

        def take_back(tx: Transaction) -> AgentAction:
            action = agent_actions.get(tx, action_id)
            code = UNREACHABLE if action.taken_by is None else TIMED_OUT
            return action if action.answered else agent_actions.withdraw(tx, action_id, code, why)

        return await self._store.write(take_back)


class AgentExecutor:
    """Carries out one robot's actions through its agents."""

    def __init__(
        self,
        queue: AgentQueue,
        store: Store,
        robot: str,
        hosts: Mapping[str, str | None],
        halt: asyncio.Event | None = None,
    ) -> None:
        """
        Args:
            hosts: component -> the host whose agent acts on it; None or absent: any agent of the robot.
            halt: set when an action is cut off because nobody wants it any more; else it may go on, and
                whoever takes over asks for its result.
        """
        self._queue = queue
        self._store = store
        self._robot = robot
        self._hosts = dict(hosts)
        self._halt = halt

    async def execute(self, action: Action, feedback: Feedback) -> ActionResult:
        host = next((self._hosts[p] for p in action.parameters if self._hosts.get(p)), None)
        loop = asyncio.get_running_loop()
        deadline = loop.time() + action.timeout_s
        change = self._queue.watch(self._robot)
        state = await self._queue.put(self._robot, host, action)
        told = False
        try:
            while state.code is None and (left := deadline - loop.time()) > 0:
                await _wait(change, min(left, LOOK_AGAIN_S))
                change = self._queue.watch(self._robot)
                with contextlib.suppress(StoreError):  # it may come back within our time
                    state = await self._store.read(agent_actions.get, action.id)
                if state.answered and not told:
                    told = True
                    feedback(0, f"{state.taken_by or 'an agent'} has begun")
        except asyncio.CancelledError:
            with contextlib.suppress(RobomendError):  # then the agent's own time-out ends it
                await asyncio.shield(self._cut_off(action))
            raise
        if state.code is not None:
            return ActionResult(state.code, state.message)
        state = await self._take_back(action)
        if state.code is not None and state.answered:
            return ActionResult(state.code, state.message)  # it came in just now
        who = f"the agent on {host}" if host else "the robot's agent"
        if state.taken_by is None:
            return ActionResult(UNREACHABLE, f"{who} did not ask for such work in {action.timeout_s:g} s")
        return ActionResult(TIMED_OUT, f"{who} took it and did not report in {action.timeout_s:g} s")

    async def _cut_off(self, action: Action) -> None:
        state = await self._take_back(action)
        if state.code is None and self._halt is not None and self._halt.is_set():
            await self._queue.finish(action.id, CANCELLED, "withdrawn while the agent was at it")

    async def _take_back(self, action: Action) -> AgentAction:
        return await self._queue.withdraw(action.id, "withdrawn: nobody asked for it in time")


async def _wait(change: asyncio.Event, timeout_s: float) -> None:
    with contextlib.suppress(TimeoutError):
        async with asyncio.timeout(timeout_s):
            await change.wait()


def describe(action: AgentAction, state: str) -> dict[str, Any]:
    """Return the data of an ACTION event."""
    return {
        "id": action.id,
        "name": action.name,
        "parameters": list(action.parameters),
        "host": action.host,
        "state": state,
        "result": action.code,
        "message": action.message,
    }
