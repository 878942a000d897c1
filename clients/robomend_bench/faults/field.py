"""The world as it is in the field: `--world field`, a second set of classes, with shares of its own.

What the usual world leaves out: devices that boot for a minute, reports that are rarer than their lifetimes,
what mends itself, what no power cycle helps, observers of every kind, processes that are starved. A case of
each kind is in public reports of people who run robots. docs/score.md has the tables, which are part of the
definition of the score.

Devices boot for 0.2 to 90 s and nodes start for 0.1 to 40 s; time is never compressed.
"""

from __future__ import annotations

import math
import random
from collections.abc import Callable, Mapping, Sequence
from itertools import pairwise
from typing import Any

from robomend_bench.faults.anatomy import Anatomy
from robomend_bench.faults.classes import (
    CLASSES,
    Draw,
    FaultClass,
    Planted,
    Reporting,
    Scenario,
    any_fault,
    devices_with,
    is_feeder,
    nodes_with,
    relays,
    seen,
)
from robomend_bench.faults.kinds import BESIDE, Fault

BOOTS_S = (0.2, 4.0, 20.0, 90.0)
STARTS_S = (0.1, 2.0, 8.0, 40.0)
"""Short, longer than what is waited for by default, and long: between each two of these."""


def _takes_s(chance: random.Random, bands: Sequence[float]) -> float:
    """Draw a band, each as likely as the others, and in it evenly over the logarithms."""
    least, most = chance.choice(list(pairwise(bands)))
    return math.exp(chance.uniform(math.log(least), math.log(most)))


def _one_of(faults: list[Fault], chance: random.Random, **scenario: Any) -> Scenario:
    return Scenario((Planted(chance.choice(faults)),), **scenario)


# --- how long things take --------------------------------------------------------------------------------


def _slow_device(anatomy: Anatomy, chance: random.Random) -> Scenario:
    """A device without power, or hung, that boots slowly; half of the drivers must not start before it."""
    fault = chance.choice(_switched_devices(anatomy))
    boot_s = _takes_s(chance, BOOTS_S)
    hasty = chance.random() < 0.5
    physics: dict[str, Mapping[str, Any]] = {fault.component: {"boot_s": boot_s}}
    physics |= {driver: {"hasty": hasty} for driver in anatomy.drivers[fault.component]}
    return Scenario(
        (Planted(fault),),
        physics=physics,
        times_known=chance.random() < 0.5,
        boots=chance.random() < 0.5,
        longest_s=boot_s,
    )


def _switched_devices(anatomy: Anatomy) -> list[Fault]:
    found = relays(anatomy, "off") + devices_with(anatomy, "hung")
    return [f for f in found if anatomy.devices[f.component].spare is None and anatomy.drivers[f.component]]


def _slow_node(anatomy: Anatomy, chance: random.Random) -> Scenario:
    fault = chance.choice(nodes_with(anatomy, "dead", "hung"))
    start_s = _takes_s(chance, STARTS_S)
    return Scenario(
        (Planted(fault),),
        physics={fault.component: {"warm_s": start_s}},
        times_known=chance.random() < 0.5,
        boots=chance.random() < 0.5,
        longest_s=start_s,
    )


# --- what mends itself -----------------------------------------------------------------------------------


def _feeders(anatomy: Anatomy) -> list[Fault]:
    return seen(
        anatomy,
        (
            Fault(name, kind)
            for name, device in anatomy.devices.items()
            if is_feeder(anatomy, name) and not device.protected
            for kind in (("brown-out", "dip") if device.switchable else ("dip",))
        ),
    )


def _brown_out(anatomy: Anatomy, chance: random.Random) -> Scenario:
    """A hub gives nothing for a moment; the drivers of half of the robots are back by themselves."""
    fault = chance.choice(_feeders(anatomy))
    drivers = {name for device in anatomy.fed[fault.component] for name in anatomy.drivers[device]}
    reconnects = chance.random() < 0.5
    return Scenario(
        (Planted(fault, spells_s=(chance.choice((0.4, 1.5)),)),),
        physics={name: {"reconnects": reconnects} for name in drivers},
        times_known=chance.random() < 0.5,
    )


def _comes_back(anatomy: Anatomy, chance: random.Random) -> Scenario:
    fault = chance.choice(relays(anatomy, "brown-out"))
    reconnects = chance.random() < 0.5
    return Scenario(
        (Planted(fault, spells_s=(chance.uniform(3.0, 8.0),)),),
        physics={name: {"reconnects": reconnects} for name in anatomy.drivers[fault.component]},
        times_known=chance.random() < 0.5,
    )


def _reconnects(anatomy: Anatomy, chance: random.Random) -> Scenario:
    fault = chance.choice(_switched_devices(anatomy))
    return Scenario(
        (Planted(fault),),
        physics={name: {"reconnects": True} for name in anatomy.drivers[fault.component]},
        times_known=chance.random() < 0.5,
    )


def _links(anatomy: Anatomy) -> list[Fault]:
    """Return the devices by which two hosts hear each other."""
    return [Fault(name, "dip") for name, device in anatomy.devices.items() if device.links]


def _link(anatomy: Anatomy, chance: random.Random) -> Scenario:
    fault = chance.choice(_links(anatomy))
    gone_s = chance.uniform(5.0, 9.0)
    return Scenario(
        (Planted(fault, spells_s=(4.0, gone_s, 4.0)),), cut_off=anatomy.devices[fault.component].links
    )


def _beside(anatomy: Anatomy) -> list[Fault]:
    """Return the nodes that can be silent while another, which has nothing to do with them, runs."""
    able = [fault.component for fault in nodes_with(anatomy, "hung")]
    found = []
    for name in able:
        far = [o for o in able if o != name and not _needs(anatomy, name, o) and not _needs(anatomy, o, name)]
        found += [Fault(name, f"{BESIDE}{other}") for other in far[:1]]
    return found


def _needs(anatomy: Anatomy, node: str, other: str) -> bool:
    """Whether a node rests on what another publishes, over however many."""
    waiting, met = [node], {node}
    while waiting:
        for inputs in anatomy.nodes[waiting.pop()].publishes.values():
            new = {anatomy.publisher[topic] for topic in inputs if topic in anatomy.publisher} - met
            met |= new
            waiting += new
    return other in met


def _complaining(anatomy: Anatomy, by: str) -> list[Fault]:
    """Return the devices that may complain by a status, or by a gateway."""
    told = {str(what) for topic in anatomy.topics.values() for what in topic.values.values()}
    names = (each.status for each in anatomy.aspects if f"{by} of {each.status}" in told)
    return seen(anatomy, (Fault(name, "complains") for name in names))


# --- who reports, and how --------------------------------------------------------------------------------


def _reported(how: Callable[[random.Random], Reporting]) -> Draw:
    def draw(anatomy: Anatomy, chance: random.Random) -> Scenario:
        return _one_of(_plain(anatomy), chance, reporting=how(chance))

    return draw


def _plain(anatomy: Anatomy) -> list[Fault]:
    """Return what breaks most often, and one that nothing repairs."""
    return [
        *relays(anatomy, "off"),
        *nodes_with(anatomy, "dead", "hung", "half-rate", "dead, does not start"),
    ]


RARE = ((0.6, 0.5), (2.3, 2.0))
"""How often something is said again, and how long it lives, in seconds."""


def _rare(chance: random.Random) -> Reporting:
    return Reporting(*chance.choice(RARE))


def _disturbed(by: str) -> Draw:
    return lambda anatomy, chance: _one_of(_plain(anatomy), chance, disturbed=by)


FIELD: tuple[FaultClass, ...] = (
    FaultClass(
        "slow-device",
        7,
        "a device is off or hung that boots for 0.2 to 90 s; half of their drivers must not start before it",
        _switched_devices,
        _slow_device,
    ),
    FaultClass(
        "slow-node",
        7,
        "a node ends or hangs that takes 0.1 to 40 s to start",
        lambda a: nodes_with(a, "dead", "hung"),
        _slow_node,
    ),
    FaultClass(
        "stands-still",
        6,
        "the values of a topic do not change any more, at the right rate",
        lambda a: nodes_with(a, "stands still"),
    ),
    FaultClass("too-fast", 4, "a node publishes at twice its rate", lambda a: nodes_with(a, "double rate")),
    FaultClass(
        "second-publisher",
        5,
        "a process that is not in the model publishes the same topic: no act helps",
        lambda a: nodes_with(a, "second publisher"),
    ),
    FaultClass(
        "complains",
        2,
        "a device's status warns for ever, over good data: no act helps",
        lambda a: _complaining(a, "status"),
    ),
    FaultClass(
        "gateway",
        2,
        "the same, as a CONFIRMED fault of a ros2_medkit gateway that knows two robots",
        lambda a: _complaining(a, "medkit"),
    ),
    FaultClass(
        "brown-out",
        7,
        "a hub gives nothing for 0.4 or 1.5 s, seen at its relay or not; half of the drivers reconnect",
        _feeders,
        _brown_out,
    ),
    FaultClass(
        "comes-back",
        5,
        "a device's relay opens, and closes 3 to 8 s later; half of the drivers reconnect",
        lambda a: relays(a, "brown-out"),
        _comes_back,
    ),
    FaultClass(
        "reconnects",
        6,
        "a device is off or hung, and its driver is with it again by itself, 1 s after its boot",
        _switched_devices,
        _reconnects,
    ),
    FaultClass(
        "short-lived",
        4,
        "a node ends, and each of its processes 20 s after its start: no act helps",
        lambda a: nodes_with(a, "ends again and again"),
    ),
    FaultClass(
        "beside", 4, "a node is silent as long as another one runs that has nothing to do with it", _beside
    ),
    FaultClass(
        "rare-reports",
        6,
        "a usual fault; what is reported lives 0.5 or 2 s and is said again after 0.6 or 2.3 s",
        _plain,
        _reported(_rare),
    ),
    FaultClass(
        "irregular-reports",
        5,
        "a usual fault; each report is on its way for 0 to 1.5 s",
        _plain,
        _reported(lambda chance: Reporting(late_s=1.5)),
    ),
    FaultClass(
        "old-reports",
        6,
        "a usual fault; reports have no `since`, agents know neither `settle` nor `can`",
        _plain,
        _reported(lambda chance: Reporting(old=True)),
    ),
    FaultClass(
        "starved-agent",
        5,
        "a usual fault, and an agent runs for 0.1 s and stands for 0.7 to 1.1 s, for 30 s",
        _plain,
        _disturbed("agent-starved"),
    ),
    FaultClass(
        "starved-owner",
        4,
        "a usual fault, and the service gets a tenth of a core for 30 s",
        _plain,
        to_service="starve the owner",
    ),
    FaultClass(
        "starved-planner",
        4,
        "a usual fault, and the service's workers get a tenth of a core for 30 s",
        _plain,
        to_service="starve the workers",
    ),
    FaultClass("link", 4, "the link between two hosts is gone for 4 s, twice", _links, _link),
    FaultClass(
        "every-observer",
        7,
        "any usual fault of a robot that is watched by observers of every kind",
        lambda a: list(any_fault(a)) if len(a.aspects) > 2 else [],
    ),
)

WORLDS: Mapping[str, tuple[FaultClass, ...]] = {"usual": CLASSES, "field": FIELD}

BY_NAME: Mapping[str, FaultClass] = {each.name: each for each in (*CLASSES, *FIELD)}


def world_of(name: str) -> str:
    """Return the world that a class of faults is of; of a stretch, the usual one."""
    return "field" if any(each.name == name for each in FIELD) else "usual"
