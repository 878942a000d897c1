"""A service as a process that a test may kill, and a robot that reaches it, or several of it, over HTTP.

The robot is what a real one is: it reports for ever, pulls actions, says when it begins, takes time, and
carries out an id once. It keeps a log of what a person standing beside it would complain about.
"""

from __future__ import annotations

import asyncio
import json
import random
import signal
import subprocess
import sys
import time
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from tests.forked import popen
from tests.repairs.robot import CONFIG, MODEL, Robot
from tests.waiting import look_s

from robomend_client.actions import OK, ActionResult
from robomend_client.rest import NEVER, ApiError, AsyncClient, ClientError

ROOT = Path(__file__).parents[2]


@dataclass
class ServiceProcess:
    """`robomend serve` as a process; `start` again after `kill`."""

    arguments: tuple[str, ...]
    process: subprocess.Popen[str] | None = None
    client: AsyncClient | None = None
    url: str = ""  # once it was started

    async def start(self) -> None:
        """Start it and wait until it says its address."""
        self.process = process = popen(
            [sys.executable, "-m", "robomend", "serve", "--port", "0", "--announce", *self.arguments],
            cwd=ROOT,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            text=True,
        )
        async with asyncio.timeout(120):
            line = await asyncio.to_thread(process.stdout.readline)
        assert line, "the service did not start"
        self.url = json.loads(line)["url"]
        self.client = AsyncClient(self.url, retry=NEVER, timeout_s=30.0)

    async def kill(self) -> None:
        """kill -9."""
        await self._end(signal.SIGKILL)

    async def stop(self) -> None:
        """End it as an init system does."""
        await self._end(signal.SIGTERM)

    async def _end(self, how: signal.Signals) -> None:
        if self.process is not None and self.process.returncode is None:
            self.process.send_signal(how)
            await asyncio.to_thread(self.process.wait, 60)
            assert self.process.stdout is not None
            self.process.stdout.close()
        client, self.client = self.client, None  # first, so that nobody uses one that is being closed
        if client is not None:
            await client.close()


@dataclass
class RemoteRobot(Robot):
    """A robot that talks to whichever of the services answers, each in turn."""

    services: list[ServiceProcess] = field(default_factory=list)
    acts_s: tuple[float, float] = (0.02, 0.12)  # how long an action takes
    complaints: list[str] = field(default_factory=list)
    acknowledged: int = 0  # observations
    _turn: int = 0
    _busy: set[str] = field(default_factory=set)
    _results: dict[str, asyncio.Future[int]] = field(default_factory=dict)
    _works: set[asyncio.Task[None]] = field(default_factory=set)

    def _next(self) -> AsyncClient | None:
        alive = [service.client for service in self.services if service.client is not None]
        self._turn += 1
        return alive[self._turn % len(alive)] if alive else None

    async def report(self) -> None:
        client = self._next()
        if client is not None and not self.silent:
            await client.observe("r1", self.sentences(), source="robot")
            self.acknowledged += 1

    async def settled(self) -> None:
        """Wait until the service has diagnosed the robot as it is now."""
        await self.report()
        client = self._next()
        assert client is not None
        await client.diagnosis("r1")

    async def report_for_ever(self) -> None:
        while True:
            await _whatever(self.report())
            await asyncio.sleep(0.05)

    async def act_for_ever(self) -> None:
        while True:
            client = self._next()
            if client is None:
                await asyncio.sleep(0.02)
                continue
            action = await _whatever(client.next_action("r1", "agent", wait_s=1.0))
            if action is None:
                await asyncio.sleep(0.01)
            elif action.id not in self._results and await self._begin(client, action.id):
                self._results[action.id] = asyncio.get_running_loop().create_future()
                task = asyncio.create_task(self._work(action.id, action.name, action.parameters[0]))
                self._works.add(task)
                task.add_done_callback(self._works.discard)

    async def _begin(self, client: AsyncClient, action_id: str) -> bool:
        """Say that we begin: only who hears us may believe that it acted."""
        try:
            await client.give_feedback(action_id, 0, "begun")
        except (ClientError, RuntimeError):
            return False  # withdrawn, or nobody heard: then it is handed out again
        return True

    async def _work(self, action_id: str, name: str, parameter: str) -> None:
        self.ids.append(action_id)
        if parameter in self._busy:
            self.complaints.append(f"{action_id} {name}({parameter}) while another acts on {parameter}")
        if self.is_there(name, parameter):
            self.complaints.append(f"{action_id} {name}({parameter}) was there already")
        self._busy.add(parameter)
        await asyncio.sleep(random.uniform(*self.acts_s))  # an action takes time
        code = await self.spoil(self, name, parameter) if self.spoil else None
        if code is None:
            self.do(name, parameter)
        self.done.append(f"{name}({parameter})")
        self._busy.discard(parameter)
        while not await self._told(action_id, code or OK):
            await asyncio.sleep(0.05)

    async def _told(self, action_id: str, code: int) -> bool:
        client = self._next()
        if client is None:
            return False
        try:
            await client.give_result(action_id, ActionResult(code))
        except ApiError as error:
            return error.status < 500
        except (ClientError, RuntimeError):
            return False
        return True

    def is_there(self, name: str, parameter: str) -> bool:
        """Whether what an action is for is so already."""
        if name in {"plant_fault", "undo_fault"}:
            return self.running[parameter] is (name == "undo_fault")
        if name in {"power_up", "shutdown"}:
            return self.on[parameter] is (name == "power_up")
        return self.running[parameter] is (name == "start_node")

    async def rest(self) -> None:
        """Wait until nothing is being done."""
        while self._works:
            await asyncio.wait(self._works)


async def _whatever(call: Any) -> Any:
    """Return the answer, or None when the service is gone."""
    try:
        return await call
    except (ClientError, RuntimeError):  # httpx: a client that was closed meanwhile
        return None


@asynccontextmanager
async def services(*arguments: tuple[str, ...]) -> AsyncIterator[list[ServiceProcess]]:
    """Run a service for each list of arguments; all are gone afterwards."""
    started = [ServiceProcess(each) for each in arguments]
    try:
        for service in started:
            await service.start()
        yield started
    finally:
        for service in started:
            await service.kill()


@asynccontextmanager
async def remote_robot(running: list[ServiceProcess], **changes: Any) -> AsyncIterator[RemoteRobot]:
    """Create robot r1 over HTTP, and run it."""
    client = running[0].client
    assert client is not None
    await client.put_model("small", MODEL)
    await client.put_robot("r1", {**CONFIG, **changes})
    robot = RemoteRobot(None, None, services=running)
    tasks = [asyncio.create_task(robot.report_for_ever()), asyncio.create_task(robot.act_for_ever())]
    try:
        yield robot
    finally:
        tasks += robot._works
        for task in tasks:
            task.cancel()
        await asyncio.wait(tasks)


async def latest(
    running: list[ServiceProcess],
    wanted: Callable[[dict[str, Any]], bool],
    timeout_s: float = 120.0,
    robot: str = "r1",
) -> dict[str, Any]:
    """Return the robot's latest repair as soon as it is as wanted."""
    seen: dict[str, Any] = {}
    began = time.monotonic()
    try:
        async with asyncio.timeout(timeout_s):
            while True:
                looked = time.monotonic()
                for service in running:
                    if service.client is not None:
                        page = await _whatever(service.client.repairs(robot, limit=1))
                        if page is not None and page["items"]:
                            seen = page["items"][0]
                            if wanted(seen):
                                return seen
                        break
                now = time.monotonic()
                await asyncio.sleep(look_s(now - began, now - looked))  # until the next look
    except TimeoutError:
        raise AssertionError(f"waited {timeout_s} s; the latest repair is {seen}") from None


def ended(repair: dict[str, Any]) -> bool:
    """Whether a repair has ended."""
    return repair["finished_ns"] is not None


def awaits(repair: dict[str, Any]) -> bool:
    """Whether a repair waits for a person's yes."""
    return bool(repair["state"] == "awaiting-approval")
