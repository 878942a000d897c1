"""Evidence that is odd: of nobody any more, never judged anew, from before the robot, from an older agent."""

from __future__ import annotations

import asyncio
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import pytest
from tests.repairs.robot import Robot, robot_on, running, service, the_repair

from robomend.errors import InputError
from robomend.robots.batches import Batch
from robomend.robots.clock import CLOCK
from robomend_client.literals import Atom

pytestmark = pytest.mark.anyio

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


async def mended(path: Path, robot_class: type[WithAgent], **changes: Any) -> dict[str, Any]:
    """Return the repair of a robot whose node `mapping` has ended."""
    async with service(path) as runtime:
        async with robot_on(runtime, **changes):
            pass  # it is configured
        robot = robot_class(runtime.repairs, runtime.robots)
        async with running(robot):
            await robot.settled()
            robot.running["mapping"] = False
            repair = await the_repair(runtime)
    assert robot.done[:1] == ["start_node(mapping)"]
    return repair


async def test_an_observer_that_never_judges_anew_confirms_nothing(tmp_path: Path) -> None:
    class Never(WithAgent):
        """What it says of topics rests for ever on what it saw before the node ended."""

        seen_ns = 0

        def sentences(self) -> list[str]:
            return [one.removeprefix("not ") if "(map)" in one else one for one in super().sentences()]

        def since(self, sentences: Sequence[str], now_ns: int) -> Sequence[int | None]:
            self.seen_ns = self.seen_ns or now_ns
            return [self.seen_ns if "(map)" in one else now_ns for one in sentences]

    repair = await mended(tmp_path, Never)
    assert repair["state"] == "escalated"
    assert "nobody could confirm ok(map)" in repair["reason"]


async def test_a_robot_whose_clock_is_minutes_behind_is_not_called_repaired_on_old_evidence(
    tmp_path: Path,
) -> None:
    class Skewed(WithAgent):
        """What it says of the map rests on what was there before the node ended, by its own clock."""

        skew_s = -300
        seen_ns = 0

        def sentences(self) -> list[str]:
            return [one.removeprefix("not ") if "(map)" in one else one for one in super().sentences()]

        def since(self, sentences: Sequence[str], now_ns: int) -> Sequence[int | None]:
            self.seen_ns = self.seen_ns or now_ns
            return [self.seen_ns if "(map)" in one else now_ns for one in sentences]

    repair = await mended(tmp_path, Skewed)
    assert repair["state"] == "escalated"
    assert "nobody could confirm ok(map)" in repair["reason"]


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
    async with service(tmp_path) as runtime, robot_on(runtime) as robot:
        await robot.settled()
        before = runtime.robots.memory.states["r1"].obs.entries()
        robot.silent = True
        now_ns = CLOCK.now_ns()
        late = Batch(["not ok(map)", "not ok(scan)"], time_ns=now_ns, since=[now_ns, now_ns + 1])
        with pytest.raises(InputError, match=r"since\[1\]: .* is after the time of the batch"):
            await runtime.robots.observe("r1", late)
        after = runtime.robots.memory.states["r1"].obs.entries()
    assert {entry.literal for entry in after} == {entry.literal for entry in before}


@pytest.mark.parametrize("minutes", [2, 5, 60])
async def test_a_robot_whose_clock_is_minutes_ahead_is_told_so_and_not_believed(
    tmp_path: Path, minutes: int
) -> None:
    async with service(tmp_path) as runtime, robot_on(runtime) as robot:
        await robot.settled()
        time_ns = CLOCK.now_ns() + minutes * 60 * S
        with pytest.raises(
            InputError, match="s ahead of this service's clock; 60 are allowed: set the sender's clock"
        ):
            await runtime.robots.observe("r1", Batch(["not ok(map)"], time_ns=time_ns, since=[time_ns]))
        assert runtime.robots.memory.states["r1"].sight.value(Atom("ok", ("map",))) is True


@pytest.mark.parametrize("held_up_s", [4.0])
async def test_an_observer_that_is_held_up_is_waited_for_as_long_as_observers_are(
    tmp_path: Path, held_up_s: float
) -> None:
    """Its agent runs and reports; only that it cannot judge for a while, as on a computer at its limit."""

    class HeldUp(WithAgent):
        started_s: float | None = None
        seen_ns = 0

        def since(self, sentences: Sequence[str], now_ns: int) -> Sequence[int | None]:
            now_s = asyncio.get_running_loop().time()
            if self.done and self.started_s is None:
                self.started_s = now_s
            self.seen_ns = self.seen_ns or now_ns
            if self.started_s is not None and now_s > self.started_s + held_up_s:
                self.seen_ns = now_ns
            return [self.seen_ns if "(map)" in one else now_ns for one in sentences]

        def sentences(self) -> list[str]:
            return [one.removeprefix("not ") if "(map)" in one else one for one in super().sentences()]

    repair = await mended(tmp_path, HeldUp, observed_timeout_s=30.0)
    assert repair["state"] == "repaired", repair["reason"]


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

    async with service(tmp_path) as runtime:
        async with robot_on(runtime, observed_timeout_s=120.0):
            pass  # it is configured
        robot = Compares(runtime.repairs, runtime.robots)
        robot.spoil = hangs
        async with running(robot):
            await robot.settled()
            robot.connected["lidar_node"] = False
            repair = await the_repair(runtime)
    assert (repair["state"], len(repair["rounds"])) == ("repaired", 2), repair["reason"]
