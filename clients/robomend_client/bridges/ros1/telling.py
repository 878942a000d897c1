"""What the robot is told: /observations, /diagnosis, /diagnostics and /board_measurments.

    /observations        what this agent's observers say: changes at once, all of it once a second
    /diagnosis           the service's diagnoses, while there is something wrong; silent when all is well
    /diagnostics         a status for each component, once a second
    /board_measurments   the power board's channels, once a second

The service's part is asked for only while somebody listens.
"""

from __future__ import annotations

import asyncio
import contextlib
import logging
from collections.abc import Mapping, Sequence
from typing import Any

from robomend_client.agent.feeds import AgentParts
from robomend_client.bridges.ros1 import formats
from robomend_client.bridges.ros1.node import RosNode
from robomend_client.bridges.ros1.publication import Publication
from robomend_client.observers import Change
from robomend_client.python310 import end, timeout
from robomend_client.rest.errors import ClientError

log = logging.getLogger(__name__)

PERIOD_S = 1.0
WAIT_S = 20.0
"""How long the service may hold back a diagnosis that has not changed."""

LOOK_S = 0.2

TYPES = {
    "observations": formats.OBSERVATIONS,
    "diagnosis": formats.DIAGNOSIS,
    "diagnostics": formats.DIAGNOSTICS,
    "board_measurments": formats.BOARD,
}


class Telling:
    """Publishes what it is asked to publish."""

    def __init__(self, node: RosNode, parts: AgentParts, topics: Mapping[str, str]) -> None:
        """`topics` are those of TYPES, each with its full name in ROS."""
        self._node = node
        self._parts = parts
        self._out: dict[str, Publication] = {
            name: node.publish(topic, TYPES[name], formats.message_type) for name, topic in topics.items()
        }
        self._result: Mapping[str, Any] | None = None
        self._why_none = "nothing is known yet"

    def changed(self, changes: Sequence[Change]) -> None:
        """Tell what this agent's observers have just found."""
        said = [str(change.value) for change in changes if change.value is not None]
        if said and self._wanted("observations"):
            self._out["observations"].publish(formats.observations(said, changes[0].time_ns))

    async def run(self) -> None:
        """Tell until cancelled."""
        work = [self._standing()]
        if self._out.keys() & {"diagnosis", "diagnostics"}:
            work += [self._diagnoses(), self._repeated()]
        if "board_measurments" in self._out:
            work.append(self._board())
        tasks = [asyncio.create_task(part) for part in work]
        try:
            await asyncio.gather(*tasks)
        finally:
            await end(tasks)

    def _wanted(self, *names: str) -> bool:
        return any(name in self._out and self._out[name].wanted for name in names)

    async def _standing(self) -> None:
        while True:
            if self._wanted("observations"):
                said = [str(verdict.literal) for verdict in self._parts.standing()]
                if said:
                    self._out["observations"].publish(formats.observations(said, self._parts.clock.now_ns()))
            await asyncio.sleep(PERIOD_S)

    # --- the service's part ----------------------------------------------------------------------------

    async def _diagnoses(self) -> None:
        """Keep the newest diagnosis at hand."""
        revision: int | None = None
        robot = self._parts.robot
        while True:
            if not self._wanted("diagnosis", "diagnostics"):
                revision = None
                await asyncio.sleep(LOOK_S)
                continue
            try:
                wait_s = None if revision is None else WAIT_S
                current = await self._parts.client.diagnosis(robot, wait_s=wait_s, after=revision)
            except ClientError as error:
                revision = None
                self._result, self._why_none = None, f"the service does not say: {error}"[:200]
                self._node.problems.tell("the service", self._why_none)
                await asyncio.sleep(PERIOD_S)
                continue
            self._node.problems.over("the service")
            if current["revision"] == revision:
                await asyncio.sleep(LOOK_S)
                continue
            revision = current["revision"]
            fault = current.get("fault")
            self._result = current.get("result")
            self._why_none = fault["detail"][:200] if fault else "nothing was observed yet"
            self._tell()

    async def _repeated(self) -> None:
        while True:
            await asyncio.sleep(PERIOD_S)
            self._tell()

    def _tell(self) -> None:
        now_ns = self._parts.clock.now_ns()
        result = self._result
        if self._wanted("diagnosis") and result is not None:
            diagnoses = result["diagnoses"]
            if any(one["bad"] for one in diagnoses):
                self._out["diagnosis"].publish(formats.diagnosis(diagnoses, now_ns))
        if self._wanted("diagnostics"):
            self._out["diagnostics"].publish(formats.diagnostics(result, self._why_none, now_ns))

    async def _board(self) -> None:
        while True:
            if self._wanted("board_measurments"):
                with contextlib.suppress(
                    ClientError, TimeoutError
                ):  # without a board there is nothing to tell
                    async with timeout(5.0):
                        board = await self._parts.client.board(self._parts.robot)
                    channels = [dict(channel) for channel in board["channels"]]
                    if any(channel["on"] is not None for channel in channels):
                        message = formats.board(channels, board["time_ns"])
                        self._out["board_measurments"].publish(message)
            await asyncio.sleep(PERIOD_S)
