"""Action servers: what the agent can do, and the power board, for ROS nodes that ask for it.

    start_node, stop_node, …   the agent's executors, with their allow-list
    power_up, shutdown         the board's channels, through the service: its protection and its stop hold
    diagnosis_model_server     the model, model_server.py

Goals run side by side; one that comes with a known id is not run again. Nothing is served unless the file
says so: who reaches the robot's network may then ask for it.
"""

from __future__ import annotations

import asyncio
import logging
import time
from abc import ABC, abstractmethod
from collections import OrderedDict
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from robomend_client.actions import FAILED, OK, REFUSED, UNREACHABLE, Action, ActionResult, Feedback
from robomend_client.agent.feeds import AgentParts
from robomend_client.bridges.ros1 import formats
from robomend_client.bridges.ros1.action_topics import TO_CLIENT, TO_SERVER, GoalState, header, read
from robomend_client.bridges.ros1.node import RosNode
from robomend_client.bridges.ros1.publication import Describe
from robomend_client.bridges.ros1.subscription import Publisher
from robomend_client.python310 import end
from robomend_client.rest.errors import ApiError, ClientError

log = logging.getLogger(__name__)

POWER = {"power_up": True, "shutdown": False}
STATUS_S = 0.2
KEPT_S = 5.0
"""How long a goal that has ended is still listed, as actionlib does it."""

MOST_GOALS = 64
TIMEOUT_S = 60.0


@dataclass
class Goal:
    """One goal, from its arrival on."""

    id: str
    stamp: dict[str, int]
    state: GoalState = GoalState.ACTIVE
    text: str = ""
    ended_s: float | None = None
    task: asyncio.Task[None] | None = None

    @property
    def status(self) -> dict[str, object]:
        goal_id = {"stamp": self.stamp, "id": self.id}
        return {"goal_id": goal_id, "status": int(self.state), "text": self.text}


class GoalServer(ABC):
    """Serves one action: its goals, their states and results. Subclasses carry out."""

    types: Mapping[str, str]
    """Of what clients are told: status, feedback, result."""

    def __init__(
        self,
        node: RosNode,
        parts: AgentParts,
        name: str,
        topic: str,
        describe: Describe = formats.message_type,
    ) -> None:
        self._node = node
        self._parts = parts
        self._name = name
        self._goals: OrderedDict[str, Goal] = OrderedDict()
        node.subscribe(f"{topic}/goal", self._goal, keep=True)
        node.subscribe(f"{topic}/cancel", self._cancel, keep=True)
        self._out = {
            part: node.publish(f"{topic}/{part}", kind, describe) for part, kind in self.types.items()
        }

    @abstractmethod
    async def carry_out(self, goal: Goal, wanted: Any) -> tuple[ActionResult, Mapping[str, object] | None]:
        """Return how it went, and the fields of the result (None: its number); `wanted` is the goal."""

    def read_goal(self, publisher: Publisher, body: bytes) -> Any:
        """Return a goal's message, None if it is none."""
        return self._read(publisher, "goal", body)

    async def run(self) -> None:
        """Tell the states of the goals until cancelled; then give up what is under way."""
        try:
            while True:
                self._tell_states()
                await asyncio.sleep(STATUS_S)
        finally:
            await end([goal.task for goal in self._goals.values() if goal.task is not None])

    # --- what clients want -----------------------------------------------------------------------------

    def _goal(self, publisher: Publisher, body: bytes, _: int) -> None:
        message = self.read_goal(publisher, body)
        if message is None:
            return
        goal_id = message.goal_id
        stamp = {"sec": goal_id.stamp.sec, "nanosec": goal_id.stamp.nanosec}
        name = goal_id.id or f"{publisher.node}-{time.time_ns()}"
        if name in self._goals:
            return
        goal = Goal(name, stamp)
        self._goals[name] = goal
        if sum(g.ended_s is None for g in self._goals.values()) > MOST_GOALS:
            self._ended(goal, GoalState.REJECTED, ActionResult(REFUSED, f"{MOST_GOALS} goals are under way"))
            return
        goal.task = asyncio.create_task(self._carried_out(goal, message))

    def _cancel(self, publisher: Publisher, body: bytes, _: int) -> None:
        """Give up one goal; all of them without an id (those up to a time, where one is given)."""
        message = self._read(publisher, "cancel", body)
        if message is None:
            return
        until = (message.stamp.sec, message.stamp.nanosec)
        for goal in self._goals.values():
            since = (goal.stamp["sec"], goal.stamp["nanosec"])
            meant = goal.id == message.id if message.id else until == (0, 0) or since <= until
            if meant and goal.task is not None and goal.ended_s is None:
                goal.task.cancel()

    def _read(self, publisher: Publisher, part: str, body: bytes) -> Any:
        return read(self._node, f"{self._name}/{part}", TO_SERVER[part], publisher, body)

    async def _carried_out(self, goal: Goal, wanted: Any) -> None:
        try:
            result, value = await self.carry_out(goal, wanted)
        except asyncio.CancelledError:
            self._ended(goal, GoalState.PREEMPTED, ActionResult(FAILED, f"{self._name} was given up"))
            raise
        refused = GoalState.REJECTED if result.code == REFUSED else GoalState.ABORTED
        self._ended(goal, GoalState.SUCCEEDED if result.ok else refused, result, value)

    # --- what clients are told -------------------------------------------------------------------------

    def _ended(
        self,
        goal: Goal,
        state: GoalState,
        result: ActionResult,
        value: Mapping[str, object] | None = None,
    ) -> None:
        goal.state, goal.text, goal.ended_s = state, result.message, time.monotonic()
        log.info("ROS 1: %s → %s, %d %s", self._name, state.name.lower(), result.code, result.message)
        self.publish("result", {"status": goal.status, "result": value or {"result": result.code}})
        self._tell_states()

    def _tell_states(self) -> None:
        now_s = time.monotonic()
        for name in [
            n for n, g in self._goals.items() if g.ended_s is not None and now_s - g.ended_s > KEPT_S
        ]:
            del self._goals[name]
        self.publish("status", {"status_list": [goal.status for goal in self._goals.values()]})

    def publish(self, part: str, value: dict[str, object]) -> None:
        out = self._out[part]
        if out.wanted:
            out.publish(formats.encode(self.types[part], {"header": header(time.time_ns()), **value}))


class ActionServer(GoalServer):
    """Serves one of the agent's actions, or the board's, by its name."""

    types = TO_CLIENT

    async def carry_out(self, goal: Goal, wanted: Any) -> tuple[ActionResult, None]:
        action = Action(f"ros1:{goal.id}", self._name, tuple(map(str, wanted.goal.parameter)), TIMEOUT_S)
        log.info("ROS 1: %s is asked for", action)

        def feedback(number: int, message: str) -> None:
            goal.text = message
            self.publish("feedback", {"status": goal.status, "feedback": {"feedback": number}})

        if self._name in POWER:
            result = await self._switch(action, feedback)
        else:
            result = await self._parts.actions.run(action, feedback)
        return result, None

    async def _switch(self, action: Action, feedback: Feedback) -> ActionResult:
        """Switch a device's channel, as a person would."""
        robot, client = self._parts.robot, self._parts.client
        if len(action.parameters) != 1:
            return ActionResult(REFUSED, f"{action} needs one device")
        (device,) = action.parameters
        try:
            board = await client.board(robot)
            channels = [one["channel"] for one in board["channels"] if one["component"] == device]
            if not channels:
                return ActionResult(REFUSED, f"{device} is on no channel of the board")
            feedback(1, f"{action}: channel {channels[0]}")
            await client.switch_channel(robot, channels[0], POWER[action.name], "asked for by a ROS node")
        except ApiError as error:
            return ActionResult(REFUSED, f"{action}: {error}")
        except ClientError as error:
            return ActionResult(UNREACHABLE, f"{action}: {error}")
        return ActionResult(OK, f"{action} is done")
