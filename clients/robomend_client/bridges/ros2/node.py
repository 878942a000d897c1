"""The bridge as a node of ROS 2: what it listens to, what it tells, and its own place in the graph.

every LOOK_S   what is new on the network? ──► readers for its writers, mismatches, our own entities
`read_now`     what has come in? ──► whoever wants the topic
"""

from __future__ import annotations

import time
from collections.abc import Iterable
from dataclasses import dataclass

from robomend_client.beats import beat
from robomend_client.bridges.problems import Complaint, Problems
from robomend_client.bridges.ros2 import entities
from robomend_client.bridges.ros2.base import LOOK_S
from robomend_client.bridges.ros2.cdr import BadCdr
from robomend_client.bridges.ros2.dds import Dds, RawReader, RawWriter
from robomend_client.bridges.ros2.discovered import Discovered
from robomend_client.bridges.ros2.entities import Entities, NodeEntities
from robomend_client.bridges.ros2.names import wire_topic, wire_type
from robomend_client.bridges.ros2.topics import ListenedTopic, OnSample

TELL_S = 5.0
"""Whoever is heard again tells its nodes within so long."""


class Forgotten(Exception):
    """Somebody whom we had lost, and who had not lost us, does not tell again what it has.

    That is so when a network was split for longer than the one's lease and shorter than the other's: the one
    waits to be told, the other has told it all. A participant with another key is told everything.
    """


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

    def __init__(self, name: str, problems: Problems) -> None:
        self.name = name
        self.problems = problems
        self.found = Discovered()
        self._topics: dict[str, ListenedTopic] = {}
        self._told: list[ToldByUs] = []
        self._mismatches: set[str] = set()
        self._announced: Entities | None = None
        self._returned_s: dict[bytes, float] = {}  # since when

    def subscribe(self, topic: str, on_sample: OnSample) -> None:
        """Listen to a topic, as soon as somebody publishes it."""
        if (known := self._topics.get(topic)) is not None:
            known.add(on_sample)
        else:
            self._topics[topic] = ListenedTopic(topic, on_sample, self.problems)

    def publish(self, topic: str, kind: str) -> ToldByUs:
        """Offer a topic."""
        told = ToldByUs(topic, kind, self.found)
        self._told.append(told)
        return told

    def read_now(self) -> None:
        """Hand on what has come in."""
        for topic in self._topics.values():
            topic.take(self.found)

    async def run(self, dds: Dds) -> None:
        """Be a node until cancelled.

        Raises:
            Forgotten: the domain must be entered anew.
        """
        self.found.own = dds.key
        graph_in = dds.reader(entities.TOPIC, entities.TYPE, 100, latched=True)
        graph_out = dds.writer(entities.TOPIC, entities.TYPE, latched=True)
        for told in self._told:
            told.writer = dds.writer(wire_topic(told.topic), wire_type(told.kind))
        try:
            while True:
                self._look(dds, graph_in, graph_out)
                await beat(LOOK_S)
        finally:
            for told in self._told:
                if told.writer is not None:
                    told.writer.close()
                    told.writer = None
            for topic in self._topics.values():
                topic.close()
            graph_in.close()
            graph_out.close()

    def _look(self, dds: Dds, graph_in: RawReader, graph_out: RawWriter) -> None:
        changed = dds.discover(self.found)
        for sample in graph_in.take():
            changed = True
            try:
                self.found.told(entities.decode(sample.data))
            except BadCdr as error:
                self.problems.tell(entities.TOPIC, Complaint("a message cannot be read", str(error)))
        if changed:
            for topic in self._topics.values():
                topic.follow(dds, self.found)
            self._announce(graph_out)
            self._tell_mismatches()

        self._look_at_returned()

    def _look_at_returned(self) -> None:
        now_s = time.monotonic()
        self._returned_s = {key: self._returned_s.get(key, now_s) for key in self.found.returned}
        if any(now_s - since_s > TELL_S for since_s in self._returned_s.values()):
            raise Forgotten

    def _announce(self, graph_out: RawWriter) -> None:
        """Say which readers and writers are ours, as others say it."""
        readers = (topic.key for topic in self._topics.values())
        writers = (told.writer.key for told in self._told if told.writer is not None)
        own = NodeEntities(self.name, _known(readers), tuple(writers))
        said = Entities(self.found.own, (own,), self.found.gid_size or entities.GID)
        if said != self._announced:
            graph_out.write(entities.encode(said))
            self._announced = said
            self.found.told(said)

    def _tell_mismatches(self) -> None:
        found = self.found.mismatches()
        for topic, why in found.items():
            self.problems.tell(f"{topic}, its nodes", why)
        for topic in self._mismatches - found.keys():
            self.problems.over(f"{topic}, its nodes")
        self._mismatches = set(found)


def _known(keys: Iterable[bytes | None]) -> tuple[bytes, ...]:
    return tuple(key for key in keys if key is not None)
