"""The actions that wait for robots' agents, in the store, and who waits for what.

    put ──► GET …/actions/next hands it out ──► POST …/feedback, now and then ──► POST …/result
     │ event                                            │ event                       │ event
     └──── wakes the agent's long poll                  └─────────────────────────────┴──► wakes who put it

The queue is durable and the result is kept with the action, so that neither a restart of the service nor a
second instance loses an answer; a repeated id gets the first result.
"""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import Callable
from typing import Any

from robomend.repairs.states import QueueState
from robomend.store.interface import Store, Transaction
from robomend.store.records import AgentAction
from robomend_client.actions import TIMED_OUT, UNREACHABLE, Action
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
            queued = tx.queue_action(
                action.id,
                robot,
                host=host,
                name=action.name,
                parameters=action.parameters,
                timeout_s=action.timeout_s,
            )
            tx.emit(Kind.ACTION, robot, describe(queued))
            return queued

        return await self._store.write(queue, robots=(robot,))

    async def action(self, action_id: str) -> AgentAction:
        """Return an action as it is now. NotFound."""
        return await self._store.read(lambda view: view.agent_action(action_id))

    async def take(self, robot: str, host: str | None, wait_s: float) -> AgentAction | None:
        """Hand out the next action for an agent, waiting up to `wait_s`."""
        deadline = asyncio.get_running_loop().time() + wait_s
        while True:
            change = self.watch(robot)
            queued = await self._store.read(lambda db: db.agent_actions(robot))
            if any(a.host is None or host is None or a.host == host for a in queued if not a.answered):
                taken = await self._store.write(
                    lambda tx: tx.take_action(robot, host=host, agent=host or "agent"), robots=(robot,)
                )
                if taken is not None:
                    return taken
            left = deadline - asyncio.get_running_loop().time()
            if left <= 0 or self._ending:
                return None
            await wait_for(change, min(left, 5 * LOOK_AGAIN_S))

    async def answered(self, action_id: str) -> AgentAction:
        """Note that an agent has begun; Conflict after the result, also when that is a cancellation."""
        known = await self._store.read(lambda view: view.agent_action(action_id))
        if known.answered and known.code is None:
            return known  # each second of a long action; nothing new to write

        def answer(tx: Transaction) -> AgentAction:
            action = tx.answer_action(action_id)
            tx.emit(Kind.ACTION, action.robot, describe(action))
            return action

        return await self._store.write(answer)

    async def finish(self, action_id: str, code: int, message: str) -> AgentAction:
        """Keep the agent's result; a second one gets the first."""

        def finish(tx: Transaction) -> AgentAction:
            first = tx.agent_action(action_id).code is None
            action = tx.finish_action(action_id, code, message)
            if first:
                tx.emit(Kind.ACTION, action.robot, describe(action))
            return action

        return await self._store.write(finish)

    async def withdraw(self, action_id: str, why: str) -> AgentAction:
        """Take back an action that no agent has begun; one that has begun is returned as it is.

        One that an agent has taken, without having said so far that it begins, may be acted on all the same:
        it gets TIMED_OUT (unknown); the others UNREACHABLE (did not act).
        """

        def take_back(tx: Transaction) -> AgentAction:
            action = tx.agent_action(action_id)
            code = UNREACHABLE if action.taken_by is None else TIMED_OUT
            return action if action.answered else tx.withdraw_action(action_id, code, why)

        return await self._store.write(take_back)


async def wait_for(change: asyncio.Event, timeout_s: float) -> None:
    """Wait for a change, but not longer."""
    with contextlib.suppress(TimeoutError):
        async with asyncio.timeout(timeout_s):
            await change.wait()


def describe(action: AgentAction) -> dict[str, Any]:
    """Return the data of an ACTION event."""
    return {
        "id": action.id,
        "name": action.name,
        "parameters": list(action.parameters),
        "host": action.host,
        "state": str(QueueState.of(action)),
        "result": action.code,
        "message": action.message,
    }
