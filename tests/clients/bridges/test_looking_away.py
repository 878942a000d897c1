"""A node, or the agent, is halted for longer than others wait for it: nothing of the others is silent."""

from __future__ import annotations

import asyncio
import signal
import time
from itertools import pairwise
from pathlib import Path
from typing import Any

import pytest
from tests.clients.bridges.any_robot import AnyRobot
from tests.clients.bridges.hearing import listening
from tests.clients.bridges.ros2.test_split import soon_lost
from tests.clients.running_agent import agent, config
from tests.clients.service_double import ServiceDouble, eventually
from tests.freezing import starved
from tests.ros2 import robot as ros2_robot

LONG_S = 12.0
"""Longer than our lease in DDS, of 10 s: then all others have dropped us."""


def said(service: ServiceDouble, since: int) -> set[str]:
    return {literal for batch in service.batches()[since:] for literal in batch["observations"]}


def watching(robot: AnyRobot) -> dict[str, Any]:
    """Start two nodes with a topic each; return an agent's sections that watch both."""
    for name in ("laser", "motor"):
        node = robot.node(name)
        node.do("publish", topic=f"/{name}", type="std_msgs/String", rate=10)
    # A busy robot's own nodes are late by a second; the agent is halted for longer than that is silence.
    expected = {"from": robot.origin, "first_s": 60, "tolerance_hz": 8, "silence_s": 2}
    topics = dict.fromkeys(("laser", "motor"), expected)
    observers = {"nodes": {**robot.watched, "nodes": ["laser", "motor"]}}
    return {robot.origin: robot.section, "topics": topics, "observers": observers}


WELL = dict.fromkeys(("ok(laser)", "ok(motor)", "running(laser)", "running(motor)"), True)


@pytest.mark.timeout(300)  # a whole session
def test_an_agent_that_was_halted_finds_the_robot_as_it_was(
    robot: AnyRobot, service: ServiceDouble, tmp_path: Path
) -> None:
    sections = watching(robot)
    sections[robot.origin] = {**robot.section, "discovery_s": 2} if robot.origin != "ros1" else robot.section
    with agent(config(tmp_path, service.url, {}, **sections)) as halted:
        log = tmp_path / "agent.log"
        eventually(lambda: "is up" in log.read_text(), "the agent", 60)
        for _ in range(2):  # while it looks who is there
            halted.send_signal(signal.SIGSTOP)
            time.sleep(3)  # time itself is what passes unseen
            halted.send_signal(signal.SIGCONT)
            time.sleep(0.3)  # so long it looks
        eventually(lambda: WELL.items() <= service.signs().items(), "all well", 60)
        assert said(service, 0) == set(WELL)
        halted.send_signal(signal.SIGSTOP)
        time.sleep(LONG_S)  # likewise
        batches = len(service.batches())
        halted.send_signal(signal.SIGCONT)
        eventually(lambda: len(service.batches()) > batches + 10, "more of it", 60)
        eventually(lambda: WELL.items() <= service.signs().items(), "all well again", 60)
        assert said(service, batches) == set(WELL)


@pytest.mark.timeout(300)  # a whole session
@pytest.mark.parametrize("robot", ["ros2", "zenoh"], indirect=True)
def test_what_waited_while_the_agent_was_halted_is_no_sign_that_others_have_found_it_again(
    robot: AnyRobot, service: ServiceDouble, tmp_path: Path
) -> None:
    """They are busy when it goes on, and find it later: until then their topics are unknown."""
    sections = watching(robot)
    topics = {"ok(laser)", "ok(motor)"}
    with agent(config(tmp_path, service.url, {}, **sections)) as halted:
        eventually(lambda: WELL.items() <= service.signs().items(), "all well", 60)
        halted.send_signal(signal.SIGSTOP)
        time.sleep(LONG_S)  # time itself is what passes unseen
        batches = len(service.batches())
        for name in ("laser", "motor"):
            robot.nodes[name].signal(signal.SIGSTOP)
        halted.send_signal(signal.SIGCONT)
        eventually(lambda: service.signs().items() >= dict.fromkeys(topics).items(), "unknown", 60)
        time.sleep(3)  # longer than any silence
        for name in ("laser", "motor"):
            robot.nodes[name].signal(signal.SIGCONT)
        eventually(lambda: WELL.items() <= service.signs().items(), "all well again", 60)
        assert {one for one in said(service, batches) if "ok" in one} == topics


def test_one_peer_that_was_halted_for_longer_than_its_lease_leaves_all_others_as_they_were(
    tmp_path: Path,
) -> None:
    """It had not lost us, and does not tell again what it has: somebody else of ours has to ask it."""
    others = ("motor:data", "camera:data")

    async def test() -> None:
        async with listening(ros, *others, "laser:data", "nodes", more="discovery_s: 1") as heard:
            for source in (*others, "laser:data"):
                await heard.more(source, 20)
            await heard.runs(dict.fromkeys(ros.nodes, True))
            before = {source: (heard.count(source), len(heard.sights.get(source, ()))) for source in others}
            ros.nodes["laser"].signal(signal.SIGSTOP)
            await heard.until(lambda: not heard.last("nodes").get("laser", False), "it is frozen")
            await asyncio.sleep(4)  # until its lease is over: nothing says when
            ros.nodes["laser"].signal(signal.SIGCONT)
            await heard.more("laser:data", 30)
            await heard.runs(dict.fromkeys(ros.nodes, True))
            assert heard.lines("the domain is entered once more")
            assert not heard.lines("entered anew")
            assert heard.sees("laser:data")
        # Of the others, which count, nothing was heard less, or twice, nor did anybody look away.
        for source, (count, sights) in before.items():
            values = heard.values[source][count - 1 :]
            assert [late - early for early, late in pairwise(values)] == [1.0] * (len(values) - 1)
            assert len(values) > 40
            assert heard.sights.get(source, [])[sights:] == []

    with ros2_robot(tmp_path, more=soon_lost(tmp_path)) as ros:
        for name in ("motor", "camera", "laser"):
            ros.node(name).do(
                "publish",
                topic=f"/{name}",
                type="std_msgs/Float64",
                moves="data",
                value={"data": 0.0},
                rate=10,
            )
        asyncio.run(test())


HEARD_FOR_A_MINUTE = {
    "rate_hz": 20,
    "tolerance_hz": 8,
    "tolerance_above_hz": 12,
    "window": 60,
    "settle": 50,
    "silence_s": 1,
    "pause_s": 0.75,
}
"""What `robomend attach` writes of a topic at 20 Hz."""


@pytest.mark.parametrize(
    "robot",
    ["ros2", *(pytest.param(one, marks=pytest.mark.long) for one in ("ros1", "zenoh"))],
    indirect=True,
)
@pytest.mark.timeout(300)  # a whole session
def test_an_agent_that_is_starved_as_its_robot_is_does_not_call_it_slow_and_then_does(
    robot: AnyRobot, service: ServiceDouble, tmp_path: Path
) -> None:
    laser = robot.node("laser")
    laser.do("publish", topic="/scan", type="std_msgs/String", rate=20)
    topics = {"scan": {"from": robot.origin, "first_s": 60, **HEARD_FOR_A_MINUTE}}
    with agent(config(tmp_path, service.url, {}, **{robot.origin: robot.section, "topics": topics})) as one:
        eventually(lambda: service.signs().get("ok(scan)"), "all well", 60)
        batches = len(service.batches())
        with starved(laser.pid, halted_s=0.3):
            with starved(one.pid):
                eventually(lambda: service.signs().get("ok(scan)") is not True, "it is not well", 60)
                time.sleep(8)  # twice as long as a window takes, and a silence: meanwhile nothing bad is said
                assert said(service, batches) <= {"ok(scan)"}
            eventually(lambda: service.signs().get("ok(scan)") is False, "it is slow", 200)
        eventually(lambda: service.signs().get("ok(scan)") is True, "all well again", 60)
