"""What may be wrong with a robot, and what can be told of it: explanations, suspects, what is told apart.

    universe      every single fault that the classes of faults may plant, with how often they do
    explanation   a set of faults of different components whose settled observation is the one at hand
    told apart    all explanations with no more faults than there are blame the same components

All of it comes from the truth (condition.py), none from the service. Topics are silent as soon as one thing
that they need is, so that what several faults show together is what they show alone, joined: explanations
are found as the ways to cover an observation.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property
from itertools import combinations
from math import comb

from robomend_bench.faults.anatomy import SILENCE_PERIODS, Anatomy
from robomend_bench.faults.condition import State, abnormal, node_in, works
from robomend_bench.faults.kinds import Fault, begun
from robomend_client.literals import Literal

MOST_FAULTS = 3
"""Explanations are looked for up to this size."""

TOGETHER = (1.0, 0.15, 0.01)
"""How often faults come alone, two together, three together, relative to each other."""


@dataclass(frozen=True)
class Explanation:
    """Faults that explain an observation."""

    faults: tuple[Fault, ...]
    weight: float  # how often it is planted, relative to the others
    state: State

    @property
    def components(self) -> frozenset[str]:
        return frozenset(fault.component for fault in self.faults)


@dataclass(frozen=True)
class Universe:
    """The faults that a robot may have; weights are how often the bench plants each."""

    anatomy: Anatomy
    weights: Mapping[Fault, float]
    together: frozenset[Fault]  # those that come with others

    @cached_property
    def shows(self) -> Mapping[Fault, frozenset[Literal]]:
        """Fault -> what it makes abnormal. Faults that nobody can see are not in it."""
        found = {fault: abnormal(self.anatomy, begun(self.anatomy, fault)) for fault in self.weights}
        return {fault: literals for fault, literals in found.items() if literals}

    def explanations(self, odd: frozenset[Literal], size: int) -> list[Explanation]:
        """Return the explanations of what is abnormal with at most `size` faults, or with as few as it takes.

        At most MOST_FAULTS; nothing where more are needed.
        """
        found: list[Explanation] = []
        for count in range(1, MOST_FAULTS + 1):
            if count > size and found:
                break
            found += self._covers(odd, count)
        return found

    def _covers(self, odd: frozenset[Literal], count: int) -> Iterator[Explanation]:
        parts = [
            fault
            for fault, literals in self.shows.items()
            if literals <= odd and (count == 1 or fault in self.together)
        ]
        for faults in combinations(parts, count):
            if len({fault.component for fault in faults}) < count:
                continue
            if frozenset().union(*(self.shows[fault] for fault in faults)) == odd:
                yield Explanation(faults, self._weight(faults), begun(self.anatomy, *faults))

    def _weight(self, faults: tuple[Fault, ...]) -> float:
        if len(faults) == 1:
            return self.weights[faults[0]] / sum(self.weights.values())
        return TOGETHER[len(faults) - 1] / comb(len(self.together), len(faults))

    def told_apart(self, roots: Collection[str], odd: frozenset[Literal]) -> bool:
        """Whether the settled observation leaves no other cause with as few faults."""
        found = self.explanations(odd, len(roots))
        return bool(found) and all(each.components == frozenset(roots) for each in found)

    def told_apart_by_onset(self, roots: Collection[str], odd: frozenset[Literal], state: State) -> bool:
        """The same, where it is also seen which topics fell silent first."""
        first = first_silent(self.anatomy, state)
        found = [
            each
            for each in self.explanations(odd, len(roots))
            if first_silent(self.anatomy, each.state) == first or each.components == frozenset(roots)
        ]
        return bool(found) and all(each.components == frozenset(roots) for each in found)

    def suspects(self, odd: frozenset[Literal], size: int) -> frozenset[str]:
        """Return the components of all explanations.

        Where MOST_FAULTS do not explain it: every component with a fault that shows nothing else.
        """
        if not odd:
            return frozenset()
        found = self.explanations(odd, size)
        if found:
            return frozenset().union(*(each.components for each in found))
        return frozenset(fault.component for fault, literals in self.shows.items() if literals <= odd)


def touched(anatomy: Anatomy, component: str) -> frozenset[str]:
    """Return what may have to be touched to repair a component, itself included.

    Of a device: its feeders and its spare, what it feeds, and the drivers of all of these; of these and of a
    node: the nodes that are tied to them.
    """
    parts = {component}
    if component in anatomy.devices:
        device = anatomy.devices[component]
        parts |= {*device.fed_by, *([device.spare] if device.spare else [])}
        if device.bus is not None:
            parts |= {other.name for other in anatomy.devices.values() if other.bus == device.bus}
        for other in tuple(parts):
            parts |= anatomy.fed[other]
        for other in tuple(parts):
            parts |= set(anatomy.drivers[other])
    for other in tuple(parts):
        parts |= set(anatomy.tied.get(other, ()))
    return frozenset(parts)


def first_silent(anatomy: Anatomy, state: State) -> frozenset[str]:
    """Return the observed topics that are the first to fall silent in a state, within a period."""
    at_s = onsets_s(anatomy, state)
    seen = {topic: time_s for topic, time_s in at_s.items() if anatomy.topics[topic].observed}
    if not seen:
        return frozenset()
    first_s = min(seen.values())
    return frozenset(t for t, time_s in seen.items() if time_s - first_s <= anatomy.topics[t].period_s)


def onsets_s(anatomy: Anatomy, state: State) -> dict[str, float]:
    """Return topic -> how long after the beginning of a state its messages stop."""
    queue: deque[str] = deque()
    found: dict[str, float] = {}
    for node in anatomy.nodes.values():
        able = node_in(state, node.name).speaks and all(works(anatomy, state, d) for d in node.drives)
        if not able:
            for topic in node.publishes:
                found[topic] = 0.0
                queue.append(topic)
    while queue:
        topic = queue.popleft()
        at_s = found[topic] + SILENCE_PERIODS * anatomy.topics[topic].period_s
        for other in anatomy.consumers.get(topic, ()):
            if at_s < found.get(other, float("inf")):
                found[other] = at_s
                queue.append(other)
    return found
