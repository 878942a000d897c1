"""What a repair is credited with: what came of its acts and stayed, not what came back by itself."""

from __future__ import annotations

import asyncio
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from tests.repairs.robot import Robot, robot_of, robot_on, running, service, the_repair

from robomend.api.runtime import Runtime
from robomend.planning.quarantine import DEFAULT_PATIENCE
from robomend.repairs import calm
from robomend.repairs.account import account
from robomend.repairs.choosing import Chooser
from robomend.repairs.remembering import Remembered, remembered
from robomend.robots.batches import Batch
from robomend.robots.clock import CLOCK
from robomend.robots.declared import declaration
from robomend_client.readings import Symptom

pytestmark = pytest.mark.anyio


async def known(runtime: Runtime) -> Remembered:
    return await runtime.store.read(lambda view: remembered(view, "r1", DEFAULT_PATIENCE))


async def test_what_was_back_before_the_act_was_sent_is_credited_to_nobody(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    class Late(Robot):
        """Its map node is started by somebody else, and its observer tells of that after the repair's act."""

        as_it_was: Sequence[str] = ()
        back_ns = 0
        told = False

        def sentences(self) -> list[str]:
            return list(self.as_it_was) if self.back_ns and not self.done else super().sentences()

        async def report(self) -> None:
            sentences, now_ns = self.sentences(), CLOCK.now_ns()
            back = self.back_ns if self.back_ns and self.done and not self.told else now_ns
            since = [back if "map" in one else now_ns for one in sentences]
            self.told = self.told or back != now_ns
            await self.robots.observe(self.id, Batch(sentences, time_ns=now_ns, since=since))

    choose = Chooser.choose_in_turn
    async with service(tmp_path) as runtime:
        async with robot_on(runtime, detection_s=0.1):
            pass
        robot = Late(runtime.repairs, runtime.robots)

        async def meanwhile(chooser: Chooser, *about: Any, **options: Any) -> Any:
            found = await choose(chooser, *about, **options)
            if not robot.back_ns:
                robot.as_it_was, robot.back_ns = robot.sentences(), CLOCK.now_ns() - 200_000_000
                robot.running["mapping"] = True
            return found

        monkeypatch.setattr(Chooser, "choose_in_turn", meanwhile)
        async with running(robot):
            await robot.settled()
            robot.running["mapping"] = False
            repair = await the_repair(runtime)
        memory = await known(runtime)
    assert robot.done == ["start_node(mapping)"]
    assert repair["state"] == "repaired", repair["reason"]
    assert "nothing that was done is credited with it" in repair["reason"]
    [done] = repair["rounds"]
    assert done["helped"] is False
    assert done["by_itself"].endswith(" was back before anything was done that influences it")
    assert any("credited to nobody" in line for line in account(repair))
    assert memory.tried == ()


async def test_what_came_of_an_act_on_another_robot_of_the_model_is_known_here(tmp_path: Path) -> None:
    async with service(tmp_path) as runtime:
        async with robot_on(runtime) as robot:
            await robot.settled()
            robot.running["mapping"] = False
            assert (await the_repair(runtime))["state"] == "repaired"
        await runtime.robots.put_robot("r2", {"model": "small"}, expected=None, by="test")
        here = await known(runtime)
        there = await runtime.store.read(lambda view: remembered(view, "r2", DEFAULT_PATIENCE))
    assert [(one.component, set(one.acts), one.helped, one.fleet) for one in here.outcomes] == [
        ("mapping", {"restart"}, True, False)
    ]
    assert there.outcomes == tuple(replace(one, fleet=True) for one in here.outcomes)
    assert there.tried == ()


async def test_what_fails_again_within_its_observers_time_was_never_repaired(tmp_path: Path) -> None:
    """After each restart its observer says at once that all is well, and needs a second to see that not."""

    class SoonBack(Robot):
        until_ns = 0
        broken = False

        def sentences(self) -> list[str]:
            self.broken_topics = {"scan", "map"} if self.broken and CLOCK.now_ns() > self.until_ns else set()
            return super().sentences()

        def do(self, name: str, parameter: str) -> None:
            super().do(name, parameter)
            if name == "start_node":
                self.until_ns = CLOCK.now_ns() + 600_000_000

    async with robot_of(tmp_path, SoonBack, detection_s=1.0) as (runtime, robot):
        robot.broken = True
        repair = await the_repair(runtime)
        repairs = await runtime.repairs.repairs("r1", before=None, limit=10)
    assert "start_node(lidar_node)" in robot.done
    assert repair["state"] == "escalated", repair["reason"]
    assert not any(done["helped"] for one in repairs for done in one["rounds"])


async def test_silence_that_is_over_is_believed_as_soon_as_it_would_be_noticed_again(tmp_path: Path) -> None:
    """A rate that is a little too slow takes its observer half a minute, and is not what was wrong."""
    async with service(tmp_path) as runtime, robot_on(runtime) as robot:
        robot.kinds = {"ok(scan)": Symptom.SILENT, "ok(map)": Symptom.SILENT}
        await robot.settled()
        state = await runtime.robots.diagnosed("r1")
        slow = {"ok(scan)": (0.2, 90.0), "ok(map)": (0.2, 90.0)}
        state.sight.declared.hear(declaration("observers", None, (), slow, state.system.vocabulary))
        robot.cut("lidar")
        repair = await the_repair(runtime, timeout_s=60)  # not 90
    assert repair["state"] == "repaired"
    assert [done["helped"] for done in repair["rounds"]] == [True]


class TwoHosts(Robot):
    """The lidar, its driver and their agent are on another host than the map; a link is between them."""

    link = True

    def drop(self, for_s: float | None) -> None:
        """The link drops, for some time, or until a while after the first act."""
        self.link = False
        if for_s is not None:
            asyncio.get_running_loop().call_later(for_s, setattr, self, "link", True)

    def do(self, name: str, parameter: str) -> None:
        super().do(name, parameter)
        asyncio.get_running_loop().call_later(0.3, setattr, self, "link", True)

    async def spoken(self) -> None:
        """Let it be known how often each of them speaks."""
        for _ in range(8):
            await self.settled()
            await asyncio.sleep(0.06)  # time itself: its rhythm

    async def report(self) -> None:
        now_ns = CLOCK.now_ns()
        for far in (True, False):
            said = [one for one in self.sentences() if ("lidar" in one or "scan" in one) is far]
            if far and not self.link:
                continue
            if not self.link:
                said = [one.replace("ok(map)", "not ok(map)") for one in said]
            since = (now_ns,) * len(said)
            batch = Batch(said, source="far" if far else "near", time_ns=now_ns, since=since, lifetime_s=20.0)
            await self.robots.observe(self.id, batch)


async def test_who_is_not_heard_since_the_symptom_began_vouches_for_nothing_after_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(calm, "CUT_OFF_NS", 10**9)
    async with service(tmp_path) as runtime:
        async with robot_on(runtime, TwoHosts, detection_s=0.2) as robot:
            await robot.spoken()
            robot.drop(None)
            repair = await the_repair(runtime)
        memory = await known(runtime)
    first = repair["rounds"][0]
    suspects = {tuple(first["diagnosis"]["bad"]), *(tuple(one["bad"]) for one in first["rivals"])}
    assert {("mapping",), ("lidar_node",), ("lidar",)} <= suspects  # ok(scan) is from before the link fell
    assert repair["state"] == "repaired", repair["reason"]
    # The link was back while a node was restarted: nobody knows whether that helped.
    assert not any(done["helped"] for done in repair["rounds"])
    assert "far is, which was not heard for" in repair["rounds"][-1]["by_itself"]
    assert not any(one.helped for one in memory.tried)


async def test_who_speaks_on_change_only_vouches_for_what_it_said(tmp_path: Path) -> None:
    """The lidar's host says nothing as nothing changes there: the map's own node it is."""

    class OnChange(TwoHosts):
        told: frozenset[str] = frozenset()

        async def report(self) -> None:
            far = [one for one in self.sentences() if "lidar" in one or "scan" in one]
            news = [one for one in far if one not in self.told]
            if news:
                await self.robots.observe(self.id, Batch(news, source="far"))
            self.told |= set(far)
            near, now_ns = [one for one in self.sentences() if one not in far], CLOCK.now_ns()
            batch = Batch(near, source="near", time_ns=now_ns, since=(now_ns,) * len(near), lifetime_s=20.0)
            await self.robots.observe(self.id, batch)

    async with service(tmp_path) as runtime, robot_on(runtime, OnChange, detection_s=0.2) as robot:
        await robot.spoken()
        robot.running["mapping"] = False
        repair = await the_repair(runtime)
    assert robot.done == ["start_node(mapping)"]
    assert repair["state"] == "repaired", repair["reason"]
