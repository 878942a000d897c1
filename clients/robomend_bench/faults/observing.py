"""The one place where literals are made: the real observers of one host, fed by the simulated robot.

    messages, running nodes, relays ──► feed ──► observers ──► check ──► literals ──► the agent's reporter

It does what the agent does (robomend_client.agent.agent): general observers for topics, one node observer,
each asked in its period on one grid, nodes at once when a process begins or ends. What the matter is with an
observer in the classes that have a faulty one is done here, too. Replacing the observers means to change this
module only.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass, replace

from robomend_bench.faults.anatomy import Anatomy
from robomend_bench.faults.classes import Blind
from robomend_client.literals import Atom, Literal
from robomend_client.observers import PROCESSES, SECOND, GeneralObserver, NodeObserver, Observer, Rate


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
        return self.rate.silence_s + self.rate.check_s

    @property
    def delay_s(self) -> float:
        """From any change to the verdict that rests on it alone, at most: a whole window of the slowest."""
        return max(self.silence_s, self.rate.window / SLOWEST_HZ + self.rate.check_s)


SLOWEST_HZ = 5.0
"""No topic of the bench is slower."""

PRESETS: Mapping[str, Preset] = {
    "published": Preset("published", Rate()),
    "fast": Preset("fast", Rate(silence_s=0.5, check_s=0.1, settle=5)),
}
"""`published` are the defaults of the agent; `fast` is 10 Hz, silence 0.5 s, settle 5."""


def ns(at_s: float) -> int:
    """Return a time of the bench in the observers' unit."""
    return round(at_s * SECOND)


class HostObservers:
    """All observers of one host."""

    def __init__(
        self,
        anatomy: Anatomy,
        host: str | None,
        preset: Preset,
        start_s: float,
        blind: Blind | None = None,
    ) -> None:
        self._topics: dict[str, GeneralObserver] = {}
        self._checks: list[_Check] = []
        self._blind = blind
        self.faulty = False  # whether what is the matter with one of them has begun
        for topic in anatomy.topics.values():
            missing = blind is not None and blind.how == "missing" and blind.topic == topic.name
            if topic.observed and not missing and anatomy.host_of(topic.name) == host:
                rate = preset.of(topic.rate_hz, topic.tolerance_hz)
                observer = GeneralObserver(topic.name, rate, start_ns=ns(start_s))
                self._topics[topic.name] = observer
                self._checks.append(_Check(observer, (Atom("ok", (topic.name,)),)))
        hosts = anatomy.hosts
        nodes = [
            n.name for n in anatomy.nodes.values() if n.host == host or (not n.host and host == hosts[0])
        ]
        self._nodes = _Check(NodeObserver(nodes), tuple(Atom("running", (name,)) for name in nodes))
        self._checks.append(self._nodes)
        self._running: frozenset[str] | None = None
        # Without a board, the robot's own computers know the relays that they switch.
        self._relays = tuple(
            d.name
            for d in anatomy.devices.values()
            if anatomy.power == "agent"
            and d.switchable
            and (d.host == host or (not d.host and host == hosts[0]))
        )

    @property
    def topics(self) -> Collection[str]:
        """The topics that are watched here."""
        return self._topics.keys()

    def message(self, topic: str, at_s: float) -> None:
        """A message of a topic that is watched here."""
        self._topics[topic].feed(topic, ns(at_s))

    def check(
        self, now_s: float, running: frozenset[str], on: Mapping[str, bool]
    ) -> tuple[list[Atom], list[Literal]] | None:
        """Return the atoms that were asked about and the literals that hold; None while nobody is due."""
        now_ns = ns(now_s)
        if running != self._running:
            self._running = running
            self._nodes.due_ns = 0
        due = [check for check in self._checks if check.due_ns <= now_ns]
        if not due:
            return None
        if self._nodes in due:
            self._nodes.observer.feed(PROCESSES, now_ns, running)
        atoms: list[Atom] = []
        literals: list[Literal] = []
        for check in due:
            check.next_after(now_ns)
            atoms += check.atoms
            literals += check.observer.check(now_ns)
        if self._nodes in due:
            relays = {device: Atom("on", (device,)) for device in self._relays}
            atoms += relays.values()
            literals += (Literal(atom, on[device]) for device, atom in relays.items())
        return atoms, list(self._distorted(literals))

    def _distorted(self, literals: Iterable[Literal]) -> Iterable[Literal]:
        """Say what the faulty observer would say."""
        for literal in literals:
            if not self.faulty or self._blind is None or literal.atom != Atom("ok", (self._blind.topic,)):
                yield literal
            elif self._blind.how != "dead":
                yield Literal(literal.atom, self._blind.how == "says-good")


class _Check:
    """An observer and when it is to be asked next."""

    def __init__(self, observer: Observer, atoms: tuple[Atom, ...]) -> None:
        self.observer = observer
        self.atoms = atoms
        self.due_ns = 0

    def next_after(self, now_ns: int) -> None:
        """Keep to the beat, on one grid for all observers."""
        period_ns = self.observer.period_ns
        self.due_ns = (now_ns // period_ns + 1) * period_ns
