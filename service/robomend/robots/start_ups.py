"""How long a robot's nodes took to be heard, of their latest starts: so a start in vain is known for one.

    seen:    not running(n), running(n) ──► ok(t), t of n       how long it took, whoever started n
    awaited: start_node(n) has answered ──► not ok(t)           in vain after twice that and more

Of one robot: computers differ, models do not tell. Only a start that was seen from its beginning, and that
nobody has to wait with for a device, counts; of everything else nothing is known, and whoever waits does so
for as long as is configured. What starts took is in the store, written with the observation that told of it
(`unwritten`) and read with the robot (`recall`).
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Mapping, Sequence
from math import inf
from typing import Protocol

from robomend.entry import Entry
from robomend.model.components import ComponentModel, Hardware, Node
from robomend.planning.policy import NODE_ACTIONS, POWER_ACTIONS
from robomend.robots.clock import CLOCK
from robomend.robots.declared import Delays
from robomend_client.actions import Action
from robomend_client.literals import Atom, Literal

LATEST = 8
"""Starts that are remembered of each topic."""

LONGEST_NS = 60 * 10**9
"""What took longer is no start: something else was wrong meanwhile."""

TIMES = 2
"""A start may take so many times the longest of the latest."""

LEAST_NS = 10**9
"""It may take so long in any case: computers are busy now and then."""

SLACK_NS = 300_000_000
"""For what is on its way."""


class Seen(Protocol):
    """OBS as a repair looks at it (robomend.robots.sight)."""

    def value(self, atom: Atom) -> bool | None:
        """Return whether it is seen to hold, on nothing from before the last act; None: nobody knows."""
        ...

    def reported(self, atom: Atom) -> bool:
        """Return whether somebody reports it."""
        ...

    def seen_off(self, atom: Atom) -> bool:
        """Return whether it was ever heard to be off, or not to run."""
        ...

    def rose_ns(self, atom: Atom) -> int | None:
        """Return since when something that holds is known to."""
        ...

    def delays(self, atom: Atom) -> Delays:
        """Return how fast its observers are."""
        ...


class StartUps:
    """Of one robot."""

    __slots__ = (
        "_awaited",
        "_began_by_us",
        "_others_until_ns",
        "_publishers",
        "_stopped",
        "_switched",
        "_took",
        "_unwritten",
    )

    def __init__(self) -> None:
        self._stopped: set[str] = set()  # nodes that were heard not to run
        self._awaited: dict[str, dict[str, int]] = {}  # topic -> node that was seen to begin -> since when
        self._took: dict[str, deque[int]] = {}  # topic -> of its publisher's latest starts
        self._unwritten: set[str] = set()  # topics of which the store has something else
        self._began_by_us: dict[str, int] = {}  # node -> when its start was last ordered by a repair
        self._switched: dict[str, int] = {}  # device -> when a repair last switched it
        self._others_until_ns = 0  # of other acts nobody knows on what they act: they may show until then
        self._publishers: tuple[ComponentModel, Mapping[str, tuple[Node, ...]]] | None = None

    # --- what happens

    def hear(self, changed: Iterable[Entry], parts: ComponentModel | None) -> None:
        """Take note of what was news."""
        if parts is None:
            return
        for entry in changed:
            match entry.atom:
                case Atom(Node.state, (node,)) if node in parts.nodes:
                    self._ran(parts.nodes[node], entry)
                case Atom("ok", (topic,)) if topic in self._awaited:
                    self._heard(topic, entry)

    def acted(self, action: Action, sent_ns: int, shows_ns: int) -> None:
        """A repair's act has answered; what a user's own does shows until `shows_ns`, at the latest."""
        if action.name in POWER_ACTIONS:
            self._switched.update(dict.fromkeys(action.parameters, CLOCK.now_ns()))
        elif action.name not in NODE_ACTIONS:
            self._others_until_ns = max(self._others_until_ns, shows_ns)
        elif action.name == "start_node":
            self._began_by_us.update(dict.fromkeys(action.parameters, sent_ns))

    def _ran(self, node: Node, entry: Entry) -> None:
        for topic in node.publishes:
            self._awaited.get(topic, {}).pop(node.name, None)
        if not entry.positive:
            self._stopped.add(node.name)
        elif node.name in self._stopped:
            self._stopped.discard(node.name)
            for topic in node.publishes:
                self._awaited.setdefault(topic, {})[node.name] = entry.since_ns or entry.time_ns

    def _heard(self, topic: str, entry: Entry) -> None:
        """A topic is heard, or not any more: of a start it is the first time that counts."""
        for node, began_ns in tuple(self._awaited[topic].items()):
            good_ns = entry.since_ns if entry.positive else entry.onset_ns
            if good_ns is None or good_ns < began_ns:
                continue  # of the one before it, or not heard since it began
            del self._awaited[topic][node]
            if entry.positive and good_ns - began_ns <= LONGEST_NS:
                self._took.setdefault(topic, deque(maxlen=LATEST)).append(good_ns - began_ns)
                self._unwritten.add(topic)

    # --- what the store has

    def recall(self, took: Mapping[str, Sequence[int]], parts: ComponentModel | None) -> None:
        """Take over what the store has of the robot's starts, in place of what is known here."""
        topics = () if parts is None else self.publishers(parts)
        self._took = {topic: deque(ns, maxlen=LATEST) for topic, ns in took.items() if topic in topics}
        self._unwritten = {topic for topic in took if topic not in topics}

    def unwritten(self) -> dict[str, tuple[int, ...]]:
        """Return, once, what the store is to keep: topic -> how long starts took, nothing of what is gone.

        A write that fails loses one start: the topic's next one is written with all that are known.
        """
        if not self._unwritten:
            return {}
        found = {topic: tuple(self._took.get(topic, ())) for topic in sorted(self._unwritten)}
        self._unwritten.clear()
        return found

    # --- what is known

    def publishers(self, parts: ComponentModel) -> Mapping[str, tuple[Node, ...]]:
        """Return topic -> the nodes that publish it."""
        if self._publishers is None or self._publishers[0] is not parts:
            found: dict[str, tuple[Node, ...]] = {}
            for node in parts.nodes.values():
                for topic in node.publishes:
                    found[topic] = (*found.get(topic, ()), node)
            self._publishers = parts, found
            self._unwritten |= self._took.keys() - found.keys()
            self._took = {topic: took for topic, took in self._took.items() if topic in found}
            self._awaited = {topic: nodes for topic, nodes in self._awaited.items() if topic in found}
        return self._publishers[1]

    def may_take_ns(self, topic: str) -> int | None:
        """Return how long it may take until a topic is heard of a node that was started; None: unknown."""
        took = self._took.get(topic)
        return None if not took else max(TIMES * max(took), LEAST_NS)

    def after_our_start_ns(self, node: Node, began_ns: int, parts: ComponentModel, seen: Seen) -> int | None:
        """Return how long a node's topics may take to be heard after a repair started it; None: unknown."""
        ordered_ns = self._began_by_us.get(node.name)
        if ordered_ns is None or began_ns < ordered_ns or CLOCK.now_ns() < self._others_until_ns:
            return None
        if self._powered_after(began_ns - LONGEST_NS, [node], parts, seen):
            return None
        longest_ns = 0
        for atom in (Atom("ok", (topic,)) for topic in node.publishes):
            if seen.reported(atom):
                may_take_ns = self.may_take_ns(atom.args[0])
                if may_take_ns is None:
                    return None
                longest_ns = max(longest_ns, may_take_ns + seen.delays(atom).settling_ns)
        return longest_ns or None

    def may_take_s(
        self, missing: Iterable[Literal], since_ns: int, parts: ComponentModel, seen: Seen
    ) -> float:
        """Return in how many seconds one of the missing literals, awaited since then, will have had more than
        its time; inf: nobody knows.
        """
        now_ns = CLOCK.now_ns()
        if now_ns < self._others_until_ns:
            return inf
        ends = [self._end_ns(literal, since_ns, parts, seen) for literal in missing]
        return min((end - now_ns for end in ends if end is not None), default=inf) / 1e9

    def _end_ns(self, literal: Literal, since_ns: int, parts: ComponentModel, seen: Seen) -> int | None:
        atom = literal.atom
        if not (literal.positive and atom.predicate == "ok" and seen.value(atom) is False):
            return None  # no topic, or its observer has not said yet how it is after the act
        (topic,) = atom.args
        may_take_ns = self.may_take_ns(topic)
        nodes = self.publishers(parts).get(topic, ())
        needed = [each for node in nodes for each in _needs(node, topic)]
        if may_take_ns is None or not all(seen.value(each) for each in needed):
            return None
        if self._powered_after(since_ns - LONGEST_NS, nodes, parts, seen):
            return None  # a device may take longer to boot than its driver
        from_ns = max([since_ns, *(seen.rose_ns(each) or 0 for each in needed)])
        return from_ns + may_take_ns + seen.delays(atom).settling_ns + SLACK_NS

    def _powered_after(self, time_ns: int, nodes: Iterable[Node], parts: ComponentModel, seen: Seen) -> bool:
        """Return whether a device that one of the nodes drives, or its supply, got its power after that."""
        names = {name for node in nodes for name in node.drives}
        names |= {feeder for name in names for feeder in parts.feeders(name)}
        switched = (Atom(Hardware.state, (name,)) for name in names)
        rose_ns = (seen.rose_ns(each) or 0 for each in switched if seen.seen_off(each))
        return any(at_ns > time_ns for at_ns in (*rose_ns, *(self._switched.get(n, 0) for n in names)))


def _needs(node: Node, topic: str) -> list[Atom]:
    """Return what is observed of what a node needs to publish a topic, its devices left out."""
    inputs = node.publishes[topic] if not node.drives or node.inputs_matter else ()
    return [Atom(Node.state, (node.name,)), *(Atom("ok", (name,)) for name in inputs)]
