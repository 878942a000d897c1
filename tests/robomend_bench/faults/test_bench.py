"""Many trials side by side: what dies is told, and the rest goes on."""

from __future__ import annotations

import asyncio
import os
import signal
import sys
from contextlib import suppress
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import pytest
from tests.terminal import Terminal
from tests.waiting import until

from robomend_bench.faults import trial as trials
from robomend_bench.faults.bench import run_trials
from robomend_bench.faults.classes import Scenario
from robomend_bench.faults.live import LiveRobot
from robomend_bench.faults.record import Record, Trial
from robomend_bench.faults.robot import find_robot
from robomend_bench.faults.trial import Terms

TWO = [Trial("base", "hung-node", 1, 1), Trial("pipeline", "dead-node", 1, 2)]


def test_a_service_that_dies_is_an_error_of_its_trial_and_started_again(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    real = trials._Play._break

    async def die_first(play: trials._Play) -> None:
        if play._live.record.trial == TWO[0]:
            assert play._around._served is not None
            play._around._served.kill()
        else:
            await real(play)

    monkeypatch.setattr(trials._Play, "_break", die_first)
    [first, second], ticks = asyncio.run(run_trials(TWO, Terms("fast"), jobs=1))
    assert first.error.startswith("the service died")
    assert second.error == ""
    assert second.acts
    assert ticks


def test_robots_are_switched_on_before_their_faults_and_an_error_in_one_leaves_the_others_alone(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    real = LiveRobot.tick

    def break_one(live: LiveRobot, now_s: float, late_s: float) -> None:
        if live.record.trial == TWO[0] and live.record.faults:
            raise RuntimeError("a mistake")
        real(live, now_s, late_s)

    monkeypatch.setattr(LiveRobot, "tick", break_one)
    [first, second], _ = asyncio.run(run_trials(TWO, Terms("fast", boots=True), jobs=2))
    assert first.error == "the bench failed: RuntimeError: a mistake"
    assert second.error == ""
    assert second.acts
    stopped = max(len(state) for at_s, state in second.states if at_s < 0)
    assert stopped == len(find_robot("pipeline").anatomy.nodes)
    assert all(at_s > 0 for at_s in [*(a.at_s for a in second.acts), *(r.at_s for r in second.repairs)])


def test_ctrl_c_does_not_wait_for_a_service_that_takes_long_to_start(tmp_path: Path) -> None:
    where = {"PATH": f"{Path(sys.executable).parent}:{os.environ['PATH']}"}
    with Terminal("robomend-bench faults --trials 1 --stretches 0 --load 1", tmp_path, where) as begun:
        until(lambda: services(begun), "the service is being started", 120)
        for process in services(begun):
            os.kill(process, signal.SIGSTOP)  # as good as a computer that leaves it no processor time
        begun.ends_by_ctrl_c()


def services(begun: Terminal) -> list[int]:
    """Return the processes of `robomend serve` in a terminal."""
    found = []
    for process in begun.processes():
        with suppress(OSError):
            if b"--announce" in Path(f"/proc/{process}/cmdline").read_bytes():
                found.append(process)
    return found


def test_a_trial_is_not_over_before_who_was_starved_had_the_time_to_judge() -> None:
    """However the end of what disturbs it and the look whether it is over meet."""
    clock = [100.0]

    async def play() -> float:
        # Who asked to be told that it has ended is not yet.
        starved = SimpleNamespace(done=lambda: True, add_done_callback=lambda told: None)
        live: Any = SimpleNamespace(
            robot=find_robot("base"),
            scenario=Scenario(),
            record=Record(TWO[0], "fast"),
            last_s=0.0,
            at_s=lambda: clock[0],
        )
        live.happened = lambda: setattr(live, "last_s", clock[0])
        around = SimpleNamespace(clock=lambda: clock[0])
        one = trials._Play(live, Terms("fast", most_s=1000.0), cast(Any, around), cast(Any, None))
        over = asyncio.create_task(one._until_over(cast(Any, starved)))
        while not over.done():
            await asyncio.sleep(0.0)
            clock[0] += 0.001
        await over
        return float(clock[0] - live.last_s)

    took_s = asyncio.run(play())
    assert Terms("fast").quiet_s <= took_s < 100.0  # counted from that end
