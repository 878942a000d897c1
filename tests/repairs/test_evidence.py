"""Verified means verified: what was seen before an act confirms nothing of what came of it."""

from __future__ import annotations

import asyncio
from pathlib import Path
from typing import Any

import pytest
from tests.repairs.robot import CONFIG, Robot, robot_on, running, service, the_repair

from robomend.repairs import flapping
from robomend.repairs.choosing import Chooser
from robomend.robots.batches import Batch
from robomend.robots.clock import CLOCK

pytestmark = pytest.mark.anyio


class WithMuteSuccessor(Robot):
    """The lidar's driver dies within its observer's window; what is started in its place says nothing.

    The observer's window never runs empty, so it goes on saying `ok(scan)` with the evidence of back then.
    """

    died_ns = 0

    def die(self) -> None:
        self.died_ns = CLOCK.now_ns()
        self.running["lidar_node"] = False

    def sentences(self) -> list[str]:
        said = super().sentences()
        windows = {"not ok(scan)": "ok(scan)", "not ok(map)": "ok(map)"} if self.died_ns else {}
        return [windows.get(sentence, sentence) for sentence in said]

    async def report(self) -> None:
        now_ns = CLOCK.now_ns()
        sentences = self.sentences()
        old = {"ok(scan)", "ok(map)"} if self.died_ns else set()
        since = [min(now_ns, self.died_ns - 1) if one in old else now_ns for one in sentences]
        batch = Batch(sentences, source="test robot", time_ns=now_ns, since=since, lifetime_s=2.0)
        await self.robots.observe("r1", batch)


async def a_repair(path: Path, robot_class: type[Robot], **changes: Any) -> tuple[dict[str, Any], Robot]:
    async with service(path) as runtime:
        async with robot_on(runtime, **changes):
            pass  # it is configured
        robot = robot_class(runtime.repairs, runtime.robots)
        async with running(robot):
            await robot.settled()
            assert isinstance(robot, WithMuteSuccessor)
            robot.die()
            return await the_repair(runtime), robot


async def test_observers_that_judge_anew_see_the_mute_successor_and_it_is_restarted(tmp_path: Path) -> None:
    class WithAgent(WithMuteSuccessor):
        """Its agent hears `settle`, drops its samples, and says what it sees then."""

        successors = 0
        judged: int | None = None

        async def report(self) -> None:
            if not self.died_ns:
                await super().report()
                return
            orders = await self.repairs.orders(
                "r1",
                host=None,
                wait_s=0.0,
                agent="onboard",
                can=[],  # it observes; what is to be done, the robot itself does
                observes={"ok(scan)": (0.1, 0.1), "ok(map)": (0.1, 0.1)},
                settled=self.judged,
            )
            if orders is not None:
                self.judged = orders["settle"]["n"]
            speaks = self.running["lidar_node"] and self.successors > 1
            if self.judged is not None:
                verdicts = ["ok(scan)", "ok(map)"] if speaks else ["not ok(scan)", "not ok(map)"]
                batch = Batch(verdicts, source="agent", settled=self.judged, lifetime_s=2.0)
                await self.robots.observe("r1", batch)
            facts = [one for one in Robot.sentences(self) if "(scan)" not in one and "(map)" not in one]
            since = [CLOCK.now_ns()] * len(facts)
            await self.robots.observe("r1", Batch(facts, source="test robot", time_ns=since[0], since=since))

        def do(self, name: str, parameter: str) -> None:
            super().do(name, parameter)
            self.successors += (name, parameter) == ("start_node", "lidar_node")

    repair, robot = await a_repair(tmp_path, WithAgent)
    assert robot.done.count("start_node(lidar_node)") == 2
    assert repair["state"] == "repaired", repair["reason"]


async def test_who_speaks_on_change_only_is_not_waited_for_for_ever_and_the_repair_says_so(
    tmp_path: Path,
) -> None:
    class OnChange(Robot):
        told: frozenset[str] = frozenset()

        async def report(self) -> None:
            sentences = self.sentences()
            news = [one for one in sentences if one not in self.told]
            self.told = frozenset(sentences)
            if news:
                await self.robots.observe("r1", Batch(news, source="curl"))

    async with service(tmp_path) as runtime:
        async with robot_on(runtime):
            pass
        robot = OnChange(runtime.repairs, runtime.robots)
        async with running(robot):
            await robot.settled()
            robot.running["mapping"] = False
            repair = await the_repair(runtime)
    assert repair["state"] == "unconfirmed"  # it cannot be told from an observer that is dead
    assert repair["reason"].endswith("who observes it speaks on change only")
    assert robot.done == ["start_node(mapping)"]


async def test_a_repair_waits_for_a_verdict_that_could_change_its_first_act(tmp_path: Path) -> None:
    """Two topics fall silent together, and one observer is slower: what it will say is the cause."""

    class Slow(Robot):
        fell_ns = 0
        scan_late_s = 0.8

        async def report(self) -> None:
            now_ns = CLOCK.now_ns()
            sentences, since = self.sentences(), []
            if self.fell_ns and now_ns - self.fell_ns < self.scan_late_s * 1e9:
                sentences = [one.replace("not ok(scan)", "ok(scan)") for one in sentences]
            for one in sentences:
                late = self.fell_ns and "scan" in one and not self.connected["lidar_node"]
                since.append(self.fell_ns - 1 if late else now_ns)
            await self.robots.observe("r1", Batch(sentences, time_ns=now_ns, since=since))

    config = {**CONFIG, "detection_s": 1.2}
    async with service(tmp_path) as runtime, robot_on(runtime, **config):
        pass
    async with service(tmp_path) as runtime:
        robot = Slow(runtime.repairs, runtime.robots)
        async with running(robot):
            await robot.settled()
            robot.fell_ns = CLOCK.now_ns()
            robot.connected["lidar_node"] = False  # scan, and with it map, is silent
            repair = await the_repair(runtime)
    assert repair["state"] == "repaired", repair["reason"]
    assert robot.done == ["stop_node(lidar_node)", "start_node(lidar_node)"]  # not mapping


async def well_meanwhile(robot: Robot, state: Any) -> None:
    """Have the fault end by itself, and wait until the service knows."""
    robot.running["mapping"] = True
    async with asyncio.timeout(60):
        while not state.current.healthy:
            await asyncio.sleep(0.01)


async def test_a_fault_that_comes_and_goes_is_told_once_and_repaired_when_it_stays(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    choose, stays = Chooser.choose_in_turn, False
    monkeypatch.setattr(flapping, "STEADY_S", 0.5)

    async with service(tmp_path) as runtime, robot_on(runtime) as robot:
        await robot.settled()

        async def slow(chooser: Chooser, state: Any, result: Any, **options: Any) -> Any:
            """Plan for longer than the fault lasts, as long as it does not stay."""
            found = await choose(chooser, state, result, **options)
            if not stays:
                await well_meanwhile(robot, state)
            return found

        monkeypatch.setattr(Chooser, "choose_in_turn", slow)
        ended: list[str] = []
        for number in range(flapping.TIMES):
            robot.running["mapping"] = False
            async with asyncio.timeout(60):
                while len(repairs := await runtime.repairs.repairs("r1", before=None, limit=20)) <= number:
                    await asyncio.sleep(0.02)
            ended.append((await the_repair(runtime))["state"])
        told = await the_repair(runtime)
        stays = True
        robot.running["mapping"] = False
        async with asyncio.timeout(60):
            while len(repairs) == len(await runtime.repairs.repairs("r1", before=None, limit=20)):
                await asyncio.sleep(0.02)
        mended = await the_repair(runtime)
    assert ended == ["repaired"] * (flapping.TIMES - 1) + ["escalated"]
    assert told["reason"].startswith(f"it comes and goes: {flapping.TIMES} times within ")
    assert "suspects: mapping." in told["reason"]
    assert mended["state"] == "repaired"
    assert robot.done == ["start_node(mapping)"]
