"""The owner of a robot dies in the middle of a drill: whoever takes over undoes it, and nobody else does."""

from __future__ import annotations

import asyncio
import contextlib
import os
import signal
from collections import Counter
from collections.abc import Awaitable, Callable
from pathlib import Path
from typing import Any

import pytest
from tests.postgres import postgres_server, postgres_url
from tests.repairs.remote import RemoteRobot, ServiceProcess, remote_robot, services
from tests.store.examples import owner

from robomend.settings import Settings
from robomend.store import opened
from robomend_client.rest import ClientError

__all__ = ["postgres_server", "postgres_url"]  # fixtures

pytestmark = pytest.mark.anyio


@pytest.fixture
def arguments(postgres_url: str, tmp_path: Path) -> list[tuple[str, ...]]:
    """The arguments of two instances on one database."""
    return [("--data", str(tmp_path), "--database", postgres_url)] * 2


async def owning_process(arguments: tuple[str, ...]) -> int | None:
    """Return the process that carries out the robot's repairs and drills."""
    given = dict(zip((word.removeprefix("--") for word in arguments[::2]), arguments[1::2], strict=True))
    async with opened(Settings.model_validate(given).database_url) as store:
        instance, _ = await store.read(owner, "r1")
        return next((one.pid for one in await store.ownership.instances() if one.id == instance), None)


async def asked(running: list[ServiceProcess], ask: Callable[[Any], Awaitable[Any]]) -> Any:
    """Ask whichever service answers, within a minute."""
    async with asyncio.timeout(60):
        while True:
            for service in running:
                if service.client is not None:
                    try:
                        return await ask(service.client)
                    except ClientError:
                        pass
            await asyncio.sleep(0.05)


async def drill_as(
    running: list[ServiceProcess], drill: str, wanted: Callable[[dict[str, Any]], bool]
) -> dict[str, Any]:
    """Return the drill once it is as wanted."""
    seen: dict[str, Any] = {}
    try:
        async with asyncio.timeout(120):
            while not seen or not wanted(seen):
                await asyncio.sleep(0.03)
                seen = await asked(running, lambda client: client.drill(drill))
    except TimeoutError:
        raise AssertionError(f"the drill is {seen}") from None
    return seen


async def actions_of(running: list[ServiceProcess]) -> Counter[str]:
    """Return how often each thing stands in the audit log."""
    audit = await asked(running, lambda client: client.audit("r1", limit=500))
    return Counter(entry["action"] for entry in audit["items"])


async def begun(running: list[ServiceProcess], robot: RemoteRobot) -> str:
    """Begin a drill of a node that is killed, by approval only, so that no repair answers it."""
    await robot.settled()
    drill = await asked(running, lambda client: client.start_drill("r1", "node-killed", "mapping"))
    planted = await drill_as(running, drill["id"], lambda one: one["state"] == "planted")
    return str(planted["id"])


async def test_the_drill_is_ended_and_undone_by_exactly_one_owner(arguments: list[tuple[str, ...]]) -> None:
    async with services(*arguments) as running, remote_robot(running, policy="approve") as robot:
        drill = await begun(running, robot)
        assert robot.running["mapping"] is False
        victim = await owning_process(arguments[0])
        assert victim is not None
        os.kill(victim, signal.SIGKILL)
        ended = await drill_as(running, drill, lambda one: one["finished_ns"] is not None)
        heir = await owning_process(arguments[0])
        told = await actions_of(running)
    assert (ended["state"], ended["undone"]) == ("cancelled", True), ended
    assert "another instance took it over" in ended["cut_short"]
    assert heir not in {None, victim}
    assert robot.running["mapping"] is True
    assert robot.complaints == []
    assert Counter(robot.done) == {"plant_fault(mapping)": 1, "undo_fault(mapping)": 1}
    assert [told[f"drill.{state}"] for state in ("planting", "planted", "recovering", "cancelled")] == [1] * 4


@pytest.mark.long
async def test_an_owner_that_hung_and_comes_back_undoes_nothing_a_second_time(
    arguments: list[tuple[str, ...]],
) -> None:
    """It still believes that the robot is its own: what it writes then is refused."""
    async with services(*arguments) as running, remote_robot(running, policy="approve") as robot:
        drill = await begun(running, robot)
        victim = await owning_process(arguments[0])
        assert victim is not None
        os.kill(victim, signal.SIGSTOP)
        hung = [one for one in running if one.process is not None and one.process.pid == victim]
        others = [one for one in running if one not in hung]
        robot.services = others
        try:
            ended = await drill_as(others, drill, lambda one: one["finished_ns"] is not None)
        finally:
            with contextlib.suppress(ProcessLookupError):  # a worker that hangs is killed by its parent
                os.kill(victim, signal.SIGCONT)
        assert (ended["state"], ended["undone"]) == ("cancelled", True), ended
        await asyncio.sleep(5.0)  # for what it would do: no event tells that it does nothing
        told = await actions_of(others)
    assert robot.complaints == []
    assert Counter(robot.done) == {"plant_fault(mapping)": 1, "undo_fault(mapping)": 1}
    assert told["drill.cancelled"] == told["drill.recovering"] == 1
