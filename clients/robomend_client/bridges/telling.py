"""What the robot is told: /observations, /diagnosis, /diagnostics and /board_measurments.

    /observations        what this agent's observers say: changes at once, all of it once a second
    /diagnosis           the service's diagnoses, at once and then once a second
    /diagnostics         a status for each component, once a second
    /board_measurments   the power board's channels, once a second

How that looks is the bridge's own: ToldTopic. The service's part is asked for only while somebody listens.
"""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Protocol

from robomend_client.agent.feeds import AgentParts
from robomend_client.beats import beat
from robomend_client.bridges.problems import Problems
from robomend_client.observers import Change
from robomend_client.python310 import end, timeout
from robomend_client.rest.errors import ClientError

# --- a diagnosis as diagnostic statuses, for the aggregators of ROS: one for each component.
#
#     ERROR   bad in every diagnosis        OK      bad in none
#     WARN    bad in some, or others may be found that do not blame it
#
# Without a diagnosis there is one STALE status, which says why.

OK, WARN, ERROR, STALE = range(4)
MOST_STATUSES = 1000


def statuses(result: Mapping[str, Any] | None, why_none: str) -> list[dict[str, Any]]:
    """Return the statuses, each with the fields of a DiagnosticStatus."""
    if result is None:
        return [{"level": STALE, "name": "robomend", "message": why_none, "hardware_id": "", "values": []}]
    return [_status(name, result) for name in _components(result)][:MOST_STATUSES]


def _components(result: Mapping[str, Any]) -> list[str]:
    found = {name for one in result["diagnoses"] for name in (*one["bad"], *one["good"])}
    return sorted(found)


def _status(name: str, result: Mapping[str, Any]) -> dict[str, Any]:
    diagnoses = result["diagnoses"]
    blaming = [one for one in diagnoses if name in one["bad"]]
    values = {}
    if not blaming:
        level, message = OK, "works"
    else:
        certain = len(blaming) == len(diagnoses) and result.get("complete", False)
        level, message = (ERROR, "broken") if certain else (WARN, "perhaps broken")
        values["in diagnoses"] = f"{len(blaming)} of {len(diagnoses)}"
        values |= {
            f"diagnosis {n}": one.get("text") or ", ".join(one["bad"]) for n, one in enumerate(blaming[:5], 1)
        }
        because = [c.get("text", "") for c in result.get("conflicts", ()) if name in c["components"]]
        values |= {f"because {n}": text for n, text in enumerate(because[:5], 1) if text}
    return {
        "level": level,
        "name": f"robomend: {name}",
        "message": message,
        "hardware_id": name,
        "values": [{"key": key, "value": value} for key, value in values.items()],
    }


PERIOD_S = 1.0
WAIT_S = 20.0
"""How long the service may hold back a diagnosis that has not changed."""

LOOK_S = 0.2


class Outgoing(Protocol):
    """A topic of the robot on which we publish."""

    @property
    def wanted(self) -> bool:
        """Whether anybody listens."""
        ...

    def publish(self, message: bytes) -> None:
        """Send a message to all who listen."""


@dataclass(frozen=True)
class ToldTopic:
    """Where something is told, and in which words.

    `message` gets for observations the literals, for diagnosis the result, for diagnostics the result or None
    and why there is none, for board_measurments the channels; and the time. None: there is nothing to tell.
    """

    publication: Outgoing
    message: Callable[..., bytes | None]


class Telling:
    """Publishes what it is asked to publish."""

    def __init__(self, parts: AgentParts, problems: Problems, topics: Mapping[str, ToldTopic]) -> None:
        """`topics` by what is told there: observations, diagnosis, diagnostics, board_measurments."""
        self._parts = parts
        self._problems = problems
        self._out = topics
        self._result: Mapping[str, Any] | None = None
        self._why_none = "nothing is known yet"

    def changed(self, changes: Sequence[Change]) -> None:
        """Tell what this agent's observers have just found."""
        said = [str(change.value) for change in changes if change.value is not None]
        if said and self._wanted("observations"):
            self._say("observations", said, changes[0].time_ns)

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
        return any(name in self._out and self._out[name].publication.wanted for name in names)

    def _say(self, name: str, *what: Any) -> None:
        topic = self._out[name]
        message = topic.message(*what)
        if message is not None:
            topic.publication.publish(message)

    async def _standing(self) -> None:
        while True:
            if self._wanted("observations"):
                said = [str(verdict.literal) for verdict in self._parts.standing()]
                if said:
                    self._say("observations", said, self._parts.clock.now_ns())
            await beat(PERIOD_S)

    # --- the service's part ----------------------------------------------------------------------------

    async def _diagnoses(self) -> None:
        """Keep the newest diagnosis at hand."""
        revision: int | None = None
        robot = self._parts.robot
        while True:
            if not self._wanted("diagnosis", "diagnostics"):
                revision = None
                await beat(LOOK_S)
                continue
            try:
                wait_s = None if revision is None else WAIT_S
                current = await self._parts.client.diagnosis(robot, wait_s=wait_s, after=revision)
            except ClientError as error:
                revision = None
                self._result, self._why_none = None, f"the service does not say: {error}"[:200]
                self._problems.tell("the service", self._why_none)
                await beat(PERIOD_S)
                continue
            self._problems.over("the service")
            if current["revision"] == revision:
                await beat(LOOK_S)
                continue
            revision = current["revision"]
            fault = current.get("fault")
            self._result = current.get("result")
            self._why_none = fault["detail"][:200] if fault else "nothing was observed yet"
            self._tell()

    async def _repeated(self) -> None:
        while True:
            await beat(PERIOD_S)
            self._tell()

    def _tell(self) -> None:
        now_ns = self._parts.clock.now_ns()
        result = self._result
        if self._wanted("diagnosis") and result is not None:
            self._say("diagnosis", result, now_ns)
        if self._wanted("diagnostics"):
            self._say("diagnostics", result, self._why_none, now_ns)

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
                        self._say("board_measurments", channels, board["time_ns"])
            await beat(PERIOD_S)
