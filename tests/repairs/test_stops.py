"""Cancellations and the global stop: nothing more is sent, and what runs is cut off."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable, Sequence
from pathlib import Path
from typing import Any

import pytest
from tests.repairs.robot import CONFIG, Robot, nothing_begins, robot_of, service, the_repair
from tests.waiting import for_ever

from robomend.api.runtime import Runtime
from robomend.errors import Refused
from robomend.store import audit, global_stop
from robomend.store.records import Stop

pytestmark = pytest.mark.anyio

Halt = Callable[[Runtime, str], Awaitable[object]]
"""Says to the service that a repair must end."""


async def cancel(runtime: Runtime, repair: str) -> object:
    return await runtime.repairs.cancel(repair, by="ann", reason="I see smoke")


async def stop(runtime: Runtime, repair: str) -> object:
    return await runtime.repairs.stop(by="ann", reason="I see smoke")


HALTS = [pytest.param(cancel, id="cancel"), pytest.param(stop, id="stop")]


async def test_the_global_stop_ends_repairs_and_keeps_new_ones_from_beginning(tmp_path: Path) -> None:
    async with robot_of(tmp_path) as (runtime, robot):
        await runtime.repairs.stop(by="ann", reason="people on the floor")
        robot.cut("base")
        await nothing_begins(runtime, 0.7)
        with pytest.raises(Refused, match="people on the floor"):
            await runtime.repairs.create("r1", bad=None, by="bob", reason="")
        await runtime.repairs.resume(by="ann", reason="all clear")
        repair = await the_repair(runtime)
    assert repair["state"] == "repaired"


async def test_what_was_said_of_the_stop_before_its_latest_change_does_not_count(tmp_path: Path) -> None:
    """Events of one's own changes come back late on a busy computer."""
    async with service(tmp_path) as runtime:
        switch = runtime.repairs.switch
        said = []
        for change in (runtime.repairs.stop, runtime.repairs.resume, runtime.repairs.stop):
            await change(by="ann", reason="")
            said.append(await runtime.store.read(global_stop.get))
        for earlier in said[:2]:
            switch.heard(earlier)
            assert switch.stop == said[2]
        elsewhere = Stop(False, "bob", "all clear", 0, said[2].revision + 1)
        switch.heard(elsewhere)
        assert switch.stop == elsewhere


async def audit_of(runtime: Runtime) -> list[str]:
    """Return what was done to whom, oldest first: the order is that of the writes."""
    page = await runtime.store.read(audit.page)
    return [entry.action for entry in reversed(page.items)]


def sent_after(audit: Sequence[str], request: str) -> list[str]:
    """Return the actions whose intent was written after the request was."""
    return [action for action in audit[audit.index(request) :] if action == "action.sent"]


REQUESTS: dict[Halt, str] = {cancel: "repair.cancel", stop: "stop.set"}


@pytest.mark.parametrize("halt", HALTS)
@pytest.mark.parametrize("action", [1, 4])
async def test_no_action_follows_a_request_to_end_the_repair(tmp_path: Path, halt: Halt, action: int) -> None:
    reached = asyncio.Event()
    patient = {name: {**how, "timeout_s": 600.0} for name, how in CONFIG["actions"].items()}

    async def takes_time(robot: Robot, name: str, parameter: str) -> int | None:
        if len(robot.ids) >= action:
            reached.set()
            await for_ever()  # it is still open when the request comes
        return None

    async with robot_of(tmp_path, actions=patient) as (runtime, robot):
        robot.spoil = takes_time
        robot.go_off()
        await reached.wait()
        [open_one] = await runtime.repairs.repairs("r1", before=None, limit=1)
        await halt(runtime, open_one["id"])
        repair = await the_repair(runtime)
        await runtime.repairs.stop(by="ann", reason="so that no other repair begins")
        audit = await audit_of(runtime)
    assert (repair["state"], repair["reason"].removeprefix("global stop: ")) == ("cancelled", "I see smoke")
    assert sent_after(audit, REQUESTS[halt]) == []
    assert audit.count("action.sent") < 5


@pytest.mark.parametrize("halt", HALTS)
async def test_a_repair_that_waits_for_an_effect_ends_at_once(tmp_path: Path, halt: Halt) -> None:
    """Without the halt it would wait for longer than this test lasts."""

    async def without_effect(robot: Robot, name: str, parameter: str) -> int | None:
        return 0

    actions = {name: {**one, "effect_timeout_s": 600.0} for name, one in CONFIG["actions"].items()}
    async with robot_of(tmp_path, actions=actions) as (runtime, robot):
        robot.spoil = without_effect
        robot.running["mapping"] = False
        while "action.result" not in await audit_of(runtime):
            await asyncio.sleep(0.02)
        [open_one] = await runtime.repairs.repairs("r1", before=None, limit=1)
        await halt(runtime, open_one["id"])
        repair = await the_repair(runtime)
    assert repair["state"] == "cancelled"
    assert robot.done == ["start_node(mapping)"]


@pytest.mark.parametrize("halt", HALTS)
async def test_a_repair_whose_planner_never_ends_ends_at_once(
    tmp_path: Path, halt: Halt, monkeypatch: pytest.MonkeyPatch
) -> None:
    planning = asyncio.Event()
    let_go = asyncio.Event()

    async def hangs(*_: Any, **__: Any) -> Any:
        planning.set()
        try:
            await asyncio.Event().wait()
        finally:
            let_go.set()

    monkeypatch.setattr("robomend.repairs.choosing.Chooser.choose", hangs)
    async with robot_of(tmp_path) as (runtime, robot):
        robot.cut("base")
        await planning.wait()
        [open_one] = await runtime.repairs.repairs("r1", before=None, limit=1)
        await halt(runtime, open_one["id"])
        repair = await the_repair(runtime)
        await let_go.wait()  # the planner is not left behind
    assert repair["state"] == "cancelled"
    assert robot.done == []
