"""power_up and shutdown by the power board; both are idempotent, a channel that is on stays on.

What came of it is seen in the board's measurements. After a power_up they are asked for at once: what follows
waits for nothing else. After a shutdown they come with the next broadcast: a device that is to begin anew
should be without power for a moment.
"""

from __future__ import annotations

import contextlib
from collections.abc import Mapping
from typing import Any, Protocol

from robomend.board.link import LinkState
from robomend.errors import BoardError, BoardRefused, BoardTimeout, BoardUnreachable
from robomend.repairs.execution_values import Confirm, nobodys
from robomend.repairs.executors.registry import Surroundings
from robomend_client.actions import (
    FAILED,
    OK,
    REFUSED,
    TIMED_OUT,
    UNREACHABLE,
    Action,
    ActionResult,
    Executor,
    Feedback,
)

SWITCHES = {"power_up": True, "shutdown": False}
"""The domain's actions that a board carries out -> the channel's new state."""

CONNECT_S = 2.0
"""How long an action waits for a link that is just coming up."""

LOOK_S = 1.0
"""How long measurements that were asked for are waited for; without them the next broadcast tells."""


class Switch(Protocol):
    """What this executor needs of a board link."""

    state: LinkState

    async def wait_connected(self, timeout_s: float) -> None: ...

    async def switch(self, channel: int, on: bool, timeout_s: float | None = None) -> None: ...

    async def request(self, timeout_s: float | None = None) -> object: ...


def make(action: str, options: Mapping[str, Any], around: Surroundings) -> Executor | None:
    """Return the robot's power board for what that can do, if it has one (see registry.MakeExecutor)."""
    board = around.board
    if board is None or action not in SWITCHES:
        return None
    channels = {name: channel for channel, name in board.components.items()}
    return BoardExecutor(board.link, channels, board.protected, around.confirm)


class BoardExecutor:
    """Switches the channels of one robot's board. Protected channels are never switched off, whoever asks."""

    def __init__(
        self,
        link: Switch,
        channels: Mapping[str, int],
        protected: Mapping[int, str],
        confirm: Confirm = nobodys,
    ) -> None:
        """
        Args:
            channels: hardware name -> channel, from 0.
            protected: channel -> why it stays on.
            confirm: see robomend.repairs.execution_values.
        """
        self._confirm = confirm
        self._link = link
        self._channels = dict(channels)
        self._protected = protected

    async def execute(self, action: Action, feedback: Feedback) -> ActionResult:
        on = SWITCHES.get(action.name)
        if on is None or len(action.parameters) != 1:
            return ActionResult(REFUSED, f"a power board cannot do {action}")
        channel = self._channels.get(action.parameters[0])
        if channel is None:
            return ActionResult(REFUSED, f"{action.parameters[0]} has no channel on this board")
        if not on and channel in self._protected:
            return ActionResult(
                REFUSED, f"channel {channel} ({action.parameters[0]}) stays on: {self._protected[channel]}"
            )
        if self._link.state is not LinkState.CONNECTED:
            feedback(0, f"the board's link is {self._link.state}; waiting for it")
        try:
            await self._link.wait_connected(min(CONNECT_S, action.timeout_s))
            await self._confirm()
            await self._link.switch(channel, on, action.timeout_s)
        except BoardRefused as error:  # a faulty channel, a channel that it does not have
            return ActionResult(REFUSED, str(error))
        except BoardTimeout as error:
            return ActionResult(TIMED_OUT, str(error))
        except BoardUnreachable as error:
            return ActionResult(UNREACHABLE, str(error))
        except BoardError as error:
            return ActionResult(FAILED, str(error))
        if on:
            with contextlib.suppress(BoardError):  # it has switched, whether or not it can be asked
                await self._link.request(LOOK_S)
        return ActionResult(OK, f"channel {channel} is {'on' if on else 'off'}")
