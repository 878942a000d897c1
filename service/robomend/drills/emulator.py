"""The control port of an emulated power board, through which drills plant and clear the faults that it has.

A fault of the emulator lasts until it is cleared: it has no lease, so that the service alone undoes it.
Clearing what is not there does no harm.
"""

from __future__ import annotations

import asyncio
import json
from collections.abc import Callable, Mapping, Sequence
from typing import Any

from robomend.errors import RobomendError
from robomend.repairs.execution_values import Confirm
from robomend.repairs.stop_switch import StopSwitch
from robomend_client.actions import FAILED, OK, REFUSED, TIMED_OUT, UNREACHABLE, ActionResult

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
