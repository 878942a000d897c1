"""Actions over ROS 1's actionlib, both ways, and its words: five topics an action, and the states of a goal.

    NAME/goal, NAME/cancel            client → server
    NAME/status, /feedback, /result   server → client

Goals are those of the published system: a list of strings, an integer result, integer feedback.

The kind `ros_action`: an action server of the robot carries the action out. A server that is not there did
not act; of one that went away in the middle, nobody knows.

    calibrate: {kind: ros_action, server: /arm/calibrate, parameters: {arm: [left, right]}, gives_up: true}

Action servers of ours: what other nodes may ask for. Goals run side by side; one that comes with a known id
is not run again. Nothing is served unless the file says so: who reaches the robot's network may then ask.

    start_node, stop_node, …   the agent's executors, with their allow-list
    power_up, shutdown         the board's channels, through the service: its protection and its stop hold
    diagnosis_model_server     the model
"""

from __future__ import annotations

import asyncio
import contextlib
import logging
import time
import uuid
from abc import ABC, abstractmethod
from collections import OrderedDict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from enum import IntEnum
from typing import Any

from robomend_client.actions import (
    CANCELLED,
    FAILED,
    OK,
    REFUSED,
    TIMED_OUT,
    UNREACHABLE,
    Action,
    ActionResult,
    Feedback,
)
from robomend_client.agent.feeds import AgentParts
from robomend_client.bridges.fields import UnreadableMessage
from robomend_client.bridges.ros1 import formats
from robomend_client.bridges.ros1.messages import MessageReaders
from robomend_client.bridges.ros1.node import RosNode
from robomend_client.bridges.ros1.publication import Describe, MessageType, Publication, never_said
from robomend_client.bridges.ros1.subscription import Publisher
from robomend_client.python310 import end, timeout
from robomend_client.rest.errors import ApiError, ClientError

log = logging.getLogger(__name__)

TO_SERVER = {"goal": formats.GOAL, "cancel": formats.CANCEL}
TO_CLIENT = {"status": formats.STATUSES, "feedback": formats.FEEDBACK, "result": formats.RESULT}


class GoalState(IntEnum):
    PENDING = 0
    ACTIVE = 1
    PREEMPTED = 2
    SUCCEEDED = 3
    ABORTED = 4
    REJECTED = 5
    PREEMPTING = 6
    RECALLING = 7
    RECALLED = 8
    LOST = 9


def header(time_ns: int) -> dict[str, object]:
    return {"stamp": formats.stamp(time_ns)}


def read(node: RosNode, topic: str, expected: str, publisher: Publisher, body: bytes) -> Any:
    """Return a message of one of the five topics; None, and told once, if it is none of the expected type."""
    place = f"{topic} by {publisher.node}"
    if publisher.md5 != formats.message_type(expected).md5:
        node.problems.tell(place, f"{publisher.type} is no {expected}; it is not heard")
        return None
    try:
        return formats.decode(expected, body)
    except Exception as error:  # noqa: BLE001  # anybody's bytes
        node.problems.tell(place, f"cannot be read: {error}"[:200])
        return None


CONNECT_S = 5.0
LOOK_S = 0.05
GONE_S = 2.0
"""A server whose connection was lost for so long will not answer."""


class RosAction:
    """Asks one action server."""

    def __init__(
        self, name: str, server: str, parameters: Mapping[str, Sequence[str]], gives_up: bool = False
    ) -> None:
        """
        Args:
            name: the action, as the plan has it; by default the entry's name.
            server: the action server's full name.
            parameters: name → what it may be, in the order in which the goal has them.
            gives_up: whether a goal that is cancelled leaves things as they were.
        """
        if not server.strip("/"):
            raise ValueError("server must be the name of an action server")
        self.name = name
        self.gives_up = gives_up
        self.parameters = tuple(tuple(values) for values in parameters.values())
        self.server = "/" + server.strip("/")
        self._out: dict[str, Publication] = {}
        self._node: RosNode | None = None
        self._links = 0  # connections by which results and feedback come
        self._waiting: dict[str, tuple[asyncio.Future[ActionResult], Feedback]] = {}

    def attach(self, node: RosNode) -> None:
        """Be a client of this node's."""
        self._node = node
        self._out = {
            part: node.publish(f"{self.server}/{part}", kind, formats.message_type)
            for part, kind in TO_SERVER.items()
        }
        node.subscribe(f"{self.server}/result", self._result, keep=True, on_link=self._link)
        node.subscribe(f"{self.server}/feedback", self._feedback, keep=True, on_link=self._link)

    async def execute(self, action: Action, feedback: Feedback) -> ActionResult:
        if self._node is None:
            return ActionResult(UNREACHABLE, f"{action}: the agent's file has no section ros1")
        try:
            async with timeout(CONNECT_S):
                while not (self._out["goal"].wanted and self._links >= 2):
                    await asyncio.sleep(LOOK_S)
        except TimeoutError:
            return ActionResult(UNREACHABLE, f"{action}: there is no action server {self.server}")
        goal_id = {"id": f"{self._node.name}-{uuid.uuid4().hex}", "stamp": formats.stamp(time.time_ns())}
        name = str(goal_id["id"])
        result: asyncio.Future[ActionResult] = asyncio.get_running_loop().create_future()
        self._waiting[name] = (result, feedback)
        feedback(1, f"{action}: {self.server} is asked")
        goal = {"header": header(time.time_ns()), "goal_id": goal_id}
        parameters = {"parameter": list(action.parameters)}
        self._out["goal"].publish(formats.encode(formats.GOAL, {**goal, "goal": parameters}))
        try:
            return await self._answer(action, result)
        except asyncio.CancelledError:
            with contextlib.suppress(ValueError):
                self._out["cancel"].publish(formats.encode(formats.CANCEL, {"id": name}))
            raise
        finally:
            del self._waiting[name]

    async def _answer(self, action: Action, result: asyncio.Future[ActionResult]) -> ActionResult:
        gone_s = 0.0
        while gone_s < GONE_S:
            await asyncio.wait({result}, timeout=LOOK_S)
            if result.done():
                return result.result()
            gone_s = 0.0 if self._out["goal"].wanted else gone_s + LOOK_S
        return ActionResult(TIMED_OUT, f"{action}: {self.server} went away; whether it acted is unknown")

    def _link(self, _: Publisher, stands: bool) -> None:
        self._links += 1 if stands else -1

    # --- what the server says --------------------------------------------------------------------------

    def _result(self, publisher: Publisher, body: bytes, _: int) -> None:
        message = self._read(publisher, "result", body)
        waiting = None if message is None else self._waiting.get(message.status.goal_id.id)
        if message is None or waiting is None or waiting[0].done():
            return
        code, text = int(message.result.result), str(message.status.text)
        state = GoalState(message.status.status) if message.status.status < 10 else GoalState.LOST
        said = f"{self.server}: {state.name.lower()}, {code} {text}".rstrip()
        if state is GoalState.SUCCEEDED:
            found = ActionResult(code, said)
        elif state in (GoalState.PREEMPTED, GoalState.RECALLED):
            found = ActionResult(CANCELLED, said)
        else:
            found = ActionResult(REFUSED if state is GoalState.REJECTED else code or FAILED, said)
        waiting[0].set_result(found)

    def _feedback(self, publisher: Publisher, body: bytes, _: int) -> None:
        message = self._read(publisher, "feedback", body)
        waiting = None if message is None else self._waiting.get(message.status.goal_id.id)
        if message is not None and waiting is not None:
            number = int(message.feedback.feedback)
            waiting[1](number, f"{self.server}: {number} {message.status.text}".rstrip())

    def _read(self, publisher: Publisher, part: str, body: bytes) -> Any:
        assert self._node is not None
        return read(self._node, f"{self.server}/{part}", TO_CLIENT[part], publisher, body)


# --- action servers of ours --------------------------------------------------------------------------------

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


MODEL_SERVER = "diagnosis_model_server"
MODEL_TOPIC = "diagnosis_model"
MODEL_KEYS = ("ab", "nab", "neg_prefix", "rules", "props")


class ModelServer(GoalServer):
    """Serves the model that the robot follows, as propositions and clauses; the service is asked each time.

    A goal of any text gets it as the result, and whoever listens to /diagnosis_model, too, as with the
    published system's model server; its engine asks for it so.
    """

    types = {  # noqa: RUF012  # as the base says
        "status": formats.STATUSES,
        "feedback": formats.MODEL_FEEDBACK,  # nothing is ever said there
        "result": formats.MODEL_RESULT,
    }

    def __init__(self, node: RosNode, parts: AgentParts, name: str, topic: str) -> None:
        super().__init__(node, parts, name, topic, _model_type)
        self._readers = MessageReaders()
        told = f"{topic.rpartition('/')[0]}/{MODEL_TOPIC}"
        self._model = node.publish(told, formats.MODEL, formats.message_type, latched=True)

    def read_goal(self, publisher: Publisher, body: bytes) -> Any:
        """Return a goal, by its sender's definition: of what it wants, only that it wants it counts."""
        place = f"{self._name}/goal by {publisher.node}"
        try:
            message = self._readers.open(publisher, body)
            for field in ("id", "stamp.sec", "stamp.nanosec"):
                message.at(f"goal_id.{field}")
        except UnreadableMessage as error:
            self._node.problems.tell(place, f"{publisher.type} is no goal: {error}")
            return None
        return message.whole()

    async def carry_out(self, goal: Goal, wanted: Any) -> tuple[ActionResult, Mapping[str, object] | None]:
        try:
            found = await self._parts.client.followed_model(self._parts.robot)
        except ApiError as error:
            return ActionResult(REFUSED, f"{self._name}: {error}"), None
        except ClientError as error:
            return ActionResult(UNREACHABLE, f"{self._name}: {error}"), None
        value = {key: dict(found)[key] for key in MODEL_KEYS}
        if self._model.wanted:
            self._model.publish(formats.encode(formats.MODEL, value))
        return ActionResult(OK, f"the model {found['model']}, {len(found['rules'])} clauses"), value


def _model_type(name: str) -> MessageType:
    return never_said(name) if name == formats.MODEL_FEEDBACK else formats.message_type(name)
