"""Dominators and cones: which gates of a circuit need not be blamed first.

A gate t dominates a gate d when every path from d to an observed net goes through t. The gates that nothing
dominates are the top level; the gates that t dominates, and t itself, are the cone of t:

        d1 ─┐
            ├─► d3 ──► t ──► observed          cone(t) = {t, d1, d2, d3}
        d2 ─┘

If d is in a minimum-cardinality diagnosis, putting its top-level dominator in its place gives one too: t's
output is now free and may keep its value, and the gates between d and t, being healthy functions of their
inputs, follow suit unseen. No two members share a cone, or that would save one. So it is enough to enumerate
the minimum-cardinality diagnoses of top-level gates, and then to ask of each member which gates of its cone
can stand in for it.

Under weak fault models only. The observed nets are part of the picture: other sensors, other cones.

Sources:
    A. Metodi, R. Stern, M. Kalech, M. Codish. A novel SAT-based approach to model based diagnosis. JAIR 51,
        2014.
    S. Siddiqi, J. Huang. Hierarchical diagnosis of multiple faults. IJCAI 2007 (cones).
    T. Lengauer, R. Tarjan. A fast algorithm for finding dominators in a flowgraph. TOPLAS 1(1), 1979 (the
        problem; an acyclic graph needs only one sweep from the observed nets back).
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable
from dataclasses import dataclass
from functools import reduce
from operator import or_

from robomend.diagnosis.circuits.netlist import Netlist

UNSEEN = -2  # no path to an observed net: such a gate is in no minimal diagnosis
OBSERVED = -1  # the root: beyond the observed nets


@dataclass(frozen=True)
class Cones:
    """Indices are of the netlist's gates; a cone is in topological order and ends with its top-level gate."""

    top: tuple[int, ...]
    members: dict[int, tuple[int, ...]]  # top-level gate -> its cone
    seen: tuple[int, ...]  # the gates with a path to an observed net, in topological order


def find_cones(netlist: Netlist, observed: Iterable[int]) -> Cones:
    """Return the cones of the netlist when these nets are observed."""
    gates = netlist.gates
    sinks = set(observed)
    users: dict[int, list[int]] = defaultdict(list)
    for index, gate in enumerate(gates):
        for net in gate.inputs:
            users[net].append(index)
    above = [UNSEEN] * len(gates)  # the immediate dominator
    depth = [0] * len(gates)
    for index in range(len(gates) - 1, -1, -1):
        output = gates[index].output
        if output in sinks:
            above[index] = OBSERVED
            continue
        meet = UNSEEN
        for user in users[output]:
            if above[user] != UNSEEN:
                meet = user if meet == UNSEEN else _common(above, depth, meet, user)
        above[index] = meet
        if meet >= 0:
            depth[index] = depth[meet] + 1
    top_of = list(range(len(gates)))
    members: dict[int, list[int]] = defaultdict(list)
    for index in range(len(gates) - 1, -1, -1):
        if above[index] >= 0:
            top_of[index] = top_of[above[index]]
        if above[index] != UNSEEN:
            members[top_of[index]].append(index)
    cones = {top: tuple(reversed(cone)) for top, cone in members.items()}
    seen = tuple(index for index in range(len(gates)) if above[index] != UNSEEN)
    return Cones(tuple(sorted(cones)), cones, seen)


def by_output(netlist: Netlist, cones: Cones, observed: Iterable[int]) -> list[int]:
    """Return the top-level gates: first those behind the output with the fewest inputs, and so on.

    A solver that is told in this order that they are healthy meets the conflicts of one output before it
    looks at the others: fewer gates are in them, and they are found sooner.

    Args:
        observed: nets that gates drive.
    """
    gates, driver = netlist.gates, netlist.driver()
    inputs = {net: 1 << position for position, net in enumerate(netlist.sources)}
    for gate in gates:
        inputs[gate.output] = reduce(or_, [inputs.get(net, 0) for net in gate.inputs], 0)
    left = set(range(len(gates)))
    listed: list[int] = []
    for output in sorted(observed, key=lambda net: (inputs[net].bit_count(), net)):
        behind: list[int] = []
        todo = [driver[output]]
        while todo:
            index = todo.pop()
            if index in left:
                left.remove(index)
                behind.append(index)
                todo += [driver[net] for net in gates[index].inputs if net in driver]
        listed += sorted(behind)
    return [index for index in listed if index in cones.members]


def few_behind(netlist: Netlist, cones: Cones, observed: Iterable[int], at_most: int) -> list[list[int]]:
    """Return of each of these nets the top-level gates behind it, none where they are more than that.

    Args:
        observed: nets that gates drive.
    """
    driver = netlist.driver()
    behind: dict[int, set[int] | None] = {}  # of a gate; None: too many
    for index in cones.seen:
        before = [behind[driver[net]] for net in netlist.gates[index].inputs if net in driver]
        here = {index} if index in cones.members else set()
        reached = None if None in before else here.union(*filter(None, before))
        behind[index] = None if reached is None or len(reached) > at_most else reached
    return [sorted(behind[driver[net]] or ()) for net in observed]


def _common(above: list[int], depth: list[int], one: int, other: int) -> int:
    """Return the lowest common dominator; both have a path to an observed net."""
    while one != other:
        if one == OBSERVED or other == OBSERVED:
            return OBSERVED
        if depth[one] >= depth[other]:
            one = above[one]
        else:
            other = above[other]
    return one
