"""The kind `ros_action`: an action server of the robot carries the action out.

    calibrate: {kind: ros_action, server: /arm/calibrate, parameters: {arm: [left, right]}, gives_up: true}

The goal is the list of parameters; the server's integer result is the action's. A server that is not there
did not act; of one that went away in the middle, nobody knows.
"""

from __future__ import annotations

import asyncio
import contextlib
import time
import uuid
from collections.abc import Mapping, Sequence
from typing import Any

from robomend_client.actions import (
    CANCELLED,
    FAILED,
    REFUSED,
    TIMED_OUT,
    UNREACHABLE,
    Action,
    ActionResult,
    Feedback,
)
from robomend_client.bridges.ros1 import formats
from robomend_client.bridges.ros1.action_topics import TO_CLIENT, TO_SERVER, GoalState, header, read
from robomend_client.bridges.ros1.node import RosNode
from robomend_client.bridges.ros1.publication import Publication
from robomend_client.bridges.ros1.subscription import Publisher
from robomend_client.python310 import timeout

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
