"""The command `robomend-bench robots`: what the robot's side takes, and how fast the service knows.

Observers run over streams in memory, too: how fast they are, when they report silence, how often without
reason. The samples go through the driver, as in the agent and over logs; time is that of the samples.
"""

from __future__ import annotations

import math
import random
import tempfile
import time
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from functools import partial
from pathlib import Path
from typing import Any

import click

from robomend_bench.parts import Figures, only, report
from robomend_bench.robots import live, power, ros
from robomend_bench.service.process import served
from robomend_client.observers import (
    SECOND,
    Driver,
    GeneralObserver,
    Observer,
    QualitativeObserver,
    Rate,
    Trend,
    ns,
)

HZ = 10.0
JITTER = 0.05
LOST = 0.001
PERIOD_NS = ns(1 / HZ)


def rate() -> GeneralObserver:
    """Return an observer of rate and silence that is asked each half second."""
    return GeneralObserver("scan", Rate(HZ, check_s=0.5))


def trend() -> QualitativeObserver:
    """Return an observer of a trend that gives a verdict with each sample."""
    return QualitativeObserver("x", "odom:x", Trend(check_s=0.0))


def samples_a_second(make: Callable[[], Observer], samples: int, repeats: int) -> list[float]:
    """Return the samples a second of processor time, of each repeat, one topic at 10 Hz of log time."""
    stream = [(k * PERIOD_NS, math.sin(k / 50)) for k in range(samples)]
    found = []
    for _ in range(repeats):
        observer = make()
        (source,) = observer.sources
        take = Driver([observer], 0).sample
        began = time.process_time()
        for time_ns, value in stream:
            take(source, time_ns, value)
        found.append(samples / (time.process_time() - began))
    return sorted(found)


def imperfect(messages: int, seed: int, lost: float = LOST) -> Sequence[int]:
    """Return the times of a topic with 5 % jitter of which a share of the messages is lost."""
    draw = random.Random(seed)
    times_ns = []
    time_s = 0.0
    for _ in range(messages):
        time_s += (1 + draw.uniform(-JITTER, JITTER)) / HZ
        if draw.random() >= lost:
            times_ns.append(ns(time_s))
    return times_ns


def alarms(messages: int, seed: int, lost: float, expected: Rate) -> int:
    """Return how often an observer called an imperfect topic not ok."""
    driver = Driver([GeneralObserver("scan", expected)], 0)
    changes = [c for time_ns in imperfect(messages, seed, lost) for c in driver.sample("scan", time_ns)]
    return sum(c.value is not None and not c.value.positive for c in changes)


def silences_s(count: int, seed: int) -> list[float]:
    """Return the times from the last message to `not ok`, default settings, sorted."""
    found = []
    for number in range(count):
        driver = Driver([GeneralObserver("scan", Rate(HZ))], 0)
        times_ns = imperfect(random.Random(number).randrange(50, 150), seed + number)
        for time_ns in times_ns:
            driver.sample("scan", time_ns)
        (silent,) = driver.advance(times_ns[-1] + 10 * SECOND)
        found.append((silent.time_ns - times_ns[-1]) / SECOND)
    return sorted(found)


def _speed(wish: dict[str, Any]) -> Figures:
    found: Figures = {}
    for name, make in (
        ("rate and silence, asked each 0.5 s of log time", rate),
        ("trend, a verdict each sample", trend),
    ):
        each = samples_a_second(make, wish["samples"], wish["repeats"])
        found[f"{name}, samples/s"] = {"median": round(each[len(each) // 2]), "best": round(each[-1])}
    return found


def _silence(wish: dict[str, Any]) -> Figures:
    return {"10 Hz topic silent to `not ok`": live.row(silences_s(1000, wish["seed"]))}


def _alarms(wish: dict[str, Any]) -> Figures:
    messages, seed = wish["messages"], wish["seed"]
    found: Figures = {"messages": messages}
    for settings, expected, shares in (
        ("default settings", Rate(HZ), (LOST, 0.002, 0.01)),
        ("tolerance_hz 2", Rate(HZ, 2.0), (0.01,)),
        ("tolerance_hz 2, lost 6", Rate(HZ, 2.0, lost=6), (0.01, 0.02)),
    ):
        found[settings] = {f"{lost:.1%}": alarms(messages, seed, lost, expected) for lost in shares}
    return found


def _live(wish: dict[str, Any]) -> Figures:
    with served() as service, tempfile.TemporaryDirectory(prefix="robomend-bench-") as folder:
        rig = live.Rig(service.url, Path(folder), wish["nodes"])
        with rig.agent() as agent:
            return {
                "alone_mb": round(live.settled_mb(agent.pid), 1),
                "silent": live.row(rig.silent_s(wish["seed"])),
                "killed": live.row(rig.killed_s(agent, wish["seed"])),
            }


def _ros(which: ros.Ros, wish: dict[str, Any]) -> Figures:
    """Measure an agent on a real robot with this ROS."""
    try:
        which.python()
    except ros.NoRos as error:
        return {"missing": str(error)}
    found: Figures = {}
    with served() as service, tempfile.TemporaryDirectory(prefix="robomend-bench-") as folder:
        rig = ros.RosRig(service.url, Path(folder), min(5, wish["nodes"]), 10, which)
        field = {"x": {"kind": "qualitative", "from": which.origin, "source": "node0_topic0:data"}}
        with rig.robot() as section:
            for what, observers in (("fields", field), ("raw", {})):
                with rig.watched(section, observers) as agent:
                    found[f"{what}_mb"] = round(live.settled_mb(agent.pid), 1)
                    found[f"{what}_core"] = round(ros.share_of_a_core(agent.pid, wish["seconds"]), 4)
                    if what == "raw":
                        found["frozen"] = live.row(rig.frozen_s(wish["seed"]))
                        found["silent"] = live.row(rig.hushed_s(wish["seed"]))
                        found["killed"] = live.row(rig.ended_s(wish["seed"]))
    return found


def _power(which: ros.Ros, wish: dict[str, Any]) -> Figures:
    """Play the paper's scenarios, each time on a robot and a service of its own."""
    try:
        which.python()
    except ros.NoRos as error:
        return {"missing": str(error)}
    up, down = [], []
    for _ in range(wish["robots"]):
        with ExitStack() as stack:
            folder = Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="robomend-bench-")))
            service = stack.enter_context(served())
            rig = power.PowerRig(service.url, folder, which, stack)
            stack.enter_context(rig.agent())
            up.append(rig.power_up_s())
            down.append(rig.shut_down_s())
    return {"power-up": live.row(sorted(up)), "shut-down": live.row(sorted(down))}


PARTS: dict[str, Callable[[dict[str, Any]], Figures]] = {
    "speed": _speed,
    "silence": _silence,
    "alarms": _alarms,
    "live": _live,
    "ros1": partial(_ros, ros.ROS1),
    "ros2": partial(_ros, ros.ROS2),
    "ros1-power": partial(_power, ros.ROS1),
    "ros2-power": partial(_power, ros.ROS2),
}


@click.command("robots", context_settings={"help_option_names": ["-h", "--help"]})
@only(PARTS)
@click.option(
    "--samples", type=click.IntRange(1000), default=500_000, show_default=True, help="In part speed."
)
@click.option("--repeats", type=click.IntRange(1, 100), default=5, show_default=True, help="In part speed.")
@click.option(
    "--messages", type=click.IntRange(1000), default=1_000_000, show_default=True, help="In part alarms."
)
@click.option(
    "--nodes",
    type=click.IntRange(1, 100),
    default=20,
    show_default=True,
    help="In parts live, and ros1 and ros2 (at most 5).",
)
@click.option(
    "--seconds", type=click.FloatRange(0.1), default=20.0, show_default=True, help="In ros1 and ros2."
)
@click.option(
    "--robots",
    type=click.IntRange(1, 100),
    default=3,
    show_default=True,
    help="In ros1-power and ros2-power: one after another.",
)
@click.option("--seed", type=int, default=1, show_default=True)
@click.option("--format", "output", type=click.Choice(["markdown", "json"]), default="markdown")
def command(parts: tuple[str, ...], output: str, **wish: Any) -> None:
    """Measure observers in memory, and an agent under a service of its own.

    \b
    robomend-bench robots
    robomend-bench robots --only speed,alarms --format json
    robomend-bench robots --only live --nodes 50
    """
    report(parts, lambda part: PARTS[part](wish), output)
