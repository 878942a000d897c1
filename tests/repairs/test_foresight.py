"""What will not work on a robot is refused when it is configured, or named before a fault."""

from __future__ import annotations

import asyncio
from pathlib import Path
from typing import Any

import pytest
from tests.network import own_port
from tests.repairs.robot import CONFIG, MODEL, ONCE, Robot, put_robot, running, service, the_repair
from tests.robomend_board.processes import running as emulator
from tests.waiting import eventually

from robomend.api.runtime import Runtime
from robomend.errors import DomainError, InputError, NotFound, RobomendError
from robomend.robots.reporters import Reporter

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
    ],
)
async def test_what_can_never_work_is_refused_with_its_place_and_remedy(
    tmp_path: Path, changes: dict[str, Any], error: type[RobomendError], said: str
) -> None:
    async with service(tmp_path) as runtime:
        with pytest.raises(error) as refused:
            await put_robot(runtime, **changes)
    assert str(refused.value).startswith(said)


async def test_an_action_with_too_many_groundings_is_refused_when_the_robot_is_put(tmp_path: Path) -> None:
    async with service(tmp_path) as runtime:
        with pytest.raises(DomainError) as refused:
            await put_robot(runtime, domain=many(7))
        assert str(refused.value).startswith(
            "domain:2: the action 'fix' has 7 parameters, which makes more than 1000 ground actions"
        )
        with pytest.raises(NotFound):
            await runtime.robots.memory.robot("r1")


async def test_actions_that_nobody_carries_out_are_named(tmp_path: Path) -> None:
    async with service(tmp_path) as runtime:
        await put_robot(runtime, actions={}, observed=[])
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


async def test_what_nobody_reports_and_topics_that_nobody_observes_are_named(tmp_path: Path) -> None:
    async with service(tmp_path) as runtime:
        await put_robot(runtime, observed=["ok(odom)", "running(mapping)"])
        robot = Robot(runtime.repairs, runtime.robots)
        said = list(await runtime.repairs.findings("r1"))
        assert "nobody reports ok(odom), running(mapping), which `observed` says that observers do" in said
        assert (
            "topics scan, map: not in `observed`, and never reported; nobody would notice their silence"
            in said
        )
        async with running(robot):
            await robot.settled()
            said = list(await runtime.repairs.findings("r1"))
        assert not [one for one in said if "report" in one]


async def test_a_source_to_be_believed_that_does_not_exist_and_two_agents_of_one_name_are_named(
    tmp_path: Path,
) -> None:
    async def polls(runtime: Runtime, host: str) -> None:
        await runtime.repairs.orders("r1", host=host, wait_s=0.0, agent="onboard", can=[], observes={})

    async with service(tmp_path) as runtime:
        await put_robot(runtime, believe=["pc1", "test robot"])
        robot = Robot(runtime.repairs, runtime.robots)
        await robot.settled()
        for host in ("pc1", "pc2") * 3:
            await polls(runtime, host)
        said = list(await runtime.repairs.findings("r1"))
    assert "`believe` names pc1, and no source of that name has reported anything yet" in said
    named = "two agents call themselves 'onboard', on 'pc1' and 'pc2': give each its own "
    assert [one for one in said if "call themselves" in one] == [f"{named}(`agent:` of the agent's file)"]


async def test_nodes_that_no_agent_restarts_are_named_once_all_agents_were_heard(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    async def said(runtime: Runtime) -> list[str]:
        await runtime.repairs.orders(
            "r1", host=None, wait_s=0.0, agent="onboard", can=["start_node:mapping", "stop_node"], observes={}
        )
        return [one for one in await runtime.repairs.findings("r1") if "offers it" in one]

    async with service(tmp_path) as runtime:
        await put_robot(
            runtime, domain=ONCE, actions={**CONFIG["actions"], "recalibrate": {"timeout_s": 3.0}}
        )
        assert await said(runtime) == []  # another may be about to come
        monkeypatch.setattr("robomend.robots.declared.NEW_S", 0.0)
        nobody = "no agent of this robot offers it, and no plan will have it"
        assert await said(runtime) == [
            f"power_up of base, lidar: {nobody}",
            f"shutdown of base, lidar: {nobody}",
            f"start_node of base_node, lidar_node: {nobody}",
            f"recalibrate: {nobody}",
        ]


async def test_what_no_agent_does_is_not_sent_and_waited_for_but_told_at_once(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("robomend.robots.declared.NEW_S", 0.0)
    async with service(tmp_path) as runtime:
        await put_robot(runtime)
        robot = OfOneNode(runtime.repairs, runtime.robots)
        async with running(robot):
            await robot.settled()
            robot.running["lidar_node"] = False
            repair = await the_repair(runtime)
        assert repair["state"] == "escalated"
        assert "start_node(lidar_node) is refused: no agent offers it (onboard does" in repair["reason"]
        assert robot.done == []
        assert repair["rounds"] == []

        robot.running["lidar_node"] = True
        async with running(robot):
            await robot.settled()
            robot.running["mapping"] = False
            again = await the_repair(runtime, after=repair["id"])
        assert again["state"] == "repaired"
        assert robot.done == ["start_node(mapping)"]


async def test_what_is_done_to_a_device_goes_to_the_agent_on_its_host(tmp_path: Path) -> None:
    model = MODEL.replace("lidar: {", "lidar: {host: arm_pc, ")
    async with service(tmp_path) as runtime:
        await put_robot(runtime, model, **CONFIG)
        robot = WithTwoComputers(runtime.repairs, runtime.robots)
        async with running(robot):
            await robot.settled()
            robot.cut("lidar")
            assert (await the_repair(runtime))["state"] == "repaired"
    assert "arm_pc: power_up(lidar)" in robot.done
    assert "nav_pc: power_up(lidar)" not in robot.done


class OfOneNode(Robot):
    """Its agent restarts `mapping`, and nothing else."""

    async def act_for_ever(self) -> None:
        await act(self, agent="onboard", can=["start_node:mapping", "stop_node:mapping"], observes={})


class WithTwoComputers(Robot):
    """The agent on each of them does whatever it is given, as those of old do."""

    async def act_for_ever(self) -> None:
        hosts = ("nav_pc", "arm_pc")
        await asyncio.gather(*(act(self, host=host, note=f"{host}: ") for host in hosts))


async def act(robot: Robot, note: str = "", host: str | None = None, **says: Any) -> None:
    """Be one of the robot's agents."""
    while True:
        orders = await robot.repairs.orders(robot.id, host=host, wait_s=5.0, **says)
        if orders is not None and "id" in orders:
            [parameter] = orders["parameters"]
            robot.do(orders["name"], parameter)
            robot.done.append(f"{note}{orders['name']}({parameter})")
            await robot.report()
            await robot.repairs.result(orders["id"], code=0, message="", by=Reporter("robot"))


async def test_power_is_planned_while_its_board_is_connected_only_and_a_person_hears_what_to_switch(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("robomend.robots.declared.GONE_S", 0.3)
    port = own_port()
    firmware = MODEL.replace("lidar_node: {", "lidar_node: {restartable: false, ")
    said = [one for one in CONFIG["observed"] if not one.startswith("on(")]
    config = {
        "actions": {name: CONFIG["actions"][name] for name in ("start_node", "stop_node")},
        "policy": "approve",
        "observed": said,
        "board": {"host": "127.0.0.1", "port": port, "rate_hz": 20},
    }

    class OnBoard(Robot):
        """Power is what the board says."""

        def sentences(self) -> list[str]:
            return [one for one in super().sentences() if "on(" not in one]

    async with service(tmp_path) as runtime:
        await put_robot(runtime, firmware, **config)
        robot = OnBoard(runtime.repairs, runtime.robots)
        async with running(robot):
            await robot.settled()
            state = await runtime.robots.memory.robot("r1")
            await eventually(lambda: state.sight.declared.boardless, "a board that is not reached")
            robot.connected["lidar_node"] = False
            repair = await the_repair(runtime)
            assert repair["state"] == "escalated"
            assert "a person must power-cycle lidar: its board is not connected" in repair["reason"]
            assert repair["rounds"] == []
            with emulator("--on", "3,7", port=port):
                again = await the_repair(runtime, after=repair["id"], ended=False)
    assert [step["text"] for step in again["plan"]] == ["shutdown(lidar)", "power_up(lidar)"]
