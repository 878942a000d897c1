"""The feed `board`: what the power board measures, asked of the service, which alone is connected to it."""

from __future__ import annotations

import asyncio
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from robomend_client.agent.feeds import AgentParts, Deliver
from robomend_client.bridges.fields import MissingField
from robomend_client.bridges.measured import is_board, measured, row_of
from robomend_client.bridges.problems import Problems
from robomend_client.observers import BOARD, Change, Contact
from robomend_client.python310 import end
from robomend_client.rest.asynchronous import AsyncClient
from robomend_client.rest.errors import ClientError
from robomend_client.rest.types import Board
from robomend_client.yaml_reader import Section

LATE_S = 1.0
"""A service that has not answered by then is not looked at."""


class ServiceBoard:
    """The feed. A measurement is delivered once; of a silent board hardware observers are told."""

    def __init__(self, section: Section, base: Path, sources: frozenset[str]) -> None:
        section.explain(rate_hz="how often the service is asked for what the board measures, per second")
        self.rate_hz = section.number("rate_hz", 2.0, least=0.1, most=20)
        for source in sorted(sources):
            if not is_board(source):
                known = "board, board:current(DEVICE) and board:voltage(DEVICE)"
                raise section.error("rate_hz", f"the board has {known}; an observer wants {source!r}")
        self.problems = Problems("the board")
        self._sources = tuple(sorted(sources))
        self._parts: AgentParts | None = None
        self._sees: bool | None = None
        self._handed_on: tuple[int, bool] | None = None

    def attach(self, parts: AgentParts) -> None:
        self._parts = parts

    def changed(self, changes: Sequence[Change]) -> None:
        """The board is told nothing."""

    async def run(self, deliver: Deliver) -> None:
        """Deliver until cancelled."""
        assert self._parts is not None
        client, robot = self._parts.client, self._parts.robot
        while True:
            try:
                board = await self._answer(client, robot, deliver)
            except ClientError as error:
                self.problems.tell("the service", f"it does not say what is measured: {error}"[:200])
                self._see(False, deliver)
            else:
                self.problems.over("the service")
                self._see(True, deliver)
                self._hand_on(board["time_ns"], board["channels"], deliver)
            await asyncio.sleep(1 / self.rate_hz)

    async def _answer(self, client: AsyncClient, robot: str, deliver: Deliver) -> Board:
        """Ask the service; while it takes long to answer, nobody looks."""
        task = asyncio.create_task(client.board(robot))
        try:
            await asyncio.wait({task}, timeout=LATE_S)
            if not task.done():
                self._see(False, deliver)
            return await task
        finally:
            await end([task])

    def _see(self, sees: bool, deliver: Deliver) -> None:
        """Tell observers whether the board is looked at."""
        if sees is not self._sees:
            self._sees = sees
            for source in self._sources:
                deliver(source, Contact.BACK if sees else Contact.LOST, None)

    def _hand_on(self, time_ns: int, channels: Sequence[Mapping[str, Any]], deliver: Deliver) -> None:
        """Deliver a measurement that is new."""
        rows = [row_of(channel) for channel in channels if channel["on"] is not None]
        if (time_ns, bool(rows)) == self._handed_on:
            return
        self._handed_on = time_ns, bool(rows)
        for source in self._sources:
            if not rows:
                deliver(source, None if source == BOARD else Contact.LOST, None)
                continue
            try:
                value = measured(source, rows)
            except MissingField as error:
                self.problems.tell(source, str(error))
            else:
                deliver(source, value, None)
