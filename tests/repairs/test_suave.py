"""examples/suave against a stand-in of its nodes: the published uncertainties, at a multiple of their speed.

`--long` runs at the speed of the exemplar, and prints for how long the altitude was wrong.
"""

from __future__ import annotations

import asyncio
import math
import time
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import pytest
import yaml
from tests.repairs.robot import Robot, running, service
from tests.repairs.test_changes import changes_of
from tests.waiting import eventually

from robomend.robots.batches import Batch
from robomend.robots.clock import CLOCK
from robomend.robots.reporters import Reporter
from robomend.store import attempts

pytestmark = pytest.mark.anyio

SUAVE = Path(__file__).parents[2] / "examples" / "suave"

PERIOD_S, LASTS_S, FAILS_S, RECOVERS_S = 80.0, 110.0, 35.0, 5.0
LOOKS_S = 0.1  # of the exemplar's time


@dataclass
class Suave(Robot):
    """Its visibility is 2.5 ± 1.25 m; thruster 1 fails once, and is recovered in the mode for that."""

    speed: float = 10.0
    began_s: float = field(default_factory=time.monotonic)
    modes: dict[str, str] = field(
        default_factory=lambda: {
            "f_generate_search_path_node": "fd_spiral_medium",
            "f_maintain_motion_node": "fd_all_thrusters",
        }
    )
    flown: list[str] = field(default_factory=list)
    wrong_s: float = 0.0
    failed_s: float | None = None
    asked_s: float | None = None  # when its recovery was asked for
    recovered: bool = False

    @property
    def now_s(self) -> float:
        return (time.monotonic() - self.began_s) * self.speed

    @property
    def visibility(self) -> float:
        return 2.5 + 1.25 * math.sin(2 * math.pi * self.now_s / PERIOD_S)

    def sentences(self) -> list[str]:
        if self.asked_s is not None and self.now_s > self.asked_s + RECOVERS_S:
            self.recovered = True
        if self.failed_s is None and self.now_s >= FAILS_S:
            self.failed_s = self.now_s
        broken = self.failed_s is not None and not self.recovered
        facts = {"ok(sees_high)": self.visibility >= 3.25, "ok(sees_medium)": self.visibility >= 2.25}
        facts |= {f"ok(thruster_{number})": not (broken and number == 1) for number in range(1, 7)}
        facts |= {f"running({node})": True for node in self.modes}
        said = [fact if value else f"not {fact}" for fact, value in facts.items()]
        search, motion = self.modes.values()
        return [*said, f"active(search, {search})", f"active(motion, {motion})"]

    async def report(self) -> None:
        sentences, now_ns = tuple(self.sentences()), CLOCK.now_ns()
        batch = Batch(sentences, source="suave", time_ns=now_ns, since=(now_ns,) * len(sentences))
        await self.robots.observe(self.id, batch)

    async def report_for_ever(self) -> None:
        looked_s = self.now_s
        while True:
            await self.report()
            best = "high" if self.visibility >= 3.25 else "medium" if self.visibility >= 2.25 else "low"
            now_s, mode = self.now_s, self.modes["f_generate_search_path_node"]
            if now_s < LASTS_S and mode != f"fd_spiral_{best}":
                self.wrong_s += now_s - looked_s
            looked_s = now_s
            await asyncio.sleep(LOOKS_S / self.speed)  # the vehicle's own rhythm

    async def act_for_ever(self) -> None:
        while True:
            action = await self.repairs.orders(self.id, host=None, wait_s=5.0)
            if action is None:
                continue
            assert action["name"] == "change_mode"
            node, mode = action["parameters"]
            self.modes[node] = mode
            self.flown.append(mode)
            if mode == "fd_recover_thrusters" and self.asked_s is None:
                self.asked_s = self.now_s
            await self.report()
            await self.repairs.result(action["id"], code=0, message="", by=Reporter("robot"))


async def test_suave_flies_as_high_as_it_sees_and_recovers_its_thruster(tmp_path: Path, long: bool) -> None:
    config: dict[str, Any] = yaml.safe_load((SUAVE / "robot.yaml").read_text(encoding="utf-8"))
    model = (SUAVE / "model.yaml").read_text(encoding="utf-8")
    if not long:  # ten times as fast
        model = model.replace("dwell_s: 0.5", "dwell_s: 0.05")
    async with service(tmp_path) as runtime:
        await runtime.robots.models.put("suave", model, format=None, expected=None, by="test")
        await runtime.robots.put_robot("r1", config, expected=None, by="test")
        robot = Suave(runtime.repairs, runtime.robots, speed=1.0 if long else 10.0)
        async with running(robot):
            await eventually(lambda: robot.now_s > LASTS_S, "the mission to end", timeout_s=200)
            changes = await changes_of(runtime)
            states = {one["state"] for one in changes}
            heights = [one for one in robot.flown if one.startswith("fd_spiral")]
            # Each change of the water was followed, whatever was held up on a busy computer.
            assert [*dict.fromkeys(heights)] == ["fd_spiral_high", "fd_spiral_medium", "fd_spiral_low"]
            assert heights[-1] == "fd_spiral_high"
            motion = [one for one in robot.flown if not one.startswith("fd_spiral")]
            assert motion == ["fd_recover_thrusters", "fd_all_thrusters"]
            assert states == {"changed"}
            assert await runtime.store.read(attempts.counted, "r1", 0) == {}
            assert await runtime.repairs.quarantined("r1") == {}
        assert robot.asked_s is not None
        assert robot.failed_s is not None
        print(f"wrong altitude {robot.wrong_s:.1f} s; recovery {robot.asked_s - robot.failed_s:.2f} s")
