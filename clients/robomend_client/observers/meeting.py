"""Who publishes a topic, and who does not meet whom: what the robot's graph knows, and no message says.

    publishers   ok(publishers,odom) while as many nodes publish it as should   2 publishers: /odom_a, /odom_b
    qos          ok(qos,scan) while all who publish and listen fit together

The graph is told by a bridge (`from: ros1`, `ros2`, `zenoh`). Of recordings only a bag of ROS 1 says who
publishes: whose messages came of late. The graph shows a node that has just begun or ended a little sooner or
later than it is so: what it says must last for `wait_s`. Where one node has several publishers of a topic it
counts once. Only DDS has qualities of service that do not fit.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from robomend_client.literals import Atom, Literal, parse_atom
from robomend_client.observers.base import NOTHING, Evidence, WrongKind, ns
from robomend_client.observers.reading import Judgement
from robomend_client.readings import Reading, Symptom

MISMATCHES = "mismatches"
"""The source whose samples are mappings from topics to why no message goes from a writer to a reader."""

TABLE_S = 1.0
"""How often such a table comes, changed or not."""

LIFETIME_S = 5.0


@dataclass(frozen=True)
class Publishing:
    """Who should publish a topic.

    Attributes:
        least: so many nodes at least.
        most: so many nodes at most.
        wait_s: for so many seconds it must be otherwise.
        first_s: until the first publisher of all is seen, for so many seconds.
    """

    least: int = 1
    most: int = 1
    wait_s: float = 1.0
    first_s: float = 30.0

    def __post_init__(self) -> None:
        if not 0 <= self.least <= self.most <= 1000:
            raise ValueError(f"most must be from {max(0, self.least)} (least) to 1000, not {self.most}")
        for name in ("wait_s", "first_s"):
            if not 0 <= getattr(self, name) <= 3600:
                raise ValueError(f"{name} must be from 0 to 3600, not {getattr(self, name):g}")


class PublishersObserver:
    """Watches which nodes publish one topic."""

    def __init__(
        self,
        atom: str,
        topic: str | None = None,
        nodes: Sequence[str] = (),
        expected: Publishing | None = None,
    ) -> None:
        """
        Args:
            atom: what it speaks of, e.g. `ok(publishers,odom)`; by default the entry's name.
            topic: the topic; by default the last name in the atom.
            nodes: those who may publish it; by default anybody.
            expected: how many.
        """
        self._expected = expected or Publishing()
        self.atoms = (parse_atom(atom),)
        self.topic = (topic or self.atoms[0].args[-1]).strip("/")
        self.sources = frozenset((self.topic,))
        self.period_ns = 0
        self._allowed = frozenset(name.strip("/") for name in nodes)
        self._wait_ns, self._first_ns = ns(self._expected.wait_s), ns(self._expected.first_s)
        self.detection_s = self.settling_s = self._expected.wait_s + 1.5 * TABLE_S
        self._signs = {good: (Literal(self.atoms[0], good),) for good in (True, False)}
        self._nodes: tuple[str, ...] | None = None  # None: nobody says who they are
        self._ever = False  # whether anybody was ever seen to publish it
        self._right = True
        self._said: bool | None = None  # it stands until the opposite has lasted
        self._start_ns: int | None = None
        self._changed_ns = 0
        self._good_ns: int | None = None
        self.reset(0)

    def reset(self, time_ns: int) -> None:
        """Who publishes is told when it changes: it is a verdict again once it stood for `wait_s`."""
        if self._start_ns is None or time_ns < self._start_ns:
            self._start_ns = time_ns
        self._from_ns = time_ns
        self._said = None

    def feed(self, source: str, time_ns: int, value: object) -> None:
        """Its messages do not matter here."""

    def published_by(self, nodes: Sequence[str], time_ns: int) -> None:
        names = tuple(dict.fromkeys(nodes))
        right = self._is_right(names)
        if self._nodes is None or right is not self._right:
            self._changed_ns = time_ns
            if not right and self._nodes is not None:
                self._good_ns = time_ns
        self._ever = self._ever or bool(names)
        self._nodes, self._right = names, right

    def _is_right(self, nodes: tuple[str, ...]) -> bool:
        fits = self._expected.least <= len(nodes) <= self._expected.most
        return fits and (not self._allowed or all(node.strip("/") in self._allowed for node in nodes))

    def due_ns(self) -> int | None:
        if self._nodes is None:
            return None
        stood_ns = max(self._from_ns, self._changed_ns) + self._wait_ns
        return stood_ns if self._ever else max(stood_ns, (self._start_ns or 0) + self._first_ns)

    def check(self, now_ns: int) -> tuple[Literal, ...]:
        due_ns = self.due_ns()
        if due_ns is not None and now_ns >= due_ns:
            self._said = self._right
        return NOTHING if self._said is None else self._signs[self._said]

    def evidence(self, atom: Atom, now_ns: int) -> Evidence:
        since_ns = max(self._from_ns, self._changed_ns)
        nodes = self._nodes or ()
        if self._said:
            since_ns = since_ns if self._right else self._from_ns
            return Evidence(since_ns, None, Reading(", ".join(nodes) or "nobody"))
        few, many = len(nodes) < self._expected.least, len(nodes) > self._expected.most
        strange = [node for node in nodes if self._allowed and node.strip("/") not in self._allowed]
        if not nodes:
            reading = Reading("nobody publishes it", symptom=Symptom.SILENT)
        elif few or many:
            limit = f"at least {self._expected.least}" if few else f"at most {self._expected.most}"
            told = f"{len(nodes)} publisher{'s' if len(nodes) > 1 else ''}: {', '.join(nodes)}"
            reading = Reading(told, "", limit, Symptom.SILENT if few else Symptom.PUBLISHERS)
        else:
            told = f"published by {', '.join(strange)}"
            reading = Reading(told, "", f"should be {', '.join(sorted(self._allowed))}", Symptom.PUBLISHERS)
        return Evidence(since_ns, self._good_ns, reading)


class QosObserver:
    """Watches whether messages of one topic go from all who publish it to all who listen."""

    def __init__(
        self, atom: str, topic: str | None = None, wait_s: float = 1.0, source: str = MISMATCHES
    ) -> None:
        """
        Args:
            atom: what it speaks of, e.g. `ok(qos,scan)`; by default the entry's name.
            topic: the topic; by default the last name in the atom.
            wait_s: for so many seconds they must not fit.
            source: the table of those that do not.
        """
        if not 0 <= wait_s <= 3600:
            raise ValueError(f"wait_s must be from 0 to 3600, not {wait_s:g}")
        self.atoms = (parse_atom(atom),)
        self.topic = (topic or self.atoms[0].args[-1]).strip("/")
        self.sources = frozenset((source,))
        self.period_ns = 0
        self.detection_s = self.settling_s = wait_s + 2 * TABLE_S
        self._signs = {good: (Literal(self.atoms[0], good),) for good in (True, False)}
        self._judgement = Judgement(1, ns(wait_s), ns(LIFETIME_S))

    def reset(self, time_ns: int) -> None:
        self._judgement.reset()

    def feed(self, source: str, time_ns: int, value: object) -> None:
        if not isinstance(value, Mapping):
            raise WrongKind("a mapping from topics to why nothing goes there is", value)
        why = value.get(self.topic)
        self._judgement.add(time_ns, why is None, read=why)

    def due_ns(self) -> int | None:
        return self._judgement.due_ns()

    def check(self, now_ns: int) -> tuple[Literal, ...]:
        good = self._judgement.at(now_ns)
        return NOTHING if good is None else self._signs[good]

    def evidence(self, atom: Atom, now_ns: int) -> Evidence:
        why = self._judgement.read
        reading = Reading("fits" if why is None else str(why))
        return self._judgement.evidence._replace(reading=reading)


def suggested(topic: str, publishers: Sequence[str], dds: bool = False) -> dict[str, dict[str, Any]]:
    """Return the entries of `observers:` that a topic with one publisher suggests; with more, nothing is said
    of how many there should be (/tf has several).

    Args:
        topic: with its slash, as ROS has it.
        publishers: nodes that publish it now.
        dds: whether qualities of service may not fit.
    """
    name = topic.strip("/")
    found: dict[str, dict[str, Any]] = {}
    if len(set(publishers)) == 1:
        found[f"ok(publishers,{name})"] = {"kind": "publishers", "topic": name}
    if dds:
        found[f"ok(qos,{name})"] = {"kind": "qos", "topic": name}
    return found
