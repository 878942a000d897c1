"""Who plants a fault and undoes it: the agent that has the node or the bus, the power board, or a person.

An undo may be asked for again and again, also of what was never planted: it then finds nothing to do.
"""

from __future__ import annotations

import asyncio
import contextlib
import json
from collections.abc import Awaitable, Callable, Mapping, Sequence
from typing import Any, Protocol

from robomend.errors import BoardTimeout, BoardUnreachable, NotFound, Refused, RobomendError
from robomend.planning.faults import FaultKind
from robomend.repairs.agent_queue import AgentQueue
from robomend.repairs.execution_values import Confirm
from robomend.repairs.executors.agent import AgentExecutor
from robomend.repairs.stop_switch import StopSwitch
from robomend.robots.boards import WiredBoard
from robomend.store.records import Fence
from robomend_client.actions import (
    FAILED,
    LEASES_S,
    OK,
    REFUSED,
    TIMED_OUT,
    UNREACHABLE,
    Action,
    ActionResult,
)

ACT_S = 10.0
"""For planting: an agent asks for work all the time."""

UNDO_S = 30.0
"""For one try to undo; a node may take its time to start."""

BEYOND_S = 30.0
"""An agent's lease is longer than the drill's bound by this, so that the service undoes first."""


class Hand(Protocol):
    """See the module."""

    async def plant(self, action: str) -> ActionResult:
        """Plant the fault; REFUSED and UNREACHABLE say that nothing was planted."""
        ...

    async def undo(self, action: str) -> ActionResult:
        """Undo it. UNDONE_BEFORE: it was not there (any more)."""
        ...


class AgentsHand:
    """The agent that supervises a node, or has the bus of a topic."""

    def __init__(
        self,
        agents: AgentQueue,
        robot: str,
        host: str | None,
        kind: FaultKind,
        target: str,
        bound_s: float,
        halt: asyncio.Event,
        fence: Fence,
    ) -> None:
        self._agents = agents
        self._executor = AgentExecutor(agents, robot, {target: host}, halt, fence)
        self._target, self._kind = target, str(kind)
        self._lease_s = next((s for s in LEASES_S if s >= bound_s + BEYOND_S), LEASES_S[-1])

    async def plant(self, action: str) -> ActionResult:
        what = (self._target, self._kind, str(self._lease_s))
        return await self._executor.execute(Action(action, "plant_fault", what, ACT_S), _unheard)

    async def undo(self, action: str) -> ActionResult:
        # One that waits since before a crash must not be taken after the undo.
        with contextlib.suppress(NotFound):
            await self._agents.withdraw(f"{action.partition(':')[0]}:plant", "it is to be undone")
        what = (self._target, self._kind)
        return await self._executor.execute(Action(action, "undo_fault", what, UNDO_S), _unheard)


class BoardsHand:
    """The power board: off and on."""

    def __init__(
        self,
        board: WiredBoard,
        channel: int,
        switch: StopSwitch,
        interlocked: Callable[[], str | None],
        drill: str,
        confirm: Confirm,
    ) -> None:
        self._confirm = confirm
        self._board, self._channel, self._switch, self._drill = board, channel, switch, drill
        self._interlocked = interlocked

    async def plant(self, action: str) -> ActionResult:
        return await self._set(False)

    async def undo(self, action: str) -> ActionResult:
        return await self._set(True)

    async def _set(self, on: bool) -> ActionResult:
        try:
            await self._board.switch(
                self._channel,
                on,
                stop=lambda: self._switch.stop,
                interlocked=self._interlocked,
                by="robomend",
                reason=f"drill {self._drill}",
                confirm=self._confirm,
            )
        except Refused as error:
            return ActionResult(REFUSED, str(error))
        except BoardUnreachable as error:
            return ActionResult(UNREACHABLE, str(error))
        except BoardTimeout as error:
            return ActionResult(TIMED_OUT, str(error))
        except RobomendError as error:
            return ActionResult(FAILED, f"{error.code}: {error}")
        return ActionResult(OK, f"channel {self._channel} is {'on' if on else 'off'}")


class PersonsHand:
    """A person, who says `done`; how long that takes is up to them, within the drill's bound at first."""

    def __init__(self, wait: Callable[[str], Awaitable[bool]], act: str, undo: str) -> None:
        self._wait, self._act, self._undo = wait, act, undo

    async def plant(self, action: str) -> ActionResult:
        done = await self._wait(self._act)
        return ActionResult(OK if done else TIMED_OUT, "" if done else f"nobody said `done`: {self._act}")

    async def undo(self, action: str) -> ActionResult:
        done = await self._wait(self._undo)
        return ActionResult(OK if done else TIMED_OUT, "" if done else f"nobody said `done`: {self._undo}")


def _unheard(number: int, message: str) -> None:
    """What an agent says on the way is in its action's events."""


# --- the control port of an emulated power board, through which drills plant and clear its faults.
#
# A fault of the emulator lasts until it is cleared: it has no lease, so that the service alone undoes it.
# Clearing what is not there does no harm.

ANSWER_S = 5.0

MOST_BYTES = 1 << 16
"""Of one answer."""

DRIVEN_OFF = frozenset({"stuck", "short"})
"""These leave their channel off, also when they are cleared."""


class EmulatorsHand:
    """Plants and clears one fault of an emulated board."""

    def __init__(
        self,
        host: str,
        control_port: int,
        fault: str,
        channel: int | None,
        switch: StopSwitch,
        interlocked: Callable[[], str | None],
        confirm: Confirm,
    ) -> None:
        """`confirm` is awaited right before something is sent, and raises where another instance has it."""
        self._host, self._port = host, control_port
        self._fault, self._channel = fault, channel
        self._switch, self._interlocked, self._confirm = switch, interlocked, confirm

    async def plant(self, action: str) -> ActionResult:
        """Let the board have the fault."""
        asked: dict[str, Any] = {"fault": self._fault, **self._where()}
        if self._fault == "stuck":
            asked["at"] = "off"  # where it is, nobody would notice
        # It refuses new connections only: that of the service would stay.
        cut = [{"fault": "drop"}] if self._fault == "refuse" else []
        return await self._ask([asked, *cut])

    async def undo(self, action: str) -> ActionResult:
        """Clear the fault, and switch the channel on where it took that with it."""
        on = [{"set": {"channel": self._channel, "on": True}}] if self._fault in DRIVEN_OFF else []
        return await self._ask([{"clear": self._fault, **self._where()}, *on])

    def _where(self) -> dict[str, int]:
        return {} if self._channel is None else {"channel": self._channel}

    async def _ask(self, requests: Sequence[Mapping[str, Any]]) -> ActionResult:
        try:
            if (why := self._interlocked()) is not None:
                return ActionResult(REFUSED, why)
            await self._confirm()
        except RobomendError as error:
            return ActionResult(FAILED, f"{error.code}: {error}")
        at = f"the control port {self._host}:{self._port}"
        try:
            async with asyncio.timeout(ANSWER_S):
                reader, writer = await asyncio.open_connection(self._host, self._port, limit=MOST_BYTES)
        except (OSError, TimeoutError) as error:
            return ActionResult(UNREACHABLE, f"{at}: {str(error) or 'no answer'}")
        try:
            async with asyncio.timeout(ANSWER_S):
                for request in requests:
                    if self._switch.active:  # it may have come in the meantime
                        return ActionResult(TIMED_OUT, "the global stop")
                    writer.write(json.dumps(request).encode() + b"\n")
                    answer = json.loads(await reader.readline() or b"{}")
                    if not isinstance(answer, dict) or answer.get("ok") is not True:
                        why = answer.get("error") if isinstance(answer, dict) else answer
                        return ActionResult(FAILED, f"{at}: {json.dumps(request)}: {why or 'it hung up'}")
        except (OSError, ValueError, TimeoutError) as error:  # whether it acted is not known
            return ActionResult(TIMED_OUT, f"{at}: {str(error) or 'no answer'}")
        finally:
            writer.close()
        return ActionResult(OK, f"{self._fault}: done by {at}")
