"""Verified means verified: what was seen before an act confirms nothing of what came of it."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from math import inf
from pathlib import Path
from typing import Any

import pytest
from tests.repairs.robot import (
    CONFIG,
    MODEL,
    OBSERVED,
    SHUT_DOWN,
    Robot,
    repaired,
    robot_of,
    robot_on,
    running,
    service,
    the_repair,
)
from tests.waiting import eventually

from robomend.errors import InputError
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
    async with robot_of(path, robot_class, **changes) as (runtime, robot):
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

    repair, robot = await repaired(tmp_path, lambda robot: robot.running.update(mapping=False), kind=OnChange)
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
    await eventually(lambda: state.current.healthy, "the service knows")


async def test_a_fault_that_comes_and_goes_is_told_once_and_repaired_when_it_stays(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    choose, stays = Chooser.choose_in_turn, False
    monkeypatch.setattr(flapping, "STEADY_S", 0.5)

    async with robot_of(tmp_path) as (runtime, robot):

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


async def test_who_is_cleared_while_it_is_planned_for_is_left_alone(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The map fails before the scan that it rests on; beside it the base has no power, which stands."""

    class Late(Robot):
        def do(self, name: str, parameter: str) -> None:
            super().do(name, parameter)
            if (name, parameter) == ("start_node", "lidar_node"):
                self.broken_topics.clear()

    choose, planned = Chooser.choose_in_turn, list[tuple[str, ...]]()
    async with robot_of(tmp_path, Late) as (runtime, robot):

        async def slow(chooser: Chooser, state: Any, result: Any, **options: Any) -> Any:
            found: Any = await choose(chooser, state, result, **options)
            if options.get("looks"):
                planned.append(found.diagnosis.bad)
                robot.broken_topics.add("scan")
                await eventually(lambda: ("base", "lidar") in state.current.bad_sets, "the service knows")
            return found

        monkeypatch.setattr(Chooser, "choose_in_turn", slow)
        robot.broken_topics.add("map")
        robot.cut("base")
        repair = await the_repair(runtime)
    assert planned[0] == ("base", "mapping")
    assert repair["state"] == "repaired", repair["reason"]
    assert not [one for one in robot.done if "mapping" in one]


# --- evidence that is odd: never judged anew, from before the robot, of a clock that is wrong

S = 10**9


class WithAgent(Robot):
    """Its agent reports with a lifetime, and says that it observes; `since`: what its verdicts rest on."""

    asks = True
    skew_s = 0  # how far its clock is ahead of the service's

    async def report(self) -> None:
        if self.silent:
            return
        if self.asks:
            await self.repairs.orders(
                "r1",
                host=None,
                wait_s=0.0,
                agent="onboard",
                can=[],  # it observes; what is to be done, the robot itself does
                observes={"ok(scan)": (0.1, 0.1), "ok(map)": (0.1, 0.1)},
                settled=None,
            )
        sentences, now_ns = self.sentences(), CLOCK.now_ns() + self.skew_s * S
        since = self.since(sentences, now_ns)
        await self.robots.observe(
            "r1", Batch(sentences, source="agent", time_ns=now_ns, since=since, lifetime_s=2.0)
        )

    def since(self, sentences: Sequence[str], now_ns: int) -> Sequence[int | None]:
        return [now_ns] * len(sentences)


async def mended(path: Path, kind: Callable[..., WithAgent], **changes: Any) -> dict[str, Any]:
    """Return the repair of a robot whose node `mapping` has ended."""
    async with robot_of(path, kind, **changes) as (runtime, robot):
        robot.running["mapping"] = False
        repair = await the_repair(runtime)
    assert robot.done[:1] == ["start_node(mapping)"]
    return repair


@dataclass
class OldEvidence(WithAgent):
    """What it says of the map rests on what was there before the node ended, for ever or for a while."""

    skew_s: int = 0
    held_up_s: float = inf
    seen_ns: int = 0
    acted_s: float | None = None

    def sentences(self) -> list[str]:
        return [one.removeprefix("not ") if "(map)" in one else one for one in super().sentences()]

    def since(self, sentences: Sequence[str], now_ns: int) -> Sequence[int | None]:
        now_s = asyncio.get_running_loop().time()
        if self.done and self.acted_s is None:
            self.acted_s = now_s
        looks_again = self.acted_s is not None and now_s > self.acted_s + self.held_up_s
        self.seen_ns = now_ns if looks_again else self.seen_ns or now_ns
        return [self.seen_ns if "(map)" in one else now_ns for one in sentences]


@pytest.mark.parametrize("skew_s", [0, -300], ids=["", "a clock that is minutes behind"])
async def test_old_evidence_confirms_nothing(tmp_path: Path, skew_s: int) -> None:
    repair = await mended(tmp_path, partial(OldEvidence, skew_s=skew_s))
    assert repair["state"] == "escalated"
    assert "nobody could confirm ok(map)" in repair["reason"]


async def test_an_observer_that_is_held_up_is_waited_for_as_long_as_observers_are(tmp_path: Path) -> None:
    """Its agent runs and reports; only that it cannot judge for a while, as on a computer at its limit."""
    repair = await mended(tmp_path, partial(OldEvidence, held_up_s=4.0), observed_timeout_s=30.0)
    assert repair["state"] == "repaired", repair["reason"]


async def test_since_in_the_services_future_confirms_nothing_before_it_is_seen(tmp_path: Path) -> None:
    class Ahead(WithAgent):
        """What it says of the map is stamped ahead of the rest, and rests on what was there before."""

        ahead_s = 50
        seen_ns = 0

        async def report(self) -> None:
            now_ns = CLOCK.now_ns()
            self.seen_ns = self.seen_ns or now_ns
            sentences = [one for one in self.sentences() if "(map)" not in one]
            await self.robots.observe(
                "r1", Batch(sentences, source="agent", time_ns=now_ns, since=[now_ns] * len(sentences))
            )
            stamp_ns = now_ns + self.ahead_s * S
            await self.robots.observe(
                "r1",
                Batch(
                    ["ok(map)"],
                    source="agent",
                    time_ns=stamp_ns,
                    since=[self.seen_ns + self.ahead_s * S],
                    lifetime_s=120.0,
                ),
            )

    repair = await mended(tmp_path, Ahead)
    assert repair["state"] == "escalated"
    assert "nobody could confirm ok(map)" in repair["reason"]


async def test_since_after_the_batchs_own_time_is_refused_and_nothing_of_it_is_kept(tmp_path: Path) -> None:
    async with robot_of(tmp_path) as (runtime, robot):
        before = runtime.robots.memory.states["r1"].obs.entries()
        robot.silent = True
        now_ns = CLOCK.now_ns()
        late = Batch(["not ok(map)", "not ok(scan)"], time_ns=now_ns, since=[now_ns, now_ns + 1])
        with pytest.raises(InputError, match=r"since\[1\]: .* is after the time of the batch"):
            await runtime.robots.observe("r1", late)
        after = runtime.robots.memory.states["r1"].obs.entries()
    assert {entry.literal for entry in after} == {entry.literal for entry in before}


async def test_what_cannot_be_judged_while_what_is_blamed_fails_is_not_waited_for(tmp_path: Path) -> None:
    """Who watches the map has nothing to say without scans; the lidar needs a power cycle."""

    class Compares(WithAgent):
        async def report(self) -> None:
            if self.silent:
                return
            now_ns, sentences = CLOCK.now_ns(), self.sentences()
            blind = "not ok(scan)" in sentences
            said = [one for one in sentences if not (blind and "(map)" in one)]
            unknown = ["ok(map)"] if blind else []
            since = [now_ns] * len(said)
            await self.robots.observe(
                "r1", Batch(said, source="agent", time_ns=now_ns, since=since, unknown=unknown)
            )

    async def hangs(robot: Robot, name: str, parameter: str) -> int | None:
        robot.do(name, parameter)
        cut = "power_up(lidar)" in robot.done
        robot.connected["lidar_node"] &= cut
        return 0

    async with robot_of(tmp_path, Compares, observed_timeout_s=120.0) as (runtime, robot):
        robot.spoil = hangs
        robot.connected["lidar_node"] = False
        repair = await the_repair(runtime)
    assert (repair["state"], len(repair["rounds"])) == ("repaired", 2), repair["reason"]


async def test_a_fault_before_two_values_were_ever_compared_is_repaired_without_the_comparison(
    tmp_path: Path,
) -> None:
    """The robot has just come up; that its base has no power is seen, and with it that odometry is silent."""
    values = "values: {yaw: {topic: odom, field: yaw}, turn: {topic: scan, field: yaw}}"
    model = f"{MODEL}{values}\nrelated: [[yaw, turn]]\n"
    observed = [*OBSERVED, "matched(turn,yaw)"]

    class Compares(WithAgent):
        async def report(self) -> None:
            if self.silent:
                return
            now_ns, sentences = CLOCK.now_ns(), self.sentences()
            said = [*sentences, "matched(turn,yaw)"] if self.done and "ok(odom)" in sentences else sentences
            await self.robots.observe(
                "r1", Batch(said, source="agent", time_ns=now_ns, since=[now_ns] * len(said))
            )

    about = {"observed": observed, "observed_timeout_s": 120.0}
    async with robot_of(tmp_path, Compares, model, **about) as (runtime, robot):
        robot.cut("base")
        repair = await the_repair(runtime)
    assert (repair["state"], robot.done) == ("repaired", SHUT_DOWN), repair["reason"]


async def test_reports_that_are_rarer_than_their_lifetimes_do_not_make_everything_young_again(
    tmp_path: Path,
) -> None:
    """Each lapses for a moment before it is said again; what runs has not begun anew with that."""

    class Rare(Robot):
        said: tuple[float, tuple[str, ...]] = (0.0, ())

        async def report(self) -> None:
            sentences, now_ns = tuple(self.sentences()), CLOCK.now_ns()
            if sentences == self.said[1] and time.monotonic() < self.said[0] + 0.6:
                return
            self.said = (time.monotonic(), sentences)
            about: dict[str, Any] = {"since": (now_ns,) * len(sentences), "lifetime_s": 0.5}
            await self.robots.observe("r1", Batch(sentences, source="agent", time_ns=now_ns, **about))

        def do(self, name: str, parameter: str) -> None:
            super().do(name, parameter)
            if name == "start_node":
                self.broken_topics.clear()

    about: dict[str, Any] = {"actions": {name: {"executor": {"kind": "agent"}} for name in CONFIG["actions"]}}
    async with robot_of(tmp_path, Rare, **about) as (runtime, robot):
        await asyncio.sleep(6)  # all that runs has run for longer than a start takes
        robot.broken_topics.add("map")
        repair = await the_repair(runtime)
    assert (repair["state"], robot.done) == ("repaired", ["stop_node(mapping)", "start_node(mapping)"])
    assert repair["rounds"][0]["plan"][0]["sent_ns"] - repair["created_ns"] < 4e9
