"""Stretches without a fault: nothing is broken, so every alarm is false and every act needless.

To add one: an entry of STRETCHES and a function that does what is to be done to the healthy robot.
"""

from __future__ import annotations

import asyncio
import random
from collections.abc import Callable, Coroutine, Mapping
from dataclasses import dataclass

from robomend_bench.faults.agents import HostAgent
from robomend_bench.faults.condition import Act
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
    service_restarts: bool = False


async def boot(live: LiveRobot, chance: random.Random) -> None:
    """Each agent starts its processes, as `start: true` says. Returns when all are begun.

    One that is tied to another comes after it, or it would begin with a dead connection, and not be healthy.
    """
    nodes = live.robot.anatomy.nodes
    begun = {name: asyncio.Event() for name in nodes}

    async def start(name: str) -> None:
        for other in nodes[name].tied_to:
            await begun[other].wait()
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
        service_restarts=True,
    ),
)

STRETCH_BY_NAME: Mapping[str, Stretch] = {each.name: each for each in STRETCHES}
