"""The actions that wait for robots' agents, in the store, and who waits for what.

    put ──► POST …/actions/next hands it out ──► POST …/feedback, now and then ──► POST …/result
     │ event                                            │ event                       │ event
     └──── wakes the agent's long poll                  └─────────────────────────────┴──► wakes who put it

The queue is durable and the result is kept with the action, so that neither a restart of the service nor a
second instance loses an answer; a repeated id gets the first result.
"""

from __future__ import annotations

import asyncio
import contextlib
from collections import OrderedDict, deque
from collections.abc import Callable, Collection
from functools import partial
from typing import Any

from robomend.errors import StateConflict
from robomend.poller import wait_for
from robomend.repairs.execution_values import MOST_FEEDBACK
from robomend.repairs.states import QueueState
from robomend.repairs.throttle import Throttle
from robomend.robots.reporters import OURSELVES, Reporter
from robomend.store import Store, Transaction, View, agent_actions, global_stop
from robomend.store.ownership import SURE_S, boot_s
from robomend.store.records import AgentAction, AuditEntry, Fence
from robomend_client.actions import TIMED_OUT, UNREACHABLE, Action, Settle
from robomend_client.events import Event, Kind

FEEDBACK_S = 1.0
"""Between two feedbacks of one action that are told."""

REMEMBERED = 1024
"""Actions of which the latest feedback is remembered."""

MOST_SETTLES = 16
"""Of a robot: an agent that has missed more will be asked with the next one."""

LOOK_AGAIN_S = 1.0
"""Events wake us; this is for an event that was lost with its database connection."""


class AgentQueue:
    """The agents' side of one store: what waits for whom, and who waits for what. One per instance."""

    def __init__(self, store: Store, stopped: Callable[[], bool] = lambda: False) -> None:
        """`stopped` tells whether the global stop is in force here, also before it is on disk."""
        self._store = store
        self._stopped = stopped
        self._changed: dict[str, asyncio.Event] = {}  # robot -> something about its actions changed
        self._end: Callable[[], None] | None = None
        self._ending = False
        self.said: OrderedDict[str, tuple[int, str]] = OrderedDict()  # action -> its latest feedback, told
        self._coming: dict[str, tuple[int, str]] = {}  # … and one that is not told yet
        self._telling = Throttle(FEEDBACK_S, self._tell)
        self._settles: dict[str, deque[Settle]] = {}  # robot -> the latest

    def start(self) -> None:
        """Follow the store's events, whichever instance wrote them."""
        self._end = self._store.subscribe(self._notice, (Kind.ACTION,))

    def end_waits(self) -> None:
        """Let every waiting agent go with nothing to do: a server that ends need not wait for them."""
        self._ending = True
        for change in self._changed.values():
            change.set()

    async def close(self) -> None:
        """Stop following, and telling."""
        if self._end is not None:
            self._end()
        await self._telling.close()

    def _notice(self, events: tuple[Event, ...]) -> None:
        for event in events:
            if event.kind is Kind.ACTION and event.robot is not None:
                waiting = self._changed.pop(event.robot, None)
                if waiting is not None:
                    waiting.set()
                said = event.data.get("feedback")
                anew = event.data.get("settle")
                if anew is not None:
                    latest = self._settles.setdefault(event.robot, deque(maxlen=MOST_SETTLES))
                    latest.append(Settle(anew["n"], tuple(anew["atoms"])))
                if said is not None and "repair" not in event.data:
                    self.said[event.data["id"]] = (said["code"], said["message"])
                    while len(self.said) > REMEMBERED:
                        self.said.popitem(last=False)

    def watch(self, robot: str) -> asyncio.Event:
        """Return what will be set at the next change of the robot's actions: watch first, then look."""
        return self._changed.setdefault(robot, asyncio.Event())

    def settle(self, robot: str, after: int | None, atoms: Collection[str]) -> Settle | None:
        """Return what an agent that observes these atoms is to judge anew, `after` the number it acted on."""
        due = [one for one in self._settles.get(robot, ()) if after is None or one.n > after]
        wanted = sorted({atom for one in due for atom in one.atoms}.intersection(atoms))
        return Settle(due[-1].n, tuple(wanted)) if wanted else None

    async def put(
        self, robot: str, host: str | None, action: Action, fence: Fence | None = None
    ) -> AgentAction:
        """Queue an action for the agent on `host` (None: any of the robot's).

        Raises:
            Fenced: another instance has taken the robot over.
        """

        def queue(tx: Transaction) -> AgentAction:
            if fence is not None:
                tx.check_fence(robot, fence)
            queued = agent_actions.queue(
                tx,
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
        return await self._store.read(agent_actions.get, action_id)

    async def take(
        self,
        robot: str,
        host: str | None,
        wait_s: float,
        by: Reporter = OURSELVES,
        anew: Callable[[], Settle | None] = lambda: None,
        interlocked: Callable[[], object] = lambda: None,
        *,
        agent: str | None = None,
        can: Collection[str] | None = None,
    ) -> AgentAction | None:
        """Hand out the next action that an agent can do (None: anything), waiting up to `wait_s`; nothing, at
        once, if `anew` has news; no action while it is interlocked.
        """
        take = partial(self._take, robot, host, agent or host or "agent", can, by)
        deadline = asyncio.get_running_loop().time() + wait_s
        while True:
            change = self.watch(robot)
            queued = await self._store.read(agent_actions.waiting, robot)
            mine = any(agent_actions.meant_for(a, host, can) for a in queued if not a.answered)
            if mine and interlocked() is None:
                began_s = boot_s()
                taken = await self._store.write(take, robots=(robot,))
                if taken is not None and await self._still(taken, began_s):
                    return taken
            left = deadline - asyncio.get_running_loop().time()
            if left <= 0 or self._ending or anew() is not None:
                return None
            await wait_for(change, min(left, 5 * LOOK_AGAIN_S))

    async def _still(self, taken: AgentAction, began_s: float) -> bool:
        """Whether an action may be handed out that was taken since then.

        Whoever slept meanwhile asks again: it may have been withdrawn, handed out elsewhere, or stopped.
        """

        def still(view: View) -> bool:
            now = agent_actions.get(view, taken.id)
            given = (now.taken_by, now.taken_ns) == (taken.taken_by, taken.taken_ns)
            return given and now.code is None and not now.answered and not global_stop.get(view).active

        while boot_s() - began_s > SURE_S:
            began_s = boot_s()
            if self._stopped() or not await self._store.read(still):
                return False
        return True

    def _take(
        self,
        robot: str,
        host: str | None,
        agent: str,
        can: Collection[str] | None,
        by: Reporter,
        tx: Transaction,
    ) -> AgentAction | None:
        """Hand out an action, but none while the global stop is active: its owner withdraws what waits."""
        if self._stopped() or global_stop.hold(tx).active:
            return None
        waiting = {action.id for action in agent_actions.waiting(tx, robot) if action.taken_by is None}
        taken = agent_actions.take(tx, robot, host=host, agent=agent, can=can)
        if taken is not None and taken.id in waiting:  # else it has been told that it was taken
            tx.note(_noted(taken, by, "action.taken"))
        return taken

    async def feedback(self, action_id: str, code: int, message: str) -> None:
        """Note how far an action is; StateConflict after the result, also when that is a cancellation.

        The first one says that the agent has begun, and is on disk when this returns. Of the others the
        latest is told, at most every FEEDBACK_S, and nothing where it says the same again: agents repeat it
        to hear whether the action is withdrawn.
        """
        known = await self.action(action_id)
        said = (code, message[:MOST_FEEDBACK])
        if not known.answered or known.code is not None:
            await self._store.write(partial(_answer, action_id, said))
        elif self.said.get(action_id) != said:
            self._coming[action_id] = said
            self._telling.ask(action_id)

    async def _tell(self, action_id: str) -> None:
        said = self._coming.pop(action_id, None)
        if said is not None and self.said.get(action_id) != said:
            with contextlib.suppress(StateConflict):  # the result was faster
                await self._store.write(partial(_answer, action_id, said))

    async def finish(self, action_id: str, code: int, message: str, by: Reporter = OURSELVES) -> AgentAction:
        """Keep the agent's result; a second one gets the first. Its message says who gave it in its place."""
        said = message if by.own else f"{message} (said by {by.name} in the robot's place)".lstrip()

        def finish(tx: Transaction) -> AgentAction:
            first = agent_actions.get(tx, action_id).code is None
            action = agent_actions.finish(tx, action_id, code, said)
            if first:
                if by is not OURSELVES:
                    tx.note(_noted(action, by, "action.reported", message))
                tx.emit(Kind.ACTION, action.robot, describe(action))
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


def _noted(action: AgentAction, by: Reporter, what: str, message: str = "") -> AuditEntry:
    """Return the entry of the audit log about an action that an agent takes or reports."""
    after = {"action": action.id, "host": action.host, "result": action.code}
    after["in_place_of_the_robot"] = not by.own
    text = f"{action.name}({', '.join(action.parameters)})"
    return AuditEntry(by.name, what, text, action.robot, message, after=after)


def _answer(action_id: str, said: tuple[int, str], tx: Transaction) -> None:
    action = agent_actions.answer(tx, action_id)
    code, message = said
    feedback = {"code": code, "message": message, "time_ns": tx.now_ns}
    tx.emit(Kind.ACTION, action.robot, {**describe(action), "feedback": feedback})


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
