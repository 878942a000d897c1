"""Stretches without a fault: nothing is broken, so every alarm is false and every act needless.

To add one: an entry of STRETCHES and a function that does what is to be done to the healthy robot.
"""

from __future__ import annotations

import asyncio
import math
import random
from collections.abc import Callable, Coroutine, Mapping
from dataclasses import dataclass

from robomend_bench.faults.agents import HostAgent
from robomend_bench.faults.anatomy import Anatomy
from robomend_bench.faults.classes import Reporting, Scenario
from robomend_bench.faults.condition import Act
from robomend_bench.faults.field import RARE
from robomend_bench.faults.live import LiveRobot

Disturb = Callable[[LiveRobot, random.Random], Coroutine[None, None, None]]


@dataclass(frozen=True, slots=True)
class Stretch:
    """One kind of stretch. `disturb` begins when it does and is cancelled at its end."""

    name: str
    seconds: float
    does: str
    disturb: Disturb
    boots: bool = False  # the robot is switched on with the beginning; else it is up and healthy by then
    to_service: str = ""  # what is done to the service meanwhile, which then is one of its own
    world: str = "usual"
    scenario: Callable[[Anatomy, random.Random], Scenario] = lambda anatomy, chance: Scenario()


async def boot(live: LiveRobot, chance: random.Random) -> None:
    """Each agent starts its processes, as `start: true` says. Returns when all are begun.

    One that is tied to another comes after it, or it would begin with a dead connection, and not be healthy.
    """
    nodes = live.robot.anatomy.nodes
    begun = {name: asyncio.Event() for name in nodes}

    async def start(name: str) -> None:
        for other in nodes[name].tied_to:
            await begun[other].wait()
        while live.body.would_fail(Act("start_node", (name,))):  # its launch file waits for the device
            await asyncio.sleep(0.05)
        live.body.order(Act("start_node", (name,)), lambda code, message: begun[name].set())

    await asyncio.gather(*map(start, nodes))
    for event in begun.values():
        await event.wait()


async def _jitter(live: LiveRobot, chance: random.Random) -> None:
    live.body.hiccups = True


async def _agents(live: LiveRobot, chance: random.Random) -> None:
    """An agent ends and comes back; the robot's processes go on."""
    while True:
        await asyncio.sleep(chance.uniform(1.0, 3.0))
        agent = chance.choice(live.agents)
        live.note(f"agent {agent.name} ends")
        await live.stop_agent(agent)
        await asyncio.sleep(chance.choice((0.3, 1.5, 7.0)))
        live.note(f"agent {agent.name} is back")
        live.start_agent(agent)
        await asyncio.sleep(5.0)


async def _late(live: LiveRobot, chance: random.Random) -> None:
    """An agent's process is held up for a moment; what is sent to it arrives when it goes on."""
    while True:
        await asyncio.sleep(chance.uniform(2.0, 5.0))
        agent: HostAgent = chance.choice(live.agents)
        seconds = chance.uniform(0.5, 3.0)
        live.note(f"agent {agent.name} is held up for {seconds:.1f} s")
        live.hold_up(agent.host)
        await asyncio.sleep(seconds)
        live.resume(agent.host)


async def _starved(live: LiveRobot, chance: random.Random) -> None:
    """An agent gets a tenth of a core: it runs for 0.1 s of each second."""
    agent = chance.choice(live.agents)
    live.note(f"agent {agent.name} gets a tenth of a core")
    for _ in range(30):
        live.hold_up(agent.host, wholly=True)
        await asyncio.sleep(chance.uniform(0.7, 1.1))
        live.resume(agent.host)
        await asyncio.sleep(0.1)
    live.note(f"agent {agent.name} runs as before")


async def _reenters(live: LiveRobot, chance: random.Random) -> None:
    """What a bridge does that left the domain, as seen by the observers behind it."""
    for _ in range(2):
        await asyncio.sleep(chance.uniform(3.0, 8.0))
        agent = chance.choice(live.agents)
        seconds = chance.uniform(2.0, 5.0)
        live.note(f"the bridge of agent {agent.name} hears nothing for {seconds:.1f} s")
        live.unheard(agent.host, begins=True)
        await asyncio.sleep(seconds)
        live.unheard(agent.host, begins=False)


async def _two_ears(live: LiveRobot, chance: random.Random) -> None:
    await asyncio.sleep(chance.uniform(2.0, 4.0))
    heard = [
        t.name
        for t in live.robot.anatomy.topics.values()
        if t.observed and t.name in live.robot.anatomy.publisher
    ]
    topic = chance.choice(heard)
    live.note(f"a second agent hears nothing of {topic}")
    live.add_ear(topic)
    await asyncio.sleep(60.0)


async def _link_drops(live: LiveRobot, chance: random.Random) -> None:
    for _ in range(2):
        await asyncio.sleep(chance.uniform(3.0, 8.0))
        agent = chance.choice(live.agents)
        live.note(f"nothing of agent {agent.name} gets through for 4 s")
        live.cut_off(agent.host, cut=True)
        await asyncio.sleep(4.0)
        live.cut_off(agent.host, cut=False)


def _slow_boot(anatomy: Anatomy, chance: random.Random) -> Scenario:
    nodes = {
        name: {"warm_s": math.exp(chance.uniform(math.log(0.1), math.log(40.0)))} for name in anatomy.nodes
    }
    slow = (
        {chance.choice(sorted(anatomy.devices)): {"boot_s": chance.uniform(10.0, 45.0)}}
        if anatomy.devices
        else {}
    )
    return Scenario(physics={**nodes, **slow}, times_known=chance.random() < 0.5, longest_s=85.0)


def _whole_seconds(anatomy: Anatomy, chance: random.Random) -> Scenario:
    name = chance.choice([t.name for t in anatomy.topics.values() if t.observed and t.rate_hz >= 10])
    return Scenario(stamped=name)


async def _nothing(live: LiveRobot, chance: random.Random) -> None:
    """What happens here happens to the service."""


STRETCHES: tuple[Stretch, ...] = (
    Stretch(
        "boot", 15.0, "a healthy robot is switched on, and its agents start every process", boot, boots=True
    ),
    Stretch("jitter", 30.0, "now and then a message is late, within the topic's tolerance", _jitter),
    Stretch("agent-restart", 30.0, "agents end and come back 0.3, 1.5 or 7 s later", _agents),
    Stretch(
        "agent-late", 30.0, "an agent is held up for 0.5 to 3 s, and hears then what came meanwhile", _late
    ),
    Stretch(
        "service-restart",
        30.0,
        "the service is ended or killed, and started again, twice",
        _nothing,
        to_service="restart",
    ),
    Stretch(
        "slow-boot",
        60.0,
        "a robot is switched on whose nodes start for up to 40 s, one of its devices for up to 45 s",
        boot,
        boots=True,
        world="field",
        scenario=_slow_boot,
    ),
    Stretch(
        "every-observer-jitter",
        45.0,
        "now and then a message is late, within the topic's tolerance",
        _jitter,
        world="field",
    ),
    Stretch(
        "whole-seconds",
        45.0,
        "the stamps of a topic are whole seconds, and their trend is observed",
        _nothing,
        world="field",
        scenario=_whole_seconds,
    ),
    Stretch(
        "rarer-reports",
        45.0,
        "what is reported lives 0.5 or 2 s and is said again after 0.6 or 2.3 s",
        _jitter,
        world="field",
        scenario=lambda anatomy, chance: Scenario(reporting=Reporting(*chance.choice(RARE))),
    ),
    Stretch(
        "late-reports",
        45.0,
        "each report is on its way for 0 to 1.5 s",
        _jitter,
        world="field",
        scenario=lambda anatomy, chance: Scenario(reporting=Reporting(late_s=1.5)),
    ),
    Stretch(
        "old-agents",
        45.0,
        "reports have no `since`, agents know neither `settle` nor `can`, end and come back",
        _agents,
        world="field",
        scenario=lambda anatomy, chance: Scenario(reporting=Reporting(old=True)),
    ),
    Stretch("agent-starved", 45.0, "an agent gets a tenth of a core for 30 s", _starved, world="field"),
    Stretch(
        "owner-starved",
        45.0,
        "the service gets a tenth of a core for 30 s",
        _nothing,
        to_service="starve the owner",
        world="field",
    ),
    Stretch(
        "bridge-reenters",
        45.0,
        "a peer of the middleware slept for longer than its lease: the bridge begins anew, and hears nothing "
        "for 2 to 5 s",
        _reenters,
        world="field",
    ),
    Stretch(
        "two-ears",
        45.0,
        "a second agent hears one of the topics not at all, which the first one hears well",
        _two_ears,
        world="field",
    ),
    Stretch(
        "link-drops", 45.0, "nothing of an agent gets through for 4 s, twice", _link_drops, world="field"
    ),
)

STRETCH_BY_NAME: Mapping[str, Stretch] = {each.name: each for each in STRETCHES}
