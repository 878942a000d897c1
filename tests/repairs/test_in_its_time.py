"""Waits that are as long as the robot needs: by its configuration, by its model, by what is seen."""

from __future__ import annotations

import asyncio
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import pytest
from tests.repairs.robot import (
    CONFIG,
    MODEL,
    SHUT_DOWN,
    Robot,
    put_robot,
    repaired,
    robot_of,
    robot_on,
    service,
    the_repair,
    with_recalibrate,
)
from tests.waiting import eventually

from robomend.api.runtime import Runtime
from robomend.errors import Overloaded
from robomend.repairs import calm, reasons
from robomend.repairs.choosing import Chooser
from robomend.repairs.looking import DENIED
from robomend.repairs.robot_repairs import RobotRepairs
from robomend.robots import start_ups
from robomend.robots.batches import Batch
from robomend.robots.clock import CLOCK
from robomend.robots.declared import declaration
from robomend.robots.reporters import Reporter
from robomend.store.records import StoredRepair

pytestmark = pytest.mark.anyio


async def test_what_a_settled_observer_denies_after_an_act_is_not_waited_for(tmp_path: Path) -> None:
    """The agent says `not ok(map)` afresh once the action has answered, and goes on saying so."""
    config = with_recalibrate()
    config["actions"]["recalibrate"] |= {"effect_timeout_s": 60.0, "retries": 0}

    async def in_vain(robot: Robot, name: str, parameter: str) -> int | None:
        if name != "recalibrate":
            robot.broken_topics.clear()
            return None
        return 0

    repair, robot = await repaired(
        tmp_path, lambda robot: robot.broken_topics.add("map"), spoil=in_vain, **config, timeout_s=50.0
    )
    assert robot.done[0] == "recalibrate(mapping)"
    assert repair["rounds"][0]["reason"].endswith(DENIED)
    assert repair["state"] == "repaired"


STARTS_S = 2.0
"""How long the robot's slow parts take; `effect_timeout_s` is 1 s."""


async def slow_driver(robot: Robot, name: str, parameter: str) -> int | None:
    """The lidar's driver needs its time until it speaks."""
    robot.do(name, parameter)
    if (name, parameter) == ("start_node", "lidar_node"):
        robot.connected["lidar_node"] = False
        asyncio.get_running_loop().call_later(STARTS_S, robot.do, "start_node", "lidar_node")
    return 0


async def test_a_node_has_the_time_that_the_model_says_it_needs(tmp_path: Path) -> None:
    model = MODEL.replace("publishes: {scan: []}", "publishes: {scan: []}, start_s: 2")
    async with robot_of(tmp_path, source=model) as (runtime, robot):
        robot.spoil = slow_driver
        robot.running["lidar_node"] = robot.connected["lidar_node"] = False
        repair = await the_repair(runtime)
    assert (repair["state"], robot.done) == ("repaired", ["start_node(lidar_node)"])


@pytest.mark.parametrize("anew", [False, True], ids=["seen silent", "judged anew"])
async def test_a_start_of_which_nothing_is_known_has_twice_as_long_each_time_it_was_given_up(
    tmp_path: Path, anew: bool
) -> None:
    """A mapper loads its map for 3 s, and begins anew when it is stopped; `effect_timeout_s` is 1 s.

    Who judges anew after the first start dates the silence by that.
    """
    loading: list[asyncio.TimerHandle] = []

    class JudgesAnew(Robot):
        def sentences(self) -> list[str]:
            said = super().sentences()
            return said if self.done else [one.replace("not ok(map)", "ok(map)") for one in said]

    async def loads(robot: Robot, name: str, parameter: str) -> int | None:
        robot.do(name, parameter)
        for handle in loading:
            handle.cancel()
        if name == "start_node":
            if anew and not robot.done:
                robot.onsets["not ok(map)"] = CLOCK.now_ns()
            robot.broken_topics.add("map")
            loaded = asyncio.get_running_loop().call_later(3.0, robot.broken_topics.discard, "map")
            loading.append(loaded)
        return 0

    kind = JudgesAnew if anew else Robot
    repair, robot = await repaired(
        tmp_path, lambda robot: robot.do("stop_node", "mapping"), spoil=loads, kind=kind
    )
    assert repair["state"] == "repaired", repair["reason"]
    assert robot.done.count("start_node(mapping)") <= 3


async def test_a_node_has_the_time_that_it_took_at_the_robots_boot(tmp_path: Path) -> None:
    async with service(tmp_path) as runtime, robot_on(runtime, policy="observe") as robot:
        robot.spoil = slow_driver
        robot.running["lidar_node"] = robot.connected["lidar_node"] = False
        await robot.settled()
        robot.running["lidar_node"] = True
        await robot.settled()
        await asyncio.sleep(STARTS_S)  # a boot takes its time
        robot.do("start_node", "lidar_node")
        await robot.settled()
        etag = (await runtime.robots.memory.robot("r1")).stored.etag
        await runtime.robots.put_robot("r1", CONFIG, expected=etag, by="ann")
        robot.running["lidar_node"] = robot.connected["lidar_node"] = False
        repair = await the_repair(runtime)
        findings = await runtime.repairs.findings("r1")
    assert (repair["state"], robot.done) == ("repaired", ["start_node(lidar_node)"])
    assert [one for one in findings if "lidar_node" in one and "start_s" in one]


async def test_a_driver_is_started_after_its_device_has_booted(tmp_path: Path) -> None:
    """Started sooner it stays mute."""
    booted = asyncio.Event()

    async def boots(robot: Robot, name: str, parameter: str) -> int | None:
        robot.do(name, parameter)
        if name == "power_up":
            asyncio.get_running_loop().call_later(STARTS_S, booted.set)
        robot.connected["base_node"] &= booted.is_set()
        return 0

    model = MODEL.replace("base: {channel: 7}", "base: {channel: 7, boot_s: 2}")
    repair, robot = await repaired(tmp_path, lambda robot: robot.cut("base"), spoil=boots, source=model)
    assert (repair["state"], robot.done) == ("repaired", SHUT_DOWN)
    assert [wait["names"] for wait in repair["waits"] if "base has booted" in wait["why"]] == [["base"]]


def booted(config: dict[str, Any]) -> dict[str, Any]:
    """Return a configuration that does not say how long starts take."""
    actions = {name: dict(one) for name, one in config["actions"].items()}
    del actions["start_node"]["effect_timeout_s"]
    return {**config, "actions": actions}


async def test_what_was_given_up_and_is_repairable_later_is_taken_up_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The lidar is not there yet: whatever is done about its driver is in vain."""
    monkeypatch.setattr(reasons, "AGAIN_S", 1.5)
    there = False

    async def in_vain(robot: Robot, name: str, parameter: str) -> int | None:
        robot.do(name, parameter)
        robot.connected["lidar_node"] &= there
        return 0

    limits = {"attempts_per_hour": 100, "rounds": 1}
    async with robot_of(tmp_path, limits=limits) as (runtime, robot):
        robot.spoil = in_vain
        robot.connected["lidar_node"] = False
        given_up = await the_repair(runtime)
        there = True
        repair = await the_repair(runtime, after=given_up["id"])
        told = (await runtime.repairs.repair(repair["id"]))["account"]
    assert given_up["state"] == "escalated"
    assert given_up["retry_ns"] > given_up["finished_ns"]
    assert repair["again"] == {"of": given_up["id"], "why": "did not mend it", "times": 1}
    assert (repair["state"], robot.done[-2:]) == (
        "repaired",
        ["stop_node(lidar_node)", "start_node(lidar_node)"],
    )
    assert any(given_up["id"] in line for line in told)


async def test_a_repair_that_broke_is_begun_again_and_named_so_with_a_back_off(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The planner is starved: twice there is no answer."""
    monkeypatch.setattr(reasons, "BROKE_S", 0.3)
    choose, asked = Chooser.choose_in_turn, 0

    async def starved(chooser: Chooser, *about: Any, **options: Any) -> Any:
        nonlocal asked
        asked += 1
        if asked <= 2:
            raise Overloaded("no planner has answered", 1.0)
        return await choose(chooser, *about, **options)

    monkeypatch.setattr(Chooser, "choose_in_turn", starved)
    async with robot_of(tmp_path) as (runtime, robot):
        robot.running["mapping"] = False
        first = await the_repair(runtime)
        second = await the_repair(runtime, after=first["id"])
        while second["state"] == "failed" and second["again"]["times"] < 2:
            second = await the_repair(runtime, after=second["id"])
    assert first["state"] == "failed"
    assert second["again"]["why"] == "broke"
    assert (second["state"], second["again"]["times"]) == ("repaired", 2)


async def test_a_plan_of_acts_that_the_agent_turns_out_not_to_offer_is_made_anew(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("robomend.robots.declared.NEW_S", 0.0)

    async def polls(*can: str) -> None:
        await runtime.repairs.orders("r1", host=None, wait_s=0.0, agent="onboard", can=can)

    async with service(tmp_path) as runtime:
        await put_robot(runtime, policy="approve")
        robot = Robot(runtime.repairs, runtime.robots)
        robot.running["mapping"] = False
        reporting = asyncio.create_task(robot.report_for_ever())  # its agent has not asked for work yet
        try:
            first = await the_repair(runtime, ended=False)
            await polls("start_node:lidar_node")
            dropped = await the_repair(runtime)
            if dropped["id"] == first["id"]:
                nobody = await the_repair(runtime, after=first["id"])
            else:
                dropped, nobody = dict(await runtime.repairs.repair(first["id"])), dropped
            await polls("start_node:lidar_node", "start_node:mapping")
            second = await the_repair(runtime, ended=False, after=first["id"])
        finally:
            reporting.cancel()
    assert [step["text"] for step in first["plan"]] == ["start_node(mapping)"]
    assert dropped["state"] == "cancelled"
    assert "no agent offers it" in dropped["reason"]
    assert (nobody["state"], nobody["rounds"]) == ("escalated", [])
    assert [step["text"] for step in second["plan"]] == ["start_node(mapping)"]


@pytest.mark.parametrize(
    ("configured", "said", "handed"),
    [(None, None, 30.0), (None, {"recalibrate": 77.0}, 77.0), (5.0, {"recalibrate": 77.0}, 5.0)],
)
async def test_an_action_has_the_time_that_its_configuration_or_its_agent_says(
    configured: float | None, said: dict[str, float] | None, handed: float, tmp_path: Path
) -> None:
    config = with_recalibrate()
    config["actions"] = {**config["actions"], "recalibrate": {"timeout_s": configured}}
    async with service(tmp_path) as runtime:
        await put_robot(runtime, **config)
        robot = Robot(runtime.repairs, runtime.robots, broken_topics={"map"})
        reporting = asyncio.create_task(robot.report_for_ever())
        try:
            async with asyncio.timeout(60):
                action = None
                while action is None:
                    action = await runtime.repairs.orders(
                        "r1", host=None, wait_s=1.0, agent="a", takes_s=said
                    )
            await runtime.repairs.result(action["id"], code=1, message="", by=Reporter("robot"))
        finally:
            reporting.cancel()
    assert (action["name"], action["timeout_s"]) == ("recalibrate", handed)


async def test_what_waits_for_a_yes_holds_up_no_other_fault(tmp_path: Path) -> None:
    """Power is given back with a yes only; a node that ends meanwhile is none of that person's business."""
    actions = {**CONFIG["actions"], "power_up": {**CONFIG["actions"]["power_up"], "policy": "approve"}}
    async with robot_of(tmp_path, actions=actions) as (runtime, robot):
        robot.cut("base")
        first = await the_repair(runtime, ended=False)
        robot.running["mapping"] = False
        await eventually(lambda: robot.done == ["start_node(mapping)"], "the node is started")
        second = await the_repair(runtime, ended=False, after=first["id"])
        await runtime.repairs.approve(second["id"], by="ann", reason="")
        repair = await the_repair(runtime)
    assert [step["text"] for step in first["plan"]] == [step["text"] for step in second["plan"]] == SHUT_DOWN
    assert (repair["id"], repair["state"]) == (second["id"], "repaired")
    assert robot.done == ["start_node(mapping)", *SHUT_DOWN]


async def waits_for_the(device: str, runtime: Runtime) -> None:
    async with asyncio.timeout(240):
        while True:
            repairs = await runtime.repairs.repairs("r1", before=None, limit=1)
            if any(f"{device} has booted" in str(one["reason"]) for one in repairs):
                return
            await asyncio.sleep(0.05)  # until the next look


async def test_while_a_device_boots_another_fault_is_mended(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """And the driver is started after that all the same."""
    monkeypatch.setattr(calm, "MEANWHILE_S", 1.0)
    booted = asyncio.Event()

    async def boots(robot: Robot, name: str, parameter: str) -> int | None:
        robot.do(name, parameter)
        robot.connected["base_node"] &= booted.is_set()
        return 0

    model = MODEL.replace("base: {channel: 7}", "base: {channel: 7, boot_s: 12}")
    async with robot_of(tmp_path, source=model) as (runtime, robot):
        robot.spoil = boots
        robot.cut("base")
        await waits_for_the("base", runtime)
        robot.running["mapping"] = False
        await eventually(lambda: "start_node(mapping)" in robot.done, "the node is started")
        assert robot.done == ["power_up(base)", "start_node(mapping)"]
        booted.set()
        repair = await the_repair(runtime)
    assert (repair["state"], robot.done.count("power_up(base)")) == ("repaired", 1)
    assert robot.done[-2:] == SHUT_DOWN[-2:]


async def test_a_driver_that_speaks_while_its_device_is_waited_for_is_neither_stopped_nor_started(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It only waits for its device, which boots for longer than what was tried at once."""
    monkeypatch.setattr(reasons, "AGAIN_S", 3000.0)

    async def boots(robot: Robot, name: str, parameter: str) -> int | None:
        robot.do(name, parameter)
        robot.connected["base_node"] = False
        return 0

    async with robot_of(tmp_path) as (runtime, robot):
        robot.spoil = boots
        robot.cut("base")
        await waits_for_the("base", runtime)
        robot.do("start_node", "base_node")
        repair = await the_repair(runtime)
    assert repair["state"] == "repaired"
    assert (robot.done.count("stop_node(base_node)"), robot.done.count("start_node(base_node)")) == (1, 1)
    assert "is back, and of the last plan nothing was done" in repair["reason"]


async def test_a_driver_is_started_for_a_third_time_once_a_device_of_unknown_boot_has_surely_booted(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Started sooner it stays mute; what was tried in vain is taken up only hours later."""
    monkeypatch.setattr(start_ups, "BOOTS_NS", 8 * 10**9)
    monkeypatch.setattr(reasons, "AGAIN_S", 3000.0)

    async def boots(robot: Robot, name: str, parameter: str) -> int | None:
        robot.do(name, parameter)
        robot.connected["base_node"] &= robot.done.count("start_node(base_node)") >= 2
        return 0

    async with robot_of(tmp_path) as (runtime, robot):
        robot.spoil = boots
        robot.cut("base")
        await waits_for_the("base", runtime)
        repair = await the_repair(runtime)
    assert repair["state"] == "repaired"
    assert robot.done.count("power_up(base)") == 1
    assert robot.done.count("start_node(base_node)") == 3


async def test_a_driver_that_nobody_restarts_is_waited_for_until_its_device_has_surely_booted(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Firmware finds its device by itself; nobody is called meanwhile, and the act is credited with it."""
    monkeypatch.setattr(start_ups, "BOOTS_NS", 20 * 10**9)

    async def boots(robot: Robot, name: str, parameter: str) -> int | None:
        robot.do(name, parameter)
        asyncio.get_running_loop().call_later(4, robot.connected.update, {"base_node": True})
        return 0

    model = MODEL.replace("base_node: {drives", "base_node: {restartable: false, drives")
    repair, robot = await repaired(tmp_path, lambda robot: robot.cut("base"), spoil=boots, source=model)
    assert (repair["state"], robot.done) == ("repaired", ["power_up(base)"]), repair["reason"]
    assert [one["helped"] for one in repair["rounds"]] == [True]


class Forgetful(Robot):
    """What it reports lives for a moment only."""

    async def report(self) -> None:
        if not self.silent:
            batch = Batch(self.sentences(), source="test robot", lifetime_s=0.4)
            await self.robots.observe(self.id, batch)


async def test_what_is_not_heard_of_when_its_repair_is_begun_is_not_begun_again_and_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """On a busy computer it may lapse between the reason and the repair."""
    carry_out, ends = RobotRepairs._carry_out, list[str]()

    async def late(self: RobotRepairs, repair: StoredRepair) -> None:
        robot.silent = True
        await settles(runtime, healthy=True)
        await carry_out(self, repair)
        ends.append(repair.id)
        robot.silent = False

    async def settles(runtime: Any, *, healthy: bool) -> None:
        async with asyncio.timeout(20):
            while True:
                state = await runtime.robots.memory.robot("r1")
                if state.current is not None and state.current.healthy is healthy:
                    return
                await asyncio.sleep(0.01)  # until the next look

    monkeypatch.setattr(RobotRepairs, "_carry_out", late)
    async with service(tmp_path) as runtime:
        async with robot_on(runtime, Forgetful, observed_timeout_s=0.5) as robot:
            await robot.settled()
            robot.cut("lidar")
            await eventually(lambda: len(ends) >= 2, "two were tried")
            await settles(runtime, healthy=False)  # heard of again: the next try is in a minute
            await asyncio.sleep(1.0)  # time itself: in which nothing may begin
            found = list(await runtime.repairs.repairs("r1", before=None, limit=9))
        assert len(found) == 2, [one["reason"] for one in found]
        assert robot.done == []


SCANNER = """
robomend: 1
name: scanner
hardware: {lidar: {channel: 3}}
nodes:
  lidar_node: {drives: [lidar], publishes: {scan: []}}
"""


@dataclass
class SlowlyJudged(Robot):
    """Its driver speaks a while after each start; the observer needs some seconds of that to say so."""

    stands: bool = False  # its evidence, once samples are there again; else each report is judged anew
    speaks_after_s: float = 0.0
    detection_s: float = 0.2
    settling_s: float = 2.5
    speaks_ns: int = 0  # since when, or from when on
    mute: bool = False

    def do(self, name: str, parameter: str) -> None:
        super().do(name, parameter)
        self.mute = False
        self.speaks_ns = CLOCK.now_ns() + round(self.speaks_after_s * 1e9)

    async def declared(self, runtime: Runtime) -> None:
        """Let its observer say how fast it is."""
        state = await runtime.robots.diagnosed(self.id)
        delays = {"ok(scan)": (self.detection_s, self.settling_s)}
        state.sight.declared.hear(declaration("observers", None, None, delays, state.system.vocabulary))

    async def report(self) -> None:
        now_ns, judges_ns = CLOCK.now_ns(), round((self.settling_s - 0.3) * 1e9)
        speaks = self.running["lidar_node"] and not self.mute and now_ns >= self.speaks_ns
        good = speaks and now_ns >= self.speaks_ns + judges_ns
        facts = {"on(lidar)": True, "running(lidar_node)": self.running["lidar_node"], "ok(scan)": good}
        scan_ns = now_ns - round(self.detection_s * 1e9)
        if speaks and (self.stands or good):
            scan_ns = now_ns - judges_ns if good else self.speaks_ns - round(self.detection_s * 1e9)
        batch = Batch(
            [fact if value else f"not {fact}" for fact, value in facts.items()],
            source="observers",
            time_ns=now_ns,
            since=(now_ns, now_ns, scan_ns),
        )
        await self.robots.observe(self.id, batch)


@pytest.mark.parametrize(
    "kind",
    [{"stands": True, "speaks_after_s": 0.8}, {}],
    ids=["heard again, late", "judged anew each time"],
)
async def test_no_act_is_in_vain_before_a_slow_observer_has_settled(
    tmp_path: Path, kind: dict[str, Any]
) -> None:
    observed = ["on(lidar)", "running(lidar_node)", "ok(scan)"]
    about = {"observed": observed, "allow": ["start_node", "stop_node"]}
    async with robot_of(tmp_path, partial(SlowlyJudged, **kind), SCANNER, **about) as (runtime, robot):
        await robot.declared(runtime)
        robot.mute = True
        repair = await the_repair(runtime)
    assert robot.done == ["stop_node(lidar_node)", "start_node(lidar_node)"]
    assert repair["state"] == "repaired", repair["reason"]


@dataclass
class Rebooting(Robot):
    """Its device begins anew by itself, which nobody sees; a driver that is started meanwhile stays mute."""

    ends: bool = False  # the driver, with its device; else it runs on, mute
    booted: bool = True
    speaks: bool = True

    def reboot(self) -> None:
        self.booted = self.speaks = False
        self.running["lidar_node"] = not self.ends

    def do(self, name: str, parameter: str) -> None:
        super().do(name, parameter)
        self.speaks = self.running[parameter] and self.booted

    def facts(self) -> dict[str, bool]:
        runs = self.running["lidar_node"]
        return {"running(lidar_node)": runs, "ok(scan)": runs and self.speaks}


@pytest.mark.parametrize("ends", [True, False], ids=["its driver ends", "its driver is mute"])
async def test_a_driver_that_was_started_while_its_device_may_boot_is_started_later_before_a_person_is_called(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, ends: bool
) -> None:
    monkeypatch.setattr(start_ups, "BOOTS_NS", 120 * 10**9)
    acts = {name: CONFIG["actions"][name] for name in ("start_node", "stop_node")}
    plugged = SCANNER.replace("{channel: 3}", "{}")  # nobody switches its power
    kind = partial(Rebooting, ends=ends)
    async with robot_of(tmp_path, kind, plugged, actions=acts) as (runtime, robot):
        robot.reboot()
        await waits_for_the("lidar", runtime)
        robot.booted = True
        monkeypatch.setattr(start_ups, "BOOTS_NS", 0)
        repair = await the_repair(runtime)
    assert repair["state"] == "repaired", repair["reason"]
    assert robot.done.count("start_node(lidar_node)") == 3
