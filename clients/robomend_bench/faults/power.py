"""The robot's power board: the project's emulator on a socket, its relays tied to the simulated devices.

    service ── TCP ──► emulator ──► relay moves ──► body: the device has power, or has not
    a fault of a relay ──► emulator: it opens, or sticks

A board hangs on one robot. What the service commands is told to `on_command`; what the bench does is not.
"""

from __future__ import annotations

from collections.abc import Callable

from robomend.board.codec import Code
from robomend_bench.faults.anatomy import Anatomy
from robomend_board.board import Board, ChannelState
from robomend_board.faults import Fault as BoardFault
from robomend_board.loads import Load, Rig, Supply
from robomend_board.server import Emulator

Command = Callable[[str, bool, int], None]
"""Device, on, and the board's answer: 0, or the code of its refusal."""


class RobotBoard:
    """One board; call `open` before anything else, `close` in the end."""

    def __init__(self, anatomy: Anatomy, on_relay: Callable[[str, bool], None], on_command: Command) -> None:
        self._devices = {d.channel: d.name for d in anatomy.devices.values() if d.channel is not None}
        self._channels = {name: channel for channel, name in self._devices.items()}
        self._on_relay = on_relay
        rig = Rig(Supply(), tuple(Load(steady_a=0.3) for _ in range(anatomy.channels)))
        self._board = _Told(rig, self._devices, on_command)
        self._emulator = Emulator(self._board)
        self._emulator.watchers.add(self._moved)

    async def open(self) -> int:
        """Listen on a free port of this computer and return it."""
        await self._emulator.listen("127.0.0.1", 0)
        return self._emulator.port

    async def close(self) -> None:
        """Drop the clients and close the port."""
        await self._emulator.close()

    def trip(self, device: str, *, for_ever: bool = False) -> None:
        """A relay opens by itself, and sticks if it is to be for ever."""
        channel = self._channels[device]
        self._board.ours = True
        try:
            self._emulator.switch(channel, False)
        finally:
            self._board.ours = False
        if for_ever:
            self._board.set_fault(BoardFault("stuck", channel), self._emulator.now_s())
            self._emulator.settle()

    def untrip(self, device: str) -> None:
        """It closes again by itself."""
        self._board.ours = True
        try:
            self._emulator.switch(self._channels[device], True)
        finally:
            self._board.ours = False

    def _moved(self, changed: dict[int, ChannelState]) -> None:
        for channel, state in changed.items():
            if channel in self._devices:
                self._on_relay(self._devices[channel], state.on)


class _Told(Board):
    """A board that tells what it is commanded."""

    def __init__(self, rig: Rig, devices: dict[int, str], on_command: Command) -> None:
        super().__init__(rig, on=devices)
        self.ours = False  # what moves now was moved by the bench
        self._named = devices
        self._on_command = on_command

    def switch(self, number: int, state: int, now_s: float) -> Code:
        code = super().switch(number, state, now_s)
        if not self.ours and number in self._named:
            self._on_command(self._named[number], bool(state), int(code))
        return code
