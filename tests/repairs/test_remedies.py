"""Remedies of the model in a real service: chosen by symptom, awaited in OBS, followed by another act."""

from __future__ import annotations

from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any

import pytest
from tests.repairs.robot import CONFIG, MODEL, Robot, robot_on, service, the_repair

from robomend.api.runtime import Runtime
from robomend.errors import InputError
from robomend_client.actions import FAILED
from robomend_client.readings import Symptom

pytestmark = pytest.mark.anyio

RESTART = ["stop_node(mapping)", "start_node(mapping)"]
QUICK = {"timeout_s": 20.0, "effect_timeout_s": 1.0, "retries": 0}


@asynccontextmanager
async def mapping_robot(runtime: Runtime, remedies: str, **changes: Any) -> AsyncIterator[Robot]:
    """A robot whose map can be mended by asking, with the act `clear`."""
    model = f"{MODEL}remedies:\n{remedies}\n".replace("name: small", "name: mended")
    actions = {**CONFIG["actions"], "clear": QUICK}
    about = {"source": model, "model": "mended", "actions": actions, **changes}
    async with robot_on(runtime, **about) as robot:
        robot.spoil = clears
        await robot.settled()
        yield robot


async def clears(robot: Robot, name: str, parameter: str) -> int | None:
    if name == "clear":
        robot.broken_topics.discard("map")
    return None


async def test_a_remedy_is_asked_for_and_its_effect_is_seen(tmp_path: Path) -> None:
    async with service(tmp_path) as runtime, mapping_robot(runtime, "  clear: {mends: mapping}") as robot:
        robot.broken_topics.add("map")
        repair = await the_repair(runtime)
    assert repair["state"] == "repaired"
    assert robot.done == ["clear(mapping)"]
    (step,) = repair["rounds"][0]["plan"]
    assert step["text"] == "clear(mapping)"
    assert "ok(map)" in step["seen"]


@pytest.mark.parametrize("answers", [0, FAILED])
async def test_one_that_does_not_help_or_is_refused_gives_way_to_the_restart(
    answers: int, tmp_path: Path
) -> None:
    async def only_a_restart(robot: Robot, name: str, parameter: str) -> int | None:
        if name == "start_node":
            robot.broken_topics.discard("map")
        return answers if name == "clear" else None

    async with service(tmp_path) as runtime, mapping_robot(runtime, "  clear: {mends: mapping}") as robot:
        robot.spoil = only_a_restart
        robot.broken_topics.add("map")
        repair = await the_repair(runtime)
    assert repair["state"] == "repaired"
    assert robot.done == ["clear(mapping)", *RESTART]


async def test_one_that_starts_its_node_is_asked_for_while_that_hangs_and_may_stop_it_meanwhile(
    tmp_path: Path,
) -> None:
    async def unit(robot: Robot, name: str, parameter: str) -> int | None:
        if name == "clear":
            robot.running["mapping"] = False
            await robot.settled()
            robot.running["mapping"] = True
            robot.broken_topics.discard("map")
        return None

    remedies = "  clear: {mends: mapping, starts: true, cost: 1}"
    async with service(tmp_path) as runtime, mapping_robot(runtime, remedies) as robot:
        robot.spoil = unit
        robot.broken_topics.add("map")
        repair = await the_repair(runtime)
    assert repair["state"] == "repaired"
    assert robot.done == ["clear(mapping)"]
    (one,) = repair["rounds"]
    assert one["ending"] == "done"


async def test_one_that_mended_only_half_of_what_was_blamed_is_not_asked_for_again(tmp_path: Path) -> None:
    async def only_the_base(robot: Robot, name: str, parameter: str) -> int | None:
        if name == "start_node":
            robot.broken_topics.discard("map")
        elif parameter == "base_node":
            robot.broken_topics.discard("odom")
        return None

    remedies = "  clear: {mends: [mapping], cost: 1}\n  reset: {mends: [base_node], cost: 1}"
    actions = {**CONFIG["actions"], "clear": QUICK, "reset": QUICK}
    async with service(tmp_path) as runtime, mapping_robot(runtime, remedies, actions=actions) as robot:
        robot.spoil = only_the_base
        robot.broken_topics |= {"map", "odom"}
        repair = await the_repair(runtime)
    assert repair["state"] == "repaired"
    assert sorted(robot.done[:2]) == ["clear(mapping)", "reset(base_node)"]
    assert robot.done[2:] == RESTART


@pytest.mark.parametrize("essential", ["base_node", "mapping"])
async def test_of_two_that_may_be_asked_for_at_once_that_of_what_is_needed_more_comes_first(
    essential: str, tmp_path: Path
) -> None:
    mends = {"clear": "mapping", "reset": "base_node"}

    async def heals(robot: Robot, name: str, parameter: str) -> int | None:
        robot.broken_topics.discard("map" if parameter == "mapping" else "odom")
        return None

    remedies = "".join(f"  {act}: {{mends: {node}, cost: 1}}\n" for act, node in mends.items())
    remedies += "rules:\n  - not ab(mapping) -> ok(needed)\nproperties: [needed]"
    actions = {**CONFIG["actions"], "clear": QUICK, "reset": QUICK}
    async with service(tmp_path) as runtime:
        model = MODEL
        for node in mends.values():
            said = "essential" if node == essential else "optional"
            model = model.replace(f"  {node}: {{", f"  {node}: {{criticality: {said}, ")
        model = f"{model}remedies:\n{remedies}\n".replace("name: small", "name: mended")
        async with robot_on(runtime, source=model, model="mended", actions=actions) as robot:
            robot.spoil = heals
            await robot.settled()
            robot.broken_topics |= {"map", "odom"}
            repair = await the_repair(runtime)
    assert repair["state"] == "repaired"
    assert robot.done[0] == ("clear(mapping)" if essential == "mapping" else "reset(base_node)")
    assert sorted(robot.done) == ["clear(mapping)", "reset(base_node)"]


async def test_the_kind_of_symptom_chooses_it(tmp_path: Path) -> None:
    remedies = "  clear: {mends: mapping, symptoms: [still]}"
    async with service(tmp_path) as runtime, mapping_robot(runtime, remedies) as robot:

        async def either(robot: Robot, name: str, parameter: str) -> int | None:
            robot.broken_topics.discard("map")
            return None

        robot.spoil = either
        robot.broken_topics.add("map")
        first = await the_repair(runtime)
        assert first["state"] == "repaired"
        assert robot.done == RESTART
        robot.kinds["ok(map)"] = Symptom.STILL
        robot.broken_topics.add("map")
        await robot.settled()
        repair = await the_repair(runtime, after=first["id"])
    assert repair["state"] == "repaired"
    assert robot.done == [*RESTART, "clear(mapping)"]


async def test_what_the_allow_list_lacks_or_the_policy_forbids_is_not_asked_for(tmp_path: Path) -> None:
    remedies = "  clear: {mends: mapping}"
    allow = ["start_node", "stop_node"]
    async with service(tmp_path) as runtime, mapping_robot(runtime, remedies, allow=allow) as robot:
        robot.broken_topics.add("map")
        robot.spoil = None

        async def either(robot: Robot, name: str, parameter: str) -> int | None:
            robot.broken_topics.discard("map")
            return None

        robot.spoil = either
        await the_repair(runtime)
        assert robot.done == RESTART
        with pytest.raises(InputError, match="no action 'cleer'"):
            await runtime.robots.put_robot(
                "r2", {**CONFIG, "model": "mended", "allow": ["cleer"]}, expected=None, by="test"
            )


async def test_one_that_names_no_component_counts_for_what_it_mends(tmp_path: Path) -> None:
    limits = {"attempts_per_hour": 1, "rounds": 6}
    remedies = '  "clear(all)": {mends: [mapping]}'
    async with (
        service(tmp_path) as runtime,
        mapping_robot(runtime, remedies, limits=limits, actions={"clear": QUICK}) as robot,
    ):
        robot.broken_topics.add("map")
        first = await the_repair(runtime)
        assert first["state"] == "repaired"
        await robot.settled()
        robot.broken_topics.add("map")
        repair = await the_repair(runtime, after=first["id"])
    assert repair["state"] == "escalated"
    assert robot.done == ["clear(all)"]
    assert "more than 1 actions on mapping within an hour, the limit" in repair["reason"]
