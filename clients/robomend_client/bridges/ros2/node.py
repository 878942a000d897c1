"""The bridge as a node of ROS 2: what it listens to, what it tells, and its own place in the graph.

every LOOK_S   what is new on the network? ──► readers for its writers, mismatches, our own entities
`read_now`     what has come in? ──► whoever wants the topic

Somebody whom we had lost, and who had not lost us, does not tell again what it has: so it is when one was
halted, or a network split, for longer than the one's lease and shorter than the other's. A participant with
another key is told everything. So the domain is entered once more, beside the part that hears all the others,
and only when the new one knows them, too, does it take the old one's place:

    old part    hears the others ─────────────────────────────┐ closed
    new part         entered, is told of all ── reads them, too ┴─► hands on what is newer
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

from robomend_client.beats import beat
from robomend_client.bridges.problems import Complaint, Problems
from robomend_client.bridges.ros2 import cdr
from robomend_client.bridges.ros2.base import LOOK_S, Unheard
from robomend_client.bridges.ros2.cdr import BadCdr, Entities, NodeEntities
from robomend_client.bridges.ros2.dds import Dds, NoDds, RawReader, RawWriter, Sample
from robomend_client.bridges.ros2.discovered import Discovered, Endpoint
from robomend_client.bridges.ros2.names import ros_topic, ros_type, wire_topic, wire_type

# --- a topic that the bridge listens to: with the type and the quality of service that its newest writer has.
#
# So it is heard whatever its writers offer: best effort and volatile; from the start, where all of them are
# latched. A topic whose writer changes its type is heard on, by the new one, and that is told.

DEPTH = 100
"""Samples of one topic that may come between two looks: 1 kHz, and twice that."""

MOST_WRITERS = 1024

OnSample = Callable[[Endpoint, Sample], None]


class ListenedTopic:
    """One topic, by its name in ROS."""

    def __init__(self, topic: str, on_sample: Sequence[OnSample], problems: Problems) -> None:
        self.topic = topic
        self.wire = wire_topic(topic)
        self.newest_ns: dict[bytes, int] = {}  # writer -> its stamp on what was taken last
        self._on_sample = on_sample
        self._problems = problems
        self._reader: RawReader | None = None
        self._reads: tuple[str, bool] | None = None  # type on the wire, latched
        self._writer: Endpoint | None = None  # the newest
        self._changed_from = ""  # a type, as long as that is to be told

    @property
    def key(self) -> bytes | None:
        """Our reader's key."""
        return None if self._reader is None else self._reader.key

    def follow(self, dds: Dds, found: Discovered) -> None:
        """Listen as its writers speak now."""
        writers = found.writers(self.wire)
        if not writers:
            return
        reads = choose(writers)
        self._writer = writers[-1]
        if self._reads is not None and reads[0] != self._reads[0]:
            self._changed_from = ros_type(self._reads[0])
        if self._changed_from and found.is_named(self._writer):
            what = f"{found.node_of(self._writer)} publishes {ros_type(reads[0])}"
            self._problems.tell(self.topic, f"{what}, where {self._changed_from} came before")
            self._changed_from = ""
        if reads == self._reads:
            return
        self.close()
        self._reads = reads
        try:
            self._reader = dds.reader(self.wire, reads[0], DEPTH, reads[1])
        except NoDds as error:
            self._problems.tell(self.topic, str(error))

    def take(self, found: Discovered, after_ns: Mapping[bytes, int] | None = None) -> bool:
        """Hand on what has come in; return whether anything had.

        With `after_ns`, of each writer in there what is newer than that; of others only what is latched: what
        waited of them came over some time, and would all count as having come now.
        """
        if self._reader is None:
            return False
        samples = self._reader.take()
        others_ns = 0 if self._reads is not None and self._reads[1] else 1 << 62
        for sample in samples:
            writer = found.writer(sample.writer) or self._somebody()
            if len(self.newest_ns) < MOST_WRITERS:
                self.newest_ns[writer.key] = sample.time_ns
            if after_ns is None or sample.time_ns > after_ns.get(writer.key, others_ns):
                for on_sample in self._on_sample:
                    on_sample(writer, sample)
        return bool(samples)

    def _somebody(self) -> Endpoint:
        """Return a writer that has gone, or has just begun and is not discovered yet: it has no name."""
        assert self._writer is not None  # there was one when the reader was made
        return replace(self._writer, key=b"", participant=b"")

    def close(self) -> None:
        if self._reader is not None:
            self._reader.close()
            self._reader = None


def choose(writers: Sequence[Endpoint]) -> tuple[str, bool]:
    """Return the type to listen for, and whether all its writers are latched."""
    kind = writers[-1].type
    same = [writer for writer in writers if writer.type == kind]
    return kind, all(writer.durability and writer.reliable for writer in same)


TELL_S = 2.0
"""Whoever is heard again tells its nodes within so long, or does not."""

READS_S = 1.0
"""Writers send to a new reader within so long after both have been found."""

MOST_S = 10.0
"""So long, at most, is waited until the new part knows all that the old one does."""

AGAIN_S = 10.0
"""Between two tries: one that is in vain, as somebody tells nothing to anybody, costs little."""


class Forgotten(Exception):
    """Also a second part of ours is not told: the domain must be left and entered anew."""


@dataclass
class ToldByUs:
    """A topic that we publish."""

    topic: str
    kind: str
    found: Discovered
    writer: RawWriter | None = None

    @property
    def wanted(self) -> bool:
        """Whether anybody else listens."""
        return self.writer is not None and self.found.listened(wire_topic(self.topic))

    def publish(self, message: bytes) -> None:
        if self.writer is not None:
            self.writer.write(message)


class DdsNode:
    """One node. Topics are named with their slash, types as std_msgs/String."""

    def __init__(self, name: str, problems: Problems, discovery_s: float = 3.0) -> None:
        """Who is there is found within `discovery_s`."""
        self.name = name
        self.problems = problems
        self.found = Discovered()
        self._wanted: dict[str, list[OnSample]] = {}
        self._told: list[ToldByUs] = []
        self._mismatches: set[str] = set()
        self.unheard = Unheard(discovery_s)
        self._part: _Part | None = None
        self._next: _Part | None = None
        self._again_s = float("-inf")  # when the domain was last entered once more

    def subscribe(self, topic: str, on_sample: OnSample) -> None:
        """Listen to a topic, as soon as somebody publishes it; while the node runs, too."""
        known = self._wanted.setdefault(topic, [])
        known.append(on_sample)
        for part in (self._part, self._next):
            if part is not None:
                part.listen(topic, known)

    def publish(self, topic: str, kind: str) -> ToldByUs:
        """Offer a topic."""
        told = ToldByUs(topic, kind, self.found)
        self._told.append(told)
        return told

    def read_now(self) -> None:
        """Hand on what has come in."""
        if self._part is not None:
            for topic in self._part.take():
                self.unheard.heard(topic)

    @property
    def unseen(self) -> set[str]:
        """Topics of which nothing would be heard now if there were something."""
        self.unheard.look(self._wanted)
        untold = (ros_topic(topic) for topic in self.found.untold_topics)
        return {*self.unheard, *(topic for topic in untold if topic in self._wanted)}

    def publishers(self, topic: str) -> tuple[str, ...]:
        """Return the nodes that publish a topic, once for each publisher."""
        return tuple(sorted(map(self.found.node_of, self.found.writers(wire_topic(topic)))))

    def mismatches(self) -> dict[str, str]:
        """Return the topics of which no message goes from a writer to a reader, and why."""
        return self.found.mismatches()

    async def run(self, dds: Dds) -> None:
        """Be a node until cancelled; the caller closes `dds`, in whose place another one may be by then.

        Raises:
            Forgotten: the domain must be entered anew.
        """
        part = self._part = _Part(dds, self.found, self._wanted, self._told, self)
        for told, writer in zip(self._told, part.writers, strict=True):
            told.writer = writer
        self.unheard.of(self._wanted)
        try:
            while True:
                if self._part.look():
                    self._tell_mismatches()
                self._look_at_returned(self._part)
                await beat(LOOK_S)
        finally:
            for told in self._told:
                told.writer = None
            for one in (self._next, self._part):
                if one is not None:
                    one.close()
                    if one.dds is not dds:
                        one.dds.close()
            self._part = self._next = None

    # --- once more ---------------------------------------------------------------------------------------

    def _look_at_returned(self, part: _Part) -> None:
        """Enter the domain once more where somebody is heard again and does not tell what it has."""
        new = self._next
        if new is not None:
            new.look()
            if new.is_ready(part):
                if self.found.returned & new.found.unknown_nodes:
                    raise Forgotten
                self._change_over(part, new)
            return
        now_s = time.monotonic()
        part.returned_s = {key: part.returned_s.get(key, now_s) for key in self.found.returned}
        waited_s = max((now_s - since_s for since_s in part.returned_s.values()), default=0.0)
        if waited_s > TELL_S and now_s - self._again_s > AGAIN_S:
            self._again_s = now_s
            why = "nodes that were out of reach do not tell again what they have"
            self.problems.tell("DDS", f"{why}: the domain is entered once more")
            found = Discovered()
            found.lost.update(self.found.lost)
            try:
                self._next = _Part(part.dds.again(), found, self._wanted, self._told, self)
            except NoDds as error:
                self.problems.tell("DDS", str(error))

    def _change_over(self, old: _Part, new: _Part) -> None:
        """Have the new part take the old one's place; of nobody is anything lost, or heard twice."""
        unknown = [
            name
            for name, topic in old.topics.items()
            if not new.found.knows_writers_of(old.found, [topic.wire])
        ]
        old.take()
        taken_ns = {
            name: {key: at_ns for key, at_ns in topic.newest_ns.items() if key in old.found.endpoints}
            for name, topic in old.topics.items()
        }
        self.found.become(new.found)
        new.found = self.found
        for told, writer in zip(self._told, new.writers, strict=True):
            told.writer = writer
        for name in new.take(taken_ns):
            self.unheard.heard(name)
        self.unheard.of(unknown)
        self._part, self._next = new, None
        old.close()
        old.dds.close()
        self.problems.over("DDS")

    def _tell_mismatches(self) -> None:
        found = self.found.mismatches()
        for topic, why in found.items():
            self.problems.tell(f"{topic}, its nodes", why)
        for topic in self._mismatches - found.keys():
            self.problems.over(f"{topic}, its nodes")
        self._mismatches = set(found)


class _Part:
    """One participant of ours: what it hears, what it tells, and what it has discovered."""

    def __init__(
        self,
        dds: Dds,
        found: Discovered,
        wanted: Mapping[str, Sequence[OnSample]],
        told: Iterable[ToldByUs],
        node: DdsNode,
    ) -> None:
        self.dds = dds
        self.found = found
        found.own = dds.key
        self._node = node
        self.topics = {topic: ListenedTopic(topic, wanted, node.problems) for topic, wanted in wanted.items()}
        self.writers = [dds.writer(wire_topic(one.topic), wire_type(one.kind)) for one in told]
        self.returned_s: dict[bytes, float] = {}  # since when
        self._graph_in = dds.reader(cdr.TOPIC, cdr.TYPE, 100, latched=True)
        self._graph_out = dds.writer(cdr.TOPIC, cdr.TYPE, latched=True)
        self._announced: Entities | None = None
        self._began_s = time.monotonic()
        self._complete_s: float | None = None  # since when it knows all that the part before it does

    def listen(self, topic: str, on_sample: Sequence[OnSample]) -> None:
        """Listen to one more topic."""
        if topic not in self.topics:
            one = self.topics[topic] = ListenedTopic(topic, on_sample, self._node.problems)
            one.follow(self.dds, self.found)
            self._announce()

    def look(self) -> bool:
        """See what is new on the network; return whether anything was."""
        problems = self._node.problems
        changed = self.dds.discover(self.found)
        for sample in self._graph_in.take():
            changed = True
            try:
                self.found.told(cdr.decode(sample.data))
            except BadCdr as error:
                problems.tell(cdr.TOPIC, Complaint("a message cannot be read", str(error)))
        if changed:
            for topic in self.topics.values():
                topic.follow(self.dds, self.found)
            self._announce()
        return changed

    def take(self, after_ns: Mapping[str, Mapping[bytes, int]] | None = None) -> list[str]:
        """Hand on what has come in, of each topic and writer what is newer than that; return of which."""
        return [
            name
            for name, topic in self.topics.items()
            if topic.take(self.found, None if after_ns is None else after_ns.get(name))
        ]

    def is_ready(self, old: _Part) -> bool:
        """Return whether this part may take another's place: it knows what that one knows, and reads it."""
        now_s = time.monotonic()
        topics = [topic.wire for topic in old.topics.values()]
        if self.found.untold or not self.found.knows_writers_of(old.found, topics):
            self._complete_s = None
        elif self._complete_s is None:
            self._complete_s = now_s
        complete = self._complete_s is not None and now_s - self._complete_s > READS_S
        return complete or now_s - self._began_s > MOST_S

    def close(self) -> None:
        for topic in self.topics.values():
            topic.close()
        for writer in (*self.writers, self._graph_out):
            writer.close()
        self._graph_in.close()

    def _announce(self) -> None:
        """Say which readers and writers are ours, as others say it."""
        readers = (topic.key for topic in self.topics.values())
        own = NodeEntities(self._node.name, _known(readers), tuple(writer.key for writer in self.writers))
        said = Entities(self.found.own, (own,), self.found.gid_size or cdr.GID)
        if said != self._announced:
            self._graph_out.write(cdr.encode(said))
            self._announced = said
            self.found.told(said)


def _known(keys: Iterable[bytes | None]) -> tuple[bytes, ...]:
    return tuple(key for key in keys if key is not None)
