"""The command `robomend-bench robots`: what the robot's side takes, and how fast the service knows.

Observers run over streams in memory, too: how fast they are, when they report silence, how often without
reason. The samples go through the driver, as in the agent and over logs; time is that of the samples.
"""

from __future__ import annotations

import json
import math
import random
import tempfile
import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import click

from robomend_bench.parts import only
from robomend_bench.robots import live, power, ros, ros1, ros2
from robomend_bench.service.process import load_of_others, processors, served
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


Row = tuple[str, str, str]
"""What was measured, what came out, the goal."""

Measured = tuple[dict[str, Any], list[Row]]


def _speed(wish: dict[str, Any]) -> Measured:
    found: dict[str, Any] = {}
    rows = []
    for name, make, goal in (
        ("rate and silence, asked each 0.5 s of log time", rate, "1,000,000; stretch 2,000,000"),
        ("trend, a verdict each sample", trend, "500,000; stretch 1,000,000"),
    ):
        each = samples_a_second(make, wish["samples"], wish["repeats"])
        found[name] = {"median": round(each[len(each) // 2]), "best": round(each[-1])}
        rows.append((f"{name}, samples/s", f"{found[name]['median']:,} (best {found[name]['best']:,})", goal))
    return found, rows


def _silence(wish: dict[str, Any]) -> Measured:
    times = silences_s(1000, wish["seed"])
    found = live.row(times)
    shown = f"median {found['median_s']:.2f} s, max {found['max_s']:.2f} s"
    return found, [("10 Hz topic silent to `not ok`, default settings, 1,000 times", shown, "0.5 s; 0.35 s")]


def _alarms(wish: dict[str, Any]) -> Measured:
    messages, seed = wish["messages"], wish["seed"]
    found: dict[str, Any] = {"messages": messages}
    rows = []
    for settings, expected, shares in (
        ("default settings", Rate(HZ), (LOST, 0.002, 0.01)),
        ("tolerance_hz 2", Rate(HZ, 2.0), (0.01,)),
        ("tolerance_hz 2, lost 6", Rate(HZ, 2.0, lost=6), (0.01, 0.02)),
    ):
        for lost in shares:
            count = alarms(messages, seed, lost, expected)
            found.setdefault(settings, {})[f"{lost:.1%}"] = count
            promised = "0" if (settings, lost) == ("default settings", LOST) else ""
            what = f"false alarms in {messages:,} messages, 5 % jitter, {lost:.1%} lost, {settings}"
            rows.append((what, str(count), promised))
    return found, rows


def _live(wish: dict[str, Any]) -> Measured:
    with served() as service, tempfile.TemporaryDirectory(prefix="robomend-bench-") as folder:
        rig = live.Rig(service.url, Path(folder), wish["nodes"])
        with rig.agent() as agent:
            alone_mb = live.settled_mb(agent.pid)
            silent = live.row(rig.silent_s(wish["seed"]))
            killed = live.row(rig.killed_s(agent, wish["seed"]))
    found = {"alone_mb": round(alone_mb, 1), "killed": killed, "silent": silent}
    count = wish["nodes"]
    return found, [
        (
            f"process under the agent, SIGKILL to service, {count} times",
            f"median {killed['median_s'] * 1e3:.0f} ms, max {killed['max_s'] * 1e3:.0f} ms",
            "0.3 s; 0.1 s",
        ),
        (
            f"10 Hz topic of the bus, last message to service, {count} times",
            f"median {silent['median_s']:.2f} s, max {silent['max_s']:.2f} s",
            "0.5 s; 0.35 s and the way",
        ),
        (f"agent's memory, {count} processes and topics", f"{alone_mb:.1f} MB", "40 MB; 36 MB"),
    ]


def _ros1(wish: dict[str, Any]) -> Measured:
    return _ros(
        "ROS 1",
        ros1.check,
        ros1.Ros1Rig,
        {"killed": "0.3 s; 0.1 s", "frozen": "2 s; 1 s", "core": "4 %; 2.5 %", "mb": "55 MB; 48 MB"},
        wish,
    )


def _ros2(wish: dict[str, Any]) -> Measured:
    return _ros("ROS 2", ros2.python, ros2.Ros2Rig, {"core": "6 %; 3 %", "mb": "65 MB; 56 MB"}, wish)


def _ros(
    name: str,
    check: Callable[[], object],
    make: Callable[..., ros.RosRig],
    goals: Mapping[str, str],
    wish: dict[str, Any],
) -> Measured:
    """Measure an agent on a real robot with this ROS."""
    try:
        check()
    except ros.NoRos as error:
        return {"missing": str(error)}, [(name, f"not measured: {error}", "")]
    found: dict[str, Any] = {}
    with served() as service, tempfile.TemporaryDirectory(prefix="robomend-bench-") as folder:
        rig = make(service.url, Path(folder), min(5, wish["nodes"]), 10)
        field = {"x": {"kind": "qualitative", "from": rig.origin, "source": "node0_topic0:data"}}
        with rig.robot() as section:
            for what, observers in (("fields", field), ("raw", {})):
                with rig.watched(section, observers) as agent:
                    found[f"{what}_mb"] = round(live.settled_mb(agent.pid), 1)
                    found[f"{what}_core"] = round(ros.share_of_a_core(agent.pid, wish["seconds"]), 4)
                    if what == "raw":
                        found["frozen"] = live.row(rig.frozen_s(wish["seed"]))
                        found["silent"] = live.row(rig.hushed_s(wish["seed"]))
                        found["killed"] = live.row(rig.ended_s(wish["seed"]))
    killed, frozen, silent = found["killed"], found["frozen"], found["silent"]
    seconds = "median {median_s:.2f} s, max {max_s:.2f} s".format
    return found, [
        (
            f"{name} node SIGKILLed, to service, {killed['count']} times",
            f"median {killed['median_s'] * 1e3:.0f} ms, max {killed['max_s'] * 1e3:.0f} ms",
            goals.get("killed", ""),
        ),
        (
            f"{name} node frozen (SIGSTOP), to service, {frozen['count']} times",
            seconds(**frozen),
            goals.get("frozen", ""),
        ),
        (
            f"10 Hz topic of {name} silent, to service, {silent['count']} times",
            seconds(**silent),
            "0.5 s; 0.35 s",
        ),
        (
            f"agent, {10 * killed['count']} topics of {name} at 10 Hz",
            f"{found['raw_core']:.1%} of a core",
            goals["core"],
        ),
        ("the same, with a field read", f"{found['fields_core']:.1%} of a core", ""),
        (
            "agent's memory, the same",
            f"{found['raw_mb']:.1f} MB; {found['fields_mb']:.1f} MB",
            goals["mb"],
        ),
    ]


def _ros1_power(wish: dict[str, Any]) -> Measured:
    return _power("ROS 1", ros1.check, ros1.network, wish)


def _ros2_power(wish: dict[str, Any]) -> Measured:
    return _power("ROS 2", ros2.python, ros2.network, wish)


def _power(
    name: str,
    check: Callable[[], object],
    network: Callable[[Path, ExitStack], ros.RosNetwork],
    wish: dict[str, Any],
) -> Measured:
    """Play the paper's scenarios, each time on a robot and a service of its own."""
    try:
        check()
    except ros.NoRos as error:
        return {"missing": str(error)}, [(f"{name}, scenarios", f"not measured: {error}", "")]
    up, down = [], []
    for _ in range(wish["robots"]):
        with ExitStack() as stack:
            folder = Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="robomend-bench-")))
            service = stack.enter_context(served())
            rig = power.PowerRig(service.url, folder, network(folder, stack), stack)
            stack.enter_context(rig.agent())
            up.append(rig.power_up_s())
            down.append(rig.shut_down_s())
    found = {"power-up": live.row(sorted(up)), "shut-down": live.row(sorted(down))}
    goals = {"power-up": "10 s; 6 s", "shut-down": "5 s; 3 s"}
    return found, [
        (
            f"{scenario} over {name}, until repaired and verified, {times['count']} times",
            f"median {times['median_s']:.1f} s, max {times['max_s']:.1f} s",
            goals[scenario],
        )
        for scenario, times in found.items()
    ]


PARTS: dict[str, Callable[[dict[str, Any]], Measured]] = {
    "speed": _speed,
    "silence": _silence,
    "alarms": _alarms,
    "live": _live,
    "ros1": _ros1,
    "ros2": _ros2,
    "ros1-power": _ros1_power,
    "ros2-power": _ros2_power,
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
    results: dict[str, dict[str, Any]] = {}
    rows: list[Row] = []
    for part in parts:
        click.echo(f"measuring: {part}", err=True)
        results[part], more = PARTS[part](wish)
        rows += more
    if output == "json":
        click.echo(json.dumps(results, indent=1))
        return
    click.echo(f"{processors()} cores, load {load_of_others():.1f}\n")
    click.echo("| what | measured | goal |\n|---|---|---|")
    for what, measured, goal in rows:
        click.echo(f"| {what} | {measured} | {goal} |")
