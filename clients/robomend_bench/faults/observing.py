"""The one place where literals are made: the real observers of one host, fed by the simulated robot.

    messages, running nodes, relays ──► driver of the observers ──► changes ──► the agent's reporter

It does what the agent does (robomend_client.agent.watch): general observers for topics, one node observer, in
one driver. What the matter is with an observer in the classes that have a faulty one is done here, too.
Replacing the observers means to change this module only.
"""

from __future__ import annotations

import asyncio
import json
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache
from heapq import heapify, heappop, heappush
from pathlib import Path

from robomend_bench.faults.anatomy import Anatomy, Aspect
from robomend_bench.faults.classes import Blind
from robomend_client.literals import Atom, Literal
from robomend_client.observers import (
    PROCESSES,
    SECOND,
    Change,
    Contact,
    Driver,
    Evidence,
    GeneralObserver,
    NodeObserver,
    Observer,
    Rate,
    Verdict,
)
from robomend_client.observers.kinds import ObserverSpec, read_observers
from robomend_client.yaml_reader import Section
from robomend_client.yaml_tree import read_tree

RELAYS = "relays"

NO_VALUES: Mapping[str, object] = {}

KINDS = Path(__file__).parent / "robots" / "field"
"""Where the observers of the robots' own are."""

TABLE_NS = SECOND // 10
"""How often the node observer hears which processes run, changed or not, as from the agent."""

DRAIN_S = 0.02
"""After a time in which it was held up, an agent lets in what has waited before it judges."""


SLOWEST_HZ = 5.0
"""No topic of the bench is slower."""


@dataclass(frozen=True, slots=True)
class Preset:
    """How the observers of topics are set; rate and tolerance are each topic's own."""

    name: str
    rate: Rate

    def of(self, rate_hz: float, tolerance_hz: float) -> Rate:
        return replace(self.rate, rate_hz=rate_hz, tolerance_hz=tolerance_hz)

    @property
    def silence_s(self) -> float:
        """From the last message to the verdict that the topic is silent, at most."""
        return self.rate.silence + self.rate.check_s

    def delay_s(self, slowest_hz: float = SLOWEST_HZ) -> float:
        """From any change to the verdict that rests on it alone, at most: a whole window of the slowest."""
        return max(self.silence_s, self.rate.messages / slowest_hz + self.rate.check_s)


PRESETS: Mapping[str, Preset] = {
    "published": Preset("published", Rate.published()),
    "fast": Preset("fast", Rate(window=10, silence_s=0.5, check_s=0.1, settle=5)),
}
"""`published` has the released system's numbers; `fast` is 10 Hz, silence 0.5 s, settle 5."""


def ns(at_s: float) -> int:
    """Return a time of the bench in the observers' unit."""
    return round(at_s * SECOND)


@cache
def _recipe(file: str) -> ObserverSpec:
    [recipe] = read_observers(Section(read_tree(file), "aspects", ""), KINDS)
    return recipe


def observer_of(aspect: Aspect) -> Observer:
    """Return a fresh observer of an aspect, made as by the agent's file."""
    return _recipe(json.dumps({"observers": {str(aspect.atom): dict(aspect.observer)}})).make()


def aspects_delay_s(anatomy: Anatomy, atoms: Collection[Atom] | None = None) -> float:
    """Return how long the slowest of them takes, or of those of some atoms, to a verdict of either sign."""
    observers = [observer_of(each) for each in anatomy.aspects if atoms is None or each.atom in atoms]
    return max((max(each.detection_s, each.settling_s) for each in observers), default=0.0)


class HostObservers:
    """All observers of one host; `driver` is asked for what stands, by whoever reports it."""

    def __init__(
        self,
        anatomy: Anatomy,
        host: str | None,
        preset: Preset,
        start_s: float,
        blind: Blind | None = None,
        epoch_s: float = 0.0,
    ) -> None:
        """`epoch_s` is what the bench's time 0 is in the time of the literals."""
        self.topics: set[str] = set()
        self.starved_ns: int | None = None  # its computer never is
        self.starved_changed = asyncio.Event()
        self._epoch_ns = ns(epoch_s)
        self._faulty: _Faulty | None = None
        observers: list[Observer] = []
        for topic in anatomy.topics.values():
            missing = blind is not None and blind.how == "missing" and blind.topic == topic.name
            if topic.observed and not missing and anatomy.host_of(topic.name) == host:
                self.topics.add(topic.name)
                observer = GeneralObserver(topic.name, preset.of(topic.rate_hz, topic.tolerance_hz))
                if blind is not None and blind.topic == topic.name:
                    self._faulty = _Faulty(observer, blind.how)
                    observers.append(self._faulty)
                else:
                    observers.append(observer)
        hosts = anatomy.hosts
        for aspect in anatomy.aspects:
            if (aspect.host or hosts[0]) == host:
                observers.append(observer_of(aspect))
                self.topics |= {source.partition(":")[0] for source in observers[-1].sources}
        observers.append(
            NodeObserver(
                n.name for n in anatomy.nodes.values() if n.host == host or (not n.host and host == hosts[0])
            )
        )
        # Without a board, the robot's own computers know the relays that they switch.
        relays = [
            d.name
            for d in anatomy.devices.values()
            if anatomy.power == "agent"
            and d.switchable
            and (d.host == host or (not d.host and host == hosts[0]))
        ]
        if relays:
            observers.append(_Relays(relays))
        self.driver = Driver(observers, self._ns(start_s))
        # A heap: they come in any order, and ahead of their time.
        self._messages: list[tuple[int, int, str, Mapping[str, object]]] = []
        self._number = 0
        self._fields = {topic: self._wanted(topic) for topic in self.topics}
        self._changes: list[Change] = []
        self._running: frozenset[str] | None = None
        self._on: dict[str, bool] | None = None
        self._table_ns = 0
        self._drained_ns = 0  # before it nothing that is sampled counts

    @property
    def faulty(self) -> bool:
        """Whether what is the matter with one of them has begun."""
        return self._faulty is not None and self._faulty.begun

    @faulty.setter
    def faulty(self, begun: bool) -> None:
        if self._faulty is not None:
            self._faulty.begun = begun

    def _wanted(self, topic: str) -> list[tuple[str, str]]:
        """Return the sources that a topic's messages feed, each with its field; "" is the whole message."""
        found = (source.partition(":") for source in self.driver.sources)
        return [(f"{name}{colon}{key}", key) for name, colon, key in found if name == topic]

    def message(self, topic: str, at_s: float, values: Mapping[str, object] = NO_VALUES) -> None:
        """A message of a topic that is watched here, with its fields."""
        self._number += 1
        heappush(self._messages, (self._ns(at_s), self._number, topic, values))

    def check(self, now_s: float, running: frozenset[str], on: Mapping[str, bool]) -> Sequence[Change]:
        """Let time pass, and return what has changed."""
        now_ns = self._ns(now_s)
        changes, self._changes = self._changes, []
        while self._messages and self._messages[0][0] <= now_ns:
            at_ns, _, topic, values = heappop(self._messages)
            for source, key in self._fields[topic]:
                changes += self.driver.sample(source, at_ns, values.get(key) if key else None, at_ns)
        if (running != self._running and now_ns >= self._drained_ns) or now_ns >= self._table_ns:
            self._running = running
            self._table_ns = (now_ns // TABLE_NS + 1) * TABLE_NS
            self._on = None  # the relays are read as often: who is to judge anew must hear of them again
            changes += self.driver.sample(PROCESSES, now_ns, running, now_ns)
        if on != self._on:
            self._on = dict(on)
            changes += self.driver.sample(RELAYS, now_ns, self._on, now_ns)
        changes += self.driver.advance(now_ns)
        return changes

    def lapse(self, until_s: float) -> None:
        """The agent was held up until now: it sees that, as robomend_client.agent.watch does."""
        self._drained_ns = self._table_ns = self._ns(until_s + DRAIN_S)
        self._changes += self.driver.lapse(self._drained_ns)

    def look(self, sight: Contact, now_s: float) -> None:
        """The bridge stops looking at its topics, or looks at them again.

        What comes after it has stopped does not get to it, be it on its way already.
        """
        if sight is Contact.LOST:
            self._messages = [one for one in self._messages if one[0] <= self._ns(now_s)]
            heapify(self._messages)
        for topic in self.topics:
            for source, _ in self._fields[topic]:
                self._changes += self.driver.look(source, sight, self._ns(now_s))

    def settle(self, n: int, atoms: Collection[Atom]) -> None:
        """The service wants these atoms judged anew."""
        self._changes += self.driver.settle(n, atoms)

    def standing(self) -> Sequence[Verdict]:
        """Return what holds as of the newest check, with its evidence."""
        return self.driver.standing()

    def now_ns(self) -> int:
        """Return the time of the newest check, which is that of what stands."""
        return self.driver.now_ns

    def _ns(self, at_s: float) -> int:
        return self._epoch_ns + ns(at_s)


class _Faulty:
    """An observer that is not as it should be, from when that has begun."""

    def __init__(self, observer: GeneralObserver, how: str) -> None:
        self.begun = False
        self.sources, self.atoms, self.period_ns = observer.sources, observer.atoms, observer.period_ns
        self.detection_s, self.settling_s = observer.detection_s, observer.settling_s
        self.feed, self.due_ns, self.reset = observer.feed, observer.due_ns, observer.reset
        self._observer = observer
        self._says = () if how == "dead" else (Literal(observer.atoms[0], how == "says-good"),)

    def check(self, now_ns: int) -> tuple[Literal, ...]:
        """Return what it says: once it has begun, the same for ever."""
        return self._says if self.begun else self._observer.check(now_ns)

    def evidence(self, atom: Atom, now_ns: int) -> Evidence:
        """Return what it rests on: a liar has just seen it."""
        return Evidence(now_ns) if self.begun else self._observer.evidence(atom, now_ns)


class _Relays:
    """Tells the positions of relays."""

    period_ns = 0
    detection_s = settling_s = 2 * TABLE_NS / SECOND
    sources = frozenset((RELAYS,))

    def __init__(self, devices: Sequence[str]) -> None:
        self.atoms = tuple(Atom("on", (device,)) for device in devices)
        self.reset(0)

    def reset(self, time_ns: int) -> None:
        """Know nothing."""
        self._said: tuple[Literal, ...] = ()

    def feed(self, source: str, time_ns: int, value: object) -> None:
        """Take in the positions of all relays."""
        assert isinstance(value, Mapping)
        self._said = tuple(Literal(atom, value[atom.args[0]]) for atom in self.atoms)

    def due_ns(self) -> int | None:
        """Return None: they speak when they move."""
        return None

    def check(self, now_ns: int) -> tuple[Literal, ...]:
        """Return where they are."""
        return self._said

    def evidence(self, atom: Atom, now_ns: int) -> Evidence:
        """Return the present: they can be read at any time."""
        return Evidence(now_ns)
