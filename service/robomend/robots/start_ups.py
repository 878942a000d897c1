"""How long a robot's nodes took to be heard, of their latest starts: so a start in vain is known for one.

    seen:    not running(n), running(n) ──► ok(t), t of n       how long it took, whoever started n,
                 inputs of t were ok ──┘                        and how long after its last input
    awaited: start_node(n) has answered ──► not ok(t)           in vain after as long, and once more what was
                                                                its own time

Of one robot: computers differ, models do not tell. Only a start that was seen from its beginning, and that
nobody has to wait with for a device, counts; of everything else nothing is known, and whoever waits does so
for as long as is configured. What starts took is in the store, written with the observation that told of it
(`unwritten`) and read with the robot (`recall`).
"""

from __future__ import annotations

from collections import deque
from collections.abc import Collection, Iterable, Mapping
from math import inf
from time import monotonic
from typing import Protocol

from robomend.entry import Entry
from robomend.model.components import ComponentModel, Hardware, Node
from robomend.planning.policy import NODE_ACTIONS, POWER_ACTIONS
from robomend.robots.clock import CLOCK
from robomend.robots.declared import Delays
from robomend.store.records import StoredStart
from robomend_client.actions import Action
from robomend_client.literals import Atom, Literal

LATEST = 8
"""Starts of each kind that are remembered of each topic."""

TOO_EARLY = 2
"""So often a repair starts the driver of a device that may be booting, before it waits for that."""

OFTEN_BOOTED = 3
"""The second time a third of what it may boot at most has passed: most devices have booted by then, and a
driver that waits for its device by itself speaks."""

OFTEN_UNSEEN = 2
"""Where nobody sees power come and go, it is by when a driver fell silent that its device may boot: the third
start is at half of what it may boot at most."""

LONGEST_NS = 120 * 10**9
"""What took longer is no start: something else was wrong meanwhile."""

BOOTS_NS = 60 * 10**9
"""A device of which the model does not say how long it boots may still do so for as long after its power; and
so may a robot of whose starts nothing is known, once it is switched on."""

MOST_NS = 600 * 10**9
"""Nothing is waited for any longer, whatever it is that has not come yet."""

SKEW_NS = 2 * 10**9
"""By so much the times of a start may differ from when it was heard of, beyond what its observer needs and a
quarter: else a clock has jumped meanwhile, or it was told late, and nothing is learned from it."""

LEAST_NS = 500_000_000
"""It may take so much longer than the longest of the latest in any case: computers are busy now and then."""

MOST_DOUBLED = 4
"""So often the time of a start is doubled after some that were given up."""

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

    def fell_ns(self, atom: Atom) -> int | None:
        """Return until when something held that does not any more; None: it does, or nobody knows."""
        ...

    def looked_ns(self, atom: Atom) -> int:
        """Return until when its observers have looked, by its newest report; 0: nobody knows."""
        ...

    def delays(self, atom: Atom) -> Delays:
        """Return how fast its observers are."""
        ...


class Starts:
    """The latest starts of a topic's node, and how long the next one may take.

    A node is heard when it has begun (u) and then, its inputs being there, worked (w): at
    max(its start + u, inputs) + w. Two things are asked of the earlier ones, from which it was heard so late:

        from its start     at least u + w; exactly that if the inputs were there already
        from its inputs    at least w

    So both bound the next start, whichever comes last, be it a node that was not started itself. As starts
    differ, room is added: as much again as was its own time, for nothing else is known of how they differ;
    of what others held up, a quarter.
    """

    __slots__ = ("_alone", "_held_up")

    def __init__(self, given: Iterable[StoredStart] = ()) -> None:
        self._alone: deque[StoredStart] = deque(maxlen=LATEST)
        self._held_up: deque[StoredStart] = deque(maxlen=LATEST)
        for start in given:
            self.add(start)

    def add(self, start: StoredStart) -> None:
        (self._held_up if start.held_up else self._alone).append(start)

    def refine(self, own_ns: int, *, held_up: bool) -> None:
        """Of the newest that may have been held up it is known now whether and for how long it was."""
        start = self._held_up.pop()
        self.add(StoredStart(start.took_ns, own_ns, held_up))

    def longest_ns(self, *, powered: bool) -> int:
        """Return the longest time that one took which had all it needs; 0: none is known to have.

        Args:
            powered: as one whose device has just got its power.
        """
        starts = (each for each in self.all() if powered or not each.powered)
        return max((each.own_ns for each in starts), default=0)

    def all(self) -> tuple[StoredStart, ...]:
        return (*self._held_up, *self._alone)

    def after_node_ns(self) -> int:
        """Return how long the next one may take from the node's beginning, its inputs being there."""
        starts = self._alone or self._held_up
        room_ns = (max(each.own_ns, each.took_ns // 4, LEAST_NS) for each in starts)
        longest_ns = max(each.took_ns + room for each, room in zip(starts, room_ns, strict=True))
        return max(longest_ns, self.after_inputs_ns())

    def after_inputs_ns(self) -> int:
        """Return how long it may take from when its inputs are there, the node running."""
        return max(each.own_ns + max(each.own_ns, LEAST_NS) for each in self._held_up or self._alone)


class StartUps:
    """Of one robot."""

    __slots__ = (
        "_awaited",
        "_began_by_us",
        "_given_up",
        "_orders",
        "_others_until_ns",
        "_publishers",
        "_stopped",
        "_switched",
        "_took",
        "_undated",
        "_unwritten",
    )

    def __init__(self) -> None:
        self._stopped: set[str] = set()  # nodes that were heard not to run
        # topic -> node that was seen to begin -> since when, and when that was heard of (monotonic)
        self._awaited: dict[str, dict[str, tuple[int, float]]] = {}
        self._took: dict[str, Starts] = {}  # topic -> of its publisher's latest starts
        self._undated: dict[str, tuple[Node, int, int]] = {}  # topic -> node, its start, when it was heard:
        # of the newest start, while nobody knows when its inputs came
        self._given_up: dict[str, int] = {}  # topic -> starts in a row that had their time, and were stopped
        self._unwritten: set[str] = set()  # topics of which the store has something else
        self._began_by_us: dict[str, int] = {}  # node -> when its start was last ordered by a repair
        self._orders: dict[str, list[int]] = {}  # node -> when repairs started it since one last cut power
        self._switched: dict[str, int] = {}  # device -> when a repair last switched it
        self._others_until_ns = 0  # of other acts nobody knows on what they act: they may show until then
        self._publishers: tuple[ComponentModel, Mapping[str, tuple[Node, ...]]] | None = None

    # --- what happens

    def hear(self, changed: Iterable[Entry], parts: ComponentModel | None, seen: Seen) -> None:
        """Take note of what was news, and is in what is seen."""
        if parts is None:
            return
        for entry in changed:
            predicate, args = entry.literal.atom
            if len(args) != 1:
                continue
            name = args[0]
            if predicate == Node.state and name in parts.nodes:
                self._ran(parts.nodes[name], entry, seen)
            elif predicate == "ok" and name in self._awaited:
                self._heard(name, entry, parts, seen)
        if self._undated and any(entry.positive for entry in changed):
            for topic, undated in tuple(self._undated.items()):
                self._date(topic, *undated, seen)

    def acted(self, action: Action, sent_ns: int, shows_ns: int) -> None:
        """A repair's act has answered; what a user's own does shows until `shows_ns`, at the latest."""
        if action.name in POWER_ACTIONS:
            self._switched.update(dict.fromkeys(action.parameters, CLOCK.now_ns()))
            self._orders.clear()
        elif action.name not in NODE_ACTIONS:
            self._others_until_ns = max(self._others_until_ns, shows_ns)
        elif action.name == "start_node":
            self._began_by_us.update(dict.fromkeys(action.parameters, sent_ns))
            for name in action.parameters:
                self._orders[name] = [*self._orders.get(name, ())[-TOO_EARLY:], sent_ns]

    def disturbed(self) -> None:
        """What may have held up the starts under way was planted, and is undone now: they teach nothing."""
        self._awaited.clear()
        self._undated.clear()

    def _ran(self, node: Node, entry: Entry, seen: Seen) -> None:
        now_ns = entry.since_ns or entry.time_ns
        for topic in node.publishes:
            began_ns, _ = self._awaited.get(topic, {}).pop(node.name, (None, 0.0))
            self._undated.pop(topic, None)
            there = [seen.rose_ns(each) for each in _inputs(node, topic) if seen.reported(each)]
            if began_ns is None or entry.positive or None in there or topic not in self._took:
                continue
            if now_ns - max(began_ns, *filter(None, there), 0) >= self._took[topic].after_inputs_ns():
                self._given_up[topic] = min(self._given_up.get(topic, 0) + 1, MOST_DOUBLED)
        if not entry.positive:
            self._stopped.add(node.name)
        elif node.name in self._stopped:
            self._stopped.discard(node.name)
            for topic in node.publishes:
                self._awaited.setdefault(topic, {})[node.name] = now_ns, monotonic()

    def _heard(self, topic: str, entry: Entry, parts: ComponentModel, seen: Seen) -> None:
        """A topic is heard, or not any more: of a start it is the first time that counts."""
        for name, (began_ns, heard_s) in tuple(self._awaited[topic].items()):
            good_ns = entry.since_ns if entry.positive else entry.onset_ns
            if good_ns is None or good_ns < began_ns:
                continue  # of the one before it, or not heard since it began
            del self._awaited[topic][name]
            self._given_up.pop(topic, None)
            took_ns = good_ns - began_ns
            if not entry.positive or took_ns > LONGEST_NS or (node := parts.nodes.get(name)) is None:
                continue
            delays = seen.delays(entry.atom)
            skew_ns = SKEW_NS + delays.detection_ns + delays.settling_ns + took_ns // 4
            if abs(took_ns - round((monotonic() - heard_s) * 1e9)) > skew_ns:
                continue
            powered = self._powered_after(began_ns - BOOTS_NS, [node], parts, seen)
            inputs = _inputs(node, topic)
            start = StoredStart(took_ns, took_ns, powered or bool(inputs), powered)
            self._took.setdefault(topic, Starts()).add(start)
            self._unwritten.add(topic)
            if inputs and not powered:
                self._undated[topic] = node, began_ns, good_ns

    def _date(self, topic: str, node: Node, began_ns: int, heard_ns: int, seen: Seen) -> None:
        """Find out when the inputs of a start came, of which some may be known later than what it led to."""
        rose = [seen.rose_ns(each) for each in _inputs(node, topic)]
        known = [at_ns for at_ns in rose if at_ns is not None]
        if len(known) < len(rose):
            return
        del self._undated[topic]
        last_ns = max(known)
        if last_ns <= heard_ns + SLACK_NS:  # else it has come twice
            own_ns = max(0, heard_ns - max(began_ns, last_ns))
            self._took[topic].refine(own_ns, held_up=last_ns > began_ns)
            self._unwritten.add(topic)

    # --- what the store has

    def recall(self, took: Mapping[str, Iterable[StoredStart]], parts: ComponentModel | None) -> None:
        """Take over what the store has of the robot's starts, in place of what is known here."""
        topics = () if parts is None else self.publishers(parts)
        self._took = {topic: Starts(starts) for topic, starts in took.items() if topic in topics}
        self._undated.clear()
        self._unwritten = {topic for topic in took if topic not in topics}

    def unwritten(self) -> dict[str, tuple[StoredStart, ...]]:
        """Return, once, what the store is to keep: topic -> its starts, nothing of what is gone.

        A write that fails loses one start: the topic's next one is written with all that are known.
        """
        if not self._unwritten:
            return {}
        found = {t: self._took[t].all() if t in self._took else () for t in sorted(self._unwritten)}
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
            self._undated = {topic: start for topic, start in self._undated.items() if topic in self._took}
        return self._publishers[1]

    def may_take_ns(self, topic: str) -> int | None:
        """Return how long it may take until a topic is heard of a node that was started; None: unknown."""
        starts = self._starts(topic)
        return None if starts is None else self._patience(topic) * starts.after_node_ns()

    def _starts(self, topic: str) -> Starts | None:
        """Return the starts of a topic that were seen, or what the model says of them; None: nobody knows."""
        if topic in self._took:
            return self._took[topic]
        nodes = self._publishers[1].get(topic, ()) if self._publishers is not None else ()
        longest_ns = max((_ns(node.start_s) for node in nodes), default=0)
        return Starts([StoredStart(longest_ns, longest_ns, False)]) if longest_ns else None

    def _patience(self, topic: str) -> int:
        """Return how many times as long a start may take after some that were given up: these need not have
        been mute.
        """
        return 1 << self._given_up.get(topic, 0)

    def after_our_start_ns(self, node: Node, began_ns: int, parts: ComponentModel, seen: Seen) -> int | None:
        """Return how long a node's topics may take to be heard after a repair started it; None: unknown."""
        ordered_ns = self._began_by_us.get(node.name)
        if ordered_ns is None or began_ns < ordered_ns or CLOCK.now_ns() < self._others_until_ns:
            return None
        if self._powered_after(began_ns - BOOTS_NS, [node], parts, seen):
            return None
        self.publishers(parts)  # of which the model may say how long they take
        longest_ns = 0
        for atom in (Atom("ok", (topic,)) for topic in node.publishes):
            if seen.reported(atom):
                may_take_ns = self.may_take_ns(atom.args[0])
                if may_take_ns is None:
                    return None
                if seen.looked_ns(atom) < began_ns + may_take_ns:  # else all is told
                    may_take_ns += seen.delays(atom).settling_ns + SLACK_NS
                longest_ns = max(longest_ns, may_take_ns)
        return longest_ns or None

    def at_boot_ns(self, node: Node, began_ns: int, parts: ComponentModel, seen: Seen) -> int:
        """Return how long a node may take to be heard that began by itself, as at the boot of its robot, with
        its devices; 0: no longer than usual.

        It is no boot where nobody saw it begin, a repair started it, or it was heard shortly before.
        """
        ours = 0 <= began_ns - self._began_by_us.get(node.name, 0) <= BOOTS_NS
        if ours or not seen.seen_off(Atom(Node.state, (node.name,))):
            return 0
        ends = (seen.fell_ns(Atom("ok", (topic,))) for topic in node.publishes)
        if any(end is not None and end > began_ns - BOOTS_NS for end in ends):
            return 0
        own_ns = max((self._own_ns(topic, node, powered=True) for topic in node.publishes), default=0)
        devices = self._devices(node, parts)
        boots = [parts.hardware[each].boot_s for each in devices]
        if None in boots or not (devices or own_ns):
            return max(BOOTS_NS, _with_room(own_ns))
        return _with_room(max(map(_ns, boots), default=0)) + _with_room(own_ns)

    def may_take_s(
        self,
        missing: Iterable[Literal],
        sent_ns: int,
        answered_ns: int,
        parts: ComponentModel,
        seen: Seen,
    ) -> float:
        """Return in how many seconds one of the missing literals, awaited of an act that was sent then and
        has answered, will have had more than its time; inf: nobody knows.
        """
        now_ns = CLOCK.now_ns()
        if now_ns < self._others_until_ns:
            return inf
        ends = [self._end_ns(literal, sent_ns, answered_ns, parts, seen) for literal in missing]
        return min((end - now_ns for end in ends if end is not None), default=inf) / 1e9

    def _end_ns(
        self, literal: Literal, sent_ns: int, since_ns: int, parts: ComponentModel, seen: Seen
    ) -> int | None:
        atom = literal.atom
        if not (literal.positive and atom.predicate == "ok" and seen.value(atom) is False):
            return None  # no topic, or its observer has not said yet how it is after the act
        (topic,) = atom.args
        nodes = self.publishers(parts).get(topic, ())
        starts = self._starts(topic)
        running = [Atom(Node.state, (node.name,)) for node in nodes]
        needed = [each for node in nodes for each in _inputs(node, topic)]
        inputs = [each for each in needed if seen.reported(each)]
        if starts is None or not all(seen.value(each) for each in (*running, *inputs)):
            return None
        hidden = [each for each in needed if each not in inputs]
        if not self._up_before(since_ns - starts.after_node_ns(), hidden, parts, seen):
            return None
        if self._powered_after(since_ns - BOOTS_NS, nodes, parts, seen):
            return None  # a device may take longer to boot than its driver
        began = (seen.rose_ns(each) for each in running)
        began_ns = max((since_ns if at_ns is None else at_ns for at_ns in began), default=since_ns)
        # What the act has started has its time from when it began, be that before the act answered.
        from_ns = began_ns if sent_ns <= began_ns < since_ns else since_ns
        there_ns = max([from_ns, *(seen.rose_ns(each) or 0 for each in inputs)])
        node_ns = self._patience(topic) * starts.after_node_ns()
        last_ns = self._patience(topic) * starts.after_inputs_ns() if inputs else node_ns
        end_ns = max(began_ns + node_ns, there_ns + last_ns)
        if seen.looked_ns(atom) >= end_ns:
            return end_ns
        return end_ns + seen.delays(atom).settling_ns + SLACK_NS

    def due_s(self, missing: Iterable[Literal], usual_s: float, parts: ComponentModel, seen: Seen) -> float:
        """Return in how many seconds the last of these literals may be due, by how long the model and earlier
        starts say that devices boot and nodes start; below 0: nothing says that any is due later than now.

        Args:
            usual_s: what a driver has from when its device has booted, where nothing is known of its starts.
        """
        now_ns, usual_ns = CLOCK.now_ns(), round(usual_s * 1e9)
        due_ns = max((self._shown_ns(one.atom, usual_ns, parts, seen) for one in missing), default=0)
        return (min(due_ns, now_ns + MOST_NS) - now_ns) / 1e9

    def _shown_ns(self, atom: Atom, usual_ns: int, parts: ComponentModel, seen: Seen) -> int:
        """Return when an observer may be due to say that something is there; 0: nothing says."""
        due_ns = self._due_ns(atom, usual_ns, parts, seen)
        if not due_ns or atom.predicate != "ok":
            return due_ns
        delays = seen.delays(atom)
        denied_ns = due_ns + min(delays.detection_ns, delays.settling_ns)
        if seen.value(atom) is False and seen.looked_ns(atom) >= denied_ns:
            return denied_ns  # who sees nothing for so long after it was due waits for nothing
        return due_ns + delays.settling_ns + SLACK_NS

    def _due_ns(
        self,
        atom: Atom,
        usual_ns: int,
        parts: ComponentModel,
        seen: Seen,
        above: frozenset[Atom] = frozenset(),
    ) -> int:
        """Return when something may be due, seen or not; 0: nothing says. `above`: what waits for it."""
        (name,) = atom.args if len(atom.args) == 1 else ("",)
        if atom.predicate == Hardware.state and name in parts.hardware:
            return self.booted_ns(name, parts, seen)
        if atom.predicate == Node.state and name in parts.nodes:
            return self._began_ns(name, seen) + _with_room(_ns(parts.nodes[name].start_s))
        if atom.predicate != "ok" or atom in above:
            return 0
        latest_ns = 0
        for node in self.publishers(parts).get(name, ()):
            devices = self._devices(node, parts)
            booted_ns = max((self.booted_ns(each, parts, seen) for each in devices), default=0)
            inputs = _inputs(node, name)
            late = (each for each in inputs if not seen.value(each))
            coming_ns = max(
                (self._due_ns(each, usual_ns, parts, seen, above | {atom}) for each in late), default=0
            )
            began_ns = self._began_ns(node.name, seen)
            powered = any(self._power_ns(each, seen) > began_ns - BOOTS_NS for each in devices)
            if own_ns := self._own_ns(name, node, powered=powered):
                there = (seen.rose_ns(each) or 0 for each in inputs if seen.value(each))
                due_ns = max(began_ns, booted_ns, coming_ns, *there) + _with_room(own_ns)
            else:
                due_ns = max(coming_ns, booted_ns + usual_ns if booted_ns else 0)
                ordered, _ = self._early(node, seen, SKEW_NS)
                if ordered > 1 and not node.drives:  # to start it is all that can be done: it may be slow
                    due_ns = max(due_ns, began_ns + (usual_ns << (ordered - 1)))
            latest_ns = max(latest_ns, due_ns)
        return latest_ns

    def booted_ns(self, device: str, parts: ComponentModel, seen: Seen) -> int:
        """Return when a device will have booted that has got its power lately; 0: nothing says."""
        power_ns = self._power_ns(device, seen)
        boot_s = parts.hardware[device].boot_s
        return power_ns + _with_room(_ns(boot_s)) if power_ns and boot_s else 0

    def drivable_ns(self, node: str, parts: ComponentModel, seen: Seen) -> int:
        """Return when all devices of a node will have booted; 0: nothing says.

        Of a device of which nothing says how long it boots a node is started at once, and should that have
        been too early once more, when it has often booted; after that, when it surely has.
        """
        devices = self._devices(parts.nodes[node], parts) if node in parts.nodes else ()
        if devices and self._unseen(parts.nodes[node], parts, seen):
            ordered, early_ns = self._early(parts.nodes[node], seen)
            return early_ns if ordered >= TOO_EARLY else 0
        return max((self._bootable_ns(node, each, parts, seen) for each in devices), default=0)

    def _bootable_ns(self, node: str, device: str, parts: ComponentModel, seen: Seen) -> int:
        booted_ns, power_ns = self.booted_ns(device, parts, seen), self._power_ns(device, seen)
        orders, boot_s = len(self._orders.get(node, ())), parts.hardware[device].boot_s
        if boot_s is not None:  # should it take longer this once, it is started once more
            return booted_ns if orders or not booted_ns else power_ns + _about(_ns(boot_s))
        if not orders or not power_ns:
            return 0
        starts = (self._took[topic].all() for topic in parts.nodes[node].publishes if topic in self._took)
        if took := [start.took_ns for known in starts for start in known if start.powered]:
            return power_ns + _with_room(max(took))
        return power_ns + (BOOTS_NS if orders >= TOO_EARLY else BOOTS_NS // OFTEN_BOOTED)

    def started_early(self, node: str, parts: ComponentModel, seen: Seen) -> bool:
        """Whether a repair started a node that may still find its device booting, by nothing but that it fell
        silent: nobody sees whether the device lost its power, nor knows how long it boots.
        """
        ordered, early_ns = self._early(parts.nodes[node], seen)
        early = ordered > 0 and early_ns > CLOCK.now_ns()
        return early and self._unseen(parts.nodes[node], parts, seen)

    def _unseen(self, node: Node, parts: ComponentModel, seen: Seen) -> bool:
        """Return whether nobody reports the power of what a node drives, nor knows how long that boots."""
        unknown = all(parts.hardware[each].boot_s is None for each in node.drives)
        known = (
            seen.reported(Atom(Hardware.state, (each,))) or self._power_ns(each, seen)
            for each in self._devices(node, parts)
        )
        return bool(node.drives) and unknown and not any(known)

    def _early(self, node: Node, seen: Seen, room_ns: int = 0) -> tuple[int, int]:
        """Return how often repairs started a node since it fell silent, and until when that may be early.

        Args:
            room_ns: a start so long before that counts as well: observers that judge anew after it date the
            silence by that.
        """
        fell = (seen.fell_ns(Atom("ok", (topic,))) for topic in node.publishes)
        fell_ns = max((at_ns for at_ns in fell if at_ns is not None), default=0)
        ordered = sum(at_ns > fell_ns - room_ns for at_ns in self._orders.get(node.name, ()))
        return ordered, fell_ns + BOOTS_NS // OFTEN_UNSEEN if fell_ns else 0

    def booting(self, node: str, parts: ComponentModel, seen: Seen) -> tuple[str, ...]:
        """Return the devices of a node that have not booted yet, by what is known of them."""
        now_ns = CLOCK.now_ns()
        if self._unseen(parts.nodes[node], parts, seen):
            return tuple(parts.nodes[node].drives)
        devices = dict.fromkeys(self._devices(parts.nodes[node], parts))
        return tuple(each for each in devices if self._bootable_ns(node, each, parts, seen) > now_ns)

    def all_booted_ns(self, parts: ComponentModel, seen: Seen) -> int:
        """Return when all devices that have got their power lately will have booted, at the latest; 0: they
        have.
        """
        ends = [
            self._power_ns(name, seen) + _may_boot_ns(device)
            for name, device in parts.hardware.items()
            if self._power_ns(name, seen)
        ]
        return max((end for end in ends if end > CLOCK.now_ns()), default=0)

    def found_again_ns(self, devices: Collection[str], parts: ComponentModel, seen: Seen) -> int:
        """Return when drivers that nobody restarts will have found these devices, which have got their power,
        and been heard to, at the latest; 0: no such driver rests on any.
        """
        ends = [0]
        for node in parts.nodes.values():
            waits_for = () if node.restartable else self._devices(node, parts)
            for device in (each for each in waits_for if each in devices and self._power_ns(each, seen)):
                topics = (Atom("ok", (topic,)) for topic in node.publishes)
                heard_ns = max((seen.delays(atom).settling_ns for atom in topics), default=0) + SLACK_NS
                booted_ns = self._power_ns(device, seen) + _may_boot_ns(parts.hardware[device])
                ends.append(booted_ns + heard_ns)
        return max(ends)

    def needs_s(self, name: str, parts: ComponentModel) -> float:
        """Return how long what hangs on a component may need from when it is on, or runs, by the model and by
        earlier starts; 0: nothing is known.
        """
        if name in parts.hardware:
            fed = [name, *(each for each in parts.hardware if name in parts.feeders(each))]
            boot_s = max(_with_room(_ns(parts.hardware[each].boot_s)) for each in fed) / 1e9
            drivers = [node for node in parts.nodes.values() if not set(fed).isdisjoint(node.drives)]
        else:
            boot_s, drivers = 0.0, [parts.nodes[name]] if name in parts.nodes else []
        powered = name in parts.hardware
        own = (self._own_ns(topic, node, powered=powered) for node in drivers for topic in node.publishes)
        return boot_s + max(map(_with_room, own), default=0) / 1e9

    def seen_s(self, node: Node, *, powered: bool) -> float:
        """Return the longest of the latest starts of a node that were seen; 0: none was."""
        starts = (self._took[topic] for topic in node.publishes if topic in self._took)
        return max((each.longest_ns(powered=powered) for each in starts), default=0) / 1e9

    def _own_ns(self, topic: str, node: Node, *, powered: bool) -> int:
        """Return the longest that a node is known to need for a topic, all that it needs being there."""
        starts = self._took.get(topic)
        return max(_ns(node.start_s), 0 if starts is None else starts.longest_ns(powered=powered))

    def _began_ns(self, node: str, seen: Seen) -> int:
        return max(self._began_by_us.get(node, 0), seen.rose_ns(Atom(Node.state, (node,))) or 0)

    def _power_ns(self, device: str, seen: Seen) -> int:
        """Return when a device was seen to get its power, or was switched by a repair; 0: nobody knows."""
        on = Atom(Hardware.state, (device,))
        if seen.value(on) is False:
            return 0
        rose_ns = (seen.rose_ns(on) or 0) if seen.seen_off(on) else 0
        return max(rose_ns, self._switched.get(device, 0))

    def _devices(self, node: Node, parts: ComponentModel) -> tuple[str, ...]:
        return (*node.drives, *(each for name in node.drives for each in parts.feeders(name)))

    def _up_before(self, time_ns: int, topics: Iterable[Atom], parts: ComponentModel, seen: Seen) -> bool:
        """Whether who publishes these, which nobody reports, ran before that: then nobody waits for them."""
        nodes = (node for atom in topics for node in self.publishers(parts).get(atom.args[0], ()))
        running = [Atom(Node.state, (node.name,)) for node in nodes]
        return all(seen.value(each) and (seen.rose_ns(each) or 0) < time_ns for each in running)

    def _powered_after(self, time_ns: int, nodes: Iterable[Node], parts: ComponentModel, seen: Seen) -> bool:
        """Return whether a device that one of the nodes drives, or its supply, got its power after that."""
        names = {name for node in nodes for name in node.drives}
        names |= {feeder for name in names for feeder in parts.feeders(name)}
        switched = (Atom(Hardware.state, (name,)) for name in names)
        rose_ns = (seen.rose_ns(each) or 0 for each in switched if seen.seen_off(each))
        return any(at_ns > time_ns for at_ns in (*rose_ns, *(self._switched.get(n, 0) for n in names)))


def _inputs(node: Node, topic: str) -> list[Atom]:
    """Return the inputs that a node needs to publish a topic."""
    inputs = node.publishes[topic] if not node.drives or node.inputs_matter else ()
    return [Atom("ok", (name,)) for name in inputs]


def _ns(seconds: float | None) -> int:
    return round((seconds or 0.0) * 1e9)


def _about(known_ns: int) -> int:
    """Return what to try after what has taken so long, where in vain means to try once more."""
    return known_ns + max(known_ns // 8, LEAST_NS) if known_ns else 0


def _may_boot_ns(device: Hardware) -> int:
    """Return how long a device may boot, whether or not the model says."""
    return BOOTS_NS if device.boot_s is None else _with_room(_ns(device.boot_s))


def _with_room(known_ns: int) -> int:
    """Return how long to wait for what has taken so long: half of it more, and half a second at least."""
    return known_ns + max(known_ns // 2, LEAST_NS) if known_ns else 0
