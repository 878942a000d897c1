"""What will not work on a robot is refused when it is configured, or named before a fault."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from tests.repairs.robot import CONFIG, MODEL, ONCE, Robot, robot_on, running, service

from robomend.api.runtime import Runtime
from robomend.errors import DomainError, InputError, NotFound, RobomendError

pytestmark = pytest.mark.anyio

SPARE = """(define (domain robot-repair)
  (:predicates (spare_for ?s ?h - hardware))
  (:action switch_to_spare
    :parameters (?h ?s - hardware)
    :precondition (and (spare_for ?s ?h) (bad ?h))
    :effect (and (good ?h) (not (bad ?h)) (increase (total-cost) 30)))
  (:init (spare_for lidar_b lidar)))
"""


def many(parameters: int) -> str:
    """Return PDDL with an action of so many unguarded parameters."""
    names = " ".join(f"?p{number}" for number in range(parameters))
    return f"""(define (domain robot-repair)
      (:action fix
        :parameters ({names} - component)
        :precondition (bad ?p0)
        :effect (and (good ?p0) (not (bad ?p0)) (increase (total-cost) 5))))"""


async def put(runtime: Runtime, **changes: Any) -> None:
    await runtime.robots.models.put("small", MODEL, format=None, expected=None, by="test")
    await runtime.robots.put_robot("r1", {**CONFIG, **changes}, expected=None, by="test")


@pytest.mark.parametrize(
    ("changes", "error", "said"),
    [
        (
            {"allow": ["power_up", "strat_node"]},
            InputError,
            "allow: the robot's domain has no action 'strat_node'; did you mean 'start_node'?; there are "
            "power_up, shutdown, start_node, stop_node",
        ),
        (
            {"actions": {"power_upp": {"timeout_s": 3.0}}},
            InputError,
            "actions: the robot's domain has no action 'power_upp'; did you mean 'power_up'?",
        ),
        (
            {"domain": SPARE},
            DomainError,
            "domain:7: 'lidar_b' is neither a component of the model nor in (:objects …); did you mean",
        ),
        (
            {"protected": ["lydar"]},
            InputError,
            "protected: the model 'small' has no component 'lydar'; did you",
        ),
    ],
)
async def test_what_can_never_work_is_refused_with_its_place_and_remedy(
    tmp_path: Path, changes: dict[str, Any], error: type[RobomendError], said: str
) -> None:
    async with service(tmp_path) as runtime:
        with pytest.raises(error) as refused:
            await put(runtime, **changes)
    assert str(refused.value).startswith(said)


async def test_an_action_with_too_many_groundings_is_refused_when_the_robot_is_put(tmp_path: Path) -> None:
    async with service(tmp_path) as runtime:
        with pytest.raises(DomainError) as refused:
            await put(runtime, domain=many(7))
        assert str(refused.value).startswith(
            "domain:2: the action 'fix' has 7 parameters, which makes more than 1000 ground actions"
        )
        with pytest.raises(NotFound):
            await runtime.robots.memory.robot("r1")


async def test_what_can_work_is_taken(tmp_path: Path) -> None:
    domain = many(3).replace(
        "(:action fix", f"{ONCE.split('robot-repair)', 1)[1].rstrip()[:-1]} (:action fix"
    )
    async with service(tmp_path) as runtime:
        await put(runtime, domain=domain, allow=["fix", "recalibrate", "start_node"])
        await runtime.robots.delete_robot("r1", expected="*", by="test")
        await runtime.robots.models.put(
            "two",
            MODEL.replace("base:", "lidar_b: {channel: 4}\n  base:"),
            format=None,
            expected=None,
            by="test",
        )
        await runtime.robots.put_robot(
            "r1", {**CONFIG, "model": "two", "domain": SPARE}, expected=None, by="t"
        )


async def test_a_robot_on_which_all_is_well_has_nothing_to_say(tmp_path: Path) -> None:
    async with service(tmp_path) as runtime, robot_on(runtime) as robot:
        await robot.settled()
        await runtime.repairs.orders("r1", host=None, wait_s=0.0)
        assert list(await runtime.repairs.findings("r1")) == []


async def test_actions_that_nobody_carries_out_are_named(tmp_path: Path) -> None:
    async with service(tmp_path) as runtime:
        await put(runtime, actions={}, observed=[])
        found = list(await runtime.repairs.findings("r1"))
        assert found[:2] == [
            f"{action}: nobody carries it out: the robot has no `board`; configure one, or another "
            f"`actions.{action}.executor`"
            for action in ("power_up", "shutdown")
        ]
        assert found[2] == (
            "start_node, stop_node: no agent of this robot has asked for work within 60 s: start "
            "robomend-agent on it"
        )
        await runtime.repairs.orders("r1", host=None, wait_s=0.0)
        assert not [one for one in await runtime.repairs.findings("r1") if "no agent" in one]


async def test_a_computer_whose_agent_does_not_ask_is_named(tmp_path: Path) -> None:
    model = MODEL.replace("mapping: {", "mapping: {host: nav_pc, ")
    async with service(tmp_path) as runtime:
        await runtime.robots.models.put("small", model, format=None, expected=None, by="test")
        await runtime.robots.put_robot("r1", CONFIG, expected=None, by="test")
        await runtime.repairs.orders("r1", host="arm_pc", wait_s=0.0)
        [said] = [one for one in await runtime.repairs.findings("r1") if "agent" in one]
        assert "no agent on host 'nav_pc', where the model has nodes, has asked for work" in said
        await runtime.repairs.orders("r1", host="nav_pc", wait_s=0.0)
        assert not [one for one in await runtime.repairs.findings("r1") if "agent" in one]


async def test_what_nobody_reports_and_topics_that_nobody_observes_are_named(tmp_path: Path) -> None:
    async with service(tmp_path) as runtime:
        await put(runtime, observed=["ok(odom)", "running(mapping)"])
        robot = Robot(runtime.repairs, runtime.robots)
        said = list(await runtime.repairs.findings("r1"))
        assert (
            "nobody has reported ok(odom), running(mapping), which `observed` says that observers will report"
            in said
        )
        assert (
            "topics scan, map: not in `observed`, and never reported; nobody would notice their silence"
            in said
        )
        async with running(robot):
            await robot.settled()
            said = list(await runtime.repairs.findings("r1"))
        assert not [one for one in said if "report" in one]


async def test_what_a_new_model_or_new_settings_have_lost_is_named(tmp_path: Path) -> None:
    program = {"executor": {"kind": "process", "options": {"program": "start"}}}
    async with service(tmp_path) as runtime:
        await put(runtime, observed=["ok(map)"], actions={**CONFIG["actions"], "start_node": program})
        gone = MODEL.replace("  mapping: {publishes: {map: [scan]}}\n", "")
        await runtime.robots.models.put("small", gone, format=None, expected="*", by="test")
        found = list(await runtime.repairs.findings("r1"))
    assert [one for one in found if one.startswith("'ok(map)', position 0: no topic or property")], found
    assert [one for one in found if "the service's settings name no program 'start'" in one]
