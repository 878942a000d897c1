"""What the bridges to ROS 2 have in common, over DDS and over zenoh: messages in, for whoever wants them.

topics ──► ticks and fields ──┐
nodes ──► table ──────────────┼──► observers
/diagnostics ──► statuses ────┘
"""

from __future__ import annotations

import asyncio
import os
import time
from collections.abc import Awaitable, Callable, Coroutine, Hashable, Iterable, Iterator, Mapping
from importlib import import_module
from pathlib import Path
from typing import Any, ClassVar, NamedTuple, Protocol

from robomend_client.agent.executors.ros_programs import Ros2Asking
from robomend_client.agent.feeds import AgentParts, Deliver, split
from robomend_client.agent.ring import TopicDescription
from robomend_client.beats import beat
from robomend_client.bridges.base import DIAGNOSTICS, NODES, RosBridge, RosPart, Runs
from robomend_client.bridges.fields import MissingField, UnreadableMessage
from robomend_client.bridges.listening import Listening
from robomend_client.bridges.opened import OpenedMessage
from robomend_client.bridges.problems import MIXED_S
from robomend_client.bridges.ros2 import formats
from robomend_client.bridges.ros2.messages import MessageReaders, folders_of
from robomend_client.bridges.ros2.names import ros_type
from robomend_client.bridges.ros2.stamps import Ages
from robomend_client.bridges.telling import Outgoing, ToldTopic
from robomend_client.observers.meeting import MISMATCHES
from robomend_client.observers.meeting import TABLE_S as MISMATCHES_S
from robomend_client.python310 import end
from robomend_client.yaml_reader import Section

TELLS: dict[str, tuple[str, Callable[..., bytes | None]]] = {
    "observations": (formats.STRING, formats.observations),
    "diagnosis": (formats.STRING, formats.diagnosis),
    "diagnostics": (formats.DIAGNOSTICS, formats.diagnostics),
}

HIGHEST_DOMAIN = 232
LOOK_S = 0.1
"""How often it is looked who is there."""

TABLE_S = 0.5
"""How often it is told which nodes run, changed or not."""

MOST_UNTOLD = 3
"""Whoever was found and has not told its nodes after so many times discovery_s will not do so."""

DROPPED_S = 2.0
"""Others drop us when they have not heard us for 10 s, and hear us each 8 s at least."""

DRAINED_S = 1.5
"""So long what comes after that may be what waited in sockets, or of those who are about to drop us."""

REFOUND_S = 10.0
"""Those that have dropped us, or whom we have dropped, are found again within so long."""

LOOK_AT_MOST_S = 0.25
"""More between two looks does not count as time in which it was looked."""

MOST_WRITERS = 4096

LookAtNodes = Callable[[], Awaitable["Mapping[str, Runs] | None"]]
"""Returns which nodes run; None: nobody knows now."""


class Message(NamedTuple):
    """A message as it came."""

    data: bytes
    wire_type: str  # std_msgs::msg::dds_::String_
    type_hash: str  # as its publisher tells it, or nothing
    writer: Hashable  # whose stamps are comparable
    node: str  # its publisher's; nothing, until that is known
    stamp_ns: int | None  # by its writer's clock
    latched: bool = False  # it will not come again


OnMessage = Callable[[Message], None]


class Ros2Node(RosPart, Protocol):
    """Our node on a network of ROS 2."""

    def subscribe(self, topic: str, on_message: OnMessage) -> None:
        """Listen to a topic."""

    def publish(self, topic: str, kind: str) -> Outgoing:
        """Offer a topic."""
        ...

    def mismatches(self) -> Mapping[str, str]:
        """Return the topics of which no message goes from a writer to a reader, and why."""
        ...

    @property
    def unheard(self) -> Unheard:
        """For how long, and at what, it is not looked."""
        ...


class Unheard:
    """Topics that are not looked at until something of them is heard, or until a time.

    So it is with all of them when the network was just entered, and when nobody looked for so long that
    others may have dropped us: until who is there has been found, nothing that does not come is silent, and
    what waited meanwhile, which comes all at once, is neither a rate nor a sign that we are found.

        halted          |  drains  |  refinds                   |
        what waited ────┴► left out                             └► what was not heard is silent
                                   └► what comes is heard

    All times are of looking: a bridge that is halted, or starved, has no less of them.
    """

    def __init__(self, found_s: float) -> None:
        """`found_s`: who is there has been found after so long."""
        self._found_s = found_s
        self._until_s: dict[str, float] = {}
        self._clock_s = time.monotonic()
        self.looked_s = 0.0  # all together
        self._drained_s = self._refound_s = 0.0

    def of(self, topics: Iterable[str]) -> None:
        """Nothing can be heard of these yet."""
        self._not_before(topics, self.looked_s + self._found_s)

    def look(self, topics: Iterable[str]) -> None:
        """Look at the clock: called again and again."""
        before_s, self._clock_s = self._clock_s, time.monotonic()
        gap_s = self._clock_s - before_s
        self.looked_s += min(gap_s, LOOK_AT_MOST_S)
        if gap_s > DROPPED_S:
            self._drained_s = self.looked_s + DRAINED_S
            self._refound_s = self.looked_s + REFOUND_S
            self._not_before(topics, self._refound_s)

    def _not_before(self, topics: Iterable[str], until_s: float) -> None:
        for topic in topics:
            self._until_s[topic] = max(until_s, self._until_s.get(topic, 0.0))

    def heard(self, topic: str) -> None:
        if not self.drains:
            self._until_s.pop(topic, None)

    @property
    def drains(self) -> bool:
        """Whether what comes may have waited while nobody looked."""
        return self.looked_s < self._drained_s

    @property
    def refinds(self) -> bool:
        """Whether others may not have found us again, or we them, since nobody looked."""
        return self.looked_s < self._refound_s

    def __iter__(self) -> Iterator[str]:
        return iter([topic for topic, until_s in self._until_s.items() if self.looked_s < until_s])


class Ros2Bridge(RosBridge):
    """All that does not depend on how the messages come."""

    folder: ClassVar[str]
    """Where others' sentences wait, in the agent's state directory."""

    def __init__(self, section: Section, base: Path, sources: frozenset[str], where: str) -> None:
        super().__init__(section, where, TELLS)
        section.explain(
            domain="the ROS domain; by default ROS_DOMAIN_ID, or 0",
            discovery_s="a node that was not found after so many seconds does not run",
            messages="folders of packages with the robot's own types, FOLDER/PACKAGE/msg/NAME.msg; the "
            "packages of AMENT_PREFIX_PATH are known",
        )
        self.domain = _domain(section)
        self.discovery_s = section.number("discovery_s", 3.0, least=0.1, most=60)
        self.messages = tuple(base / folder for folder in section.texts("messages"))
        self._readers = MessageReaders(folders_of(os.environ, self.messages))
        self._ages: dict[Hashable, Ages] = {}
        for source in sorted(sources - {NODES, MISMATCHES}):
            if source == DIAGNOSTICS:
                self.hear_diagnostics()
            else:
                topic, field = split(source)
                self._topics.setdefault(self.topic_of(topic), []).append((source, field))
        self._watches_nodes = NODES in sources
        self._watches_mismatches = MISMATCHES in sources
        self._node: Ros2Node | None = None
        self._looks = any(field for wanted in self._topics.values() for _, field in wanted)

    @property
    def environment(self) -> dict[str, str]:
        """Where the robot's nodes are, for programs of ROS 2."""
        return {"ROS_DOMAIN_ID": str(self.domain)}

    async def import_reader(self) -> None:
        """Import what reads messages, if somebody looks into them."""
        if self._looks:
            await asyncio.to_thread(import_module, "rosbags.typesys")

    def read_now(self) -> None:
        if self._node is not None:
            self.look(self._node)

    async def be(
        self,
        node: Ros2Node,
        work: Coroutine[Any, Any, None],
        look: LookAtNodes,
        untold: Callable[[], bool],
        deliver: Deliver,
    ) -> None:
        """Be this node, and deliver what it hears, until cancelled.

        Args:
            work: the node's own.
            untold: says whether there is somebody who has not told its nodes yet.
        """
        for topic, wanted in self._topics.items():
            node.subscribe(topic, self._hearing(topic, wanted, node.unheard, deliver))
        self._node, self._deliver = node, deliver
        works = [work] if self._parts is not None else [work, self.read_on()]
        if self._watches_nodes:
            works.append(self._tables(look, untold, node.unheard, deliver))
        if self._watches_mismatches:
            works.append(self._meetings(node, deliver))
        if self._parts is not None:
            works += self._with(node, self._parts)
        tasks = [asyncio.create_task(part) for part in works]
        try:
            await asyncio.gather(*tasks)
        finally:
            self._node = None
            await end(tasks)

    # --- as a part of an agent ---------------------------------------------------------------------------

    def _with(self, node: Ros2Node, parts: AgentParts) -> list[Coroutine[Any, Any, None]]:
        """Return what else there is to do as a part of an agent."""
        for executor in parts.executors:
            if isinstance(executor, Ros2Asking):
                executor.attach(self.environment)
        topics = {}
        for name in self.publishes:
            kind, message = TELLS[name]
            topics[name] = ToldTopic(node.publish(self.told_topic(name), kind), message)
        work = [self.tell_by(parts, topics).run()]
        if self.hears:
            listening = self.listening(parts, self.folder)
            node.subscribe(self.names.ros("observations"), lambda message: self._said(listening, message))
            work.append(listening.run())
        return work

    def _said(self, listening: Listening, message: Message) -> None:
        """Somebody has said something on /observations: in `data`, or in a list `obs`."""
        if message.node in ("", self.node_name) or listening.ignores(message.node):
            return
        try:
            opened = self._opened(message)
            found = opened.at("obs" if opened.has("obs") else "data")
        except UnreadableMessage as error:
            self.problems.tell(f"/observations by {message.node}", str(error))
            return
        listening.heard(message.node, map(str, found if isinstance(found, list) else [found]))

    # --- what observers get ----------------------------------------------------------------------------

    async def _tables(
        self, look: LookAtNodes, untold: Callable[[], bool], unheard: Unheard, deliver: Deliver
    ) -> None:
        """Say which nodes run: at once when one begins or ends, and now and then."""
        found_s = unheard.looked_s + self.discovery_s  # whoever was not found by then is not there
        told_s = found_s + MOST_UNTOLD * self.discovery_s
        while unheard.looked_s < found_s or (untold() and unheard.looked_s < told_s):
            await beat(LOOK_S)
        said: dict[str, Runs] | None = None
        said_s = 0.0
        while True:
            found = await look()
            if found is not None and not unheard.drains:
                self.look_at_names(found)
                table = self.table(found)
                if table != said or time.monotonic() - said_s >= TABLE_S:
                    deliver(NODES, table, None)
                    said, said_s = table, time.monotonic()
            await beat(LOOK_S)

    async def _meetings(self, node: Ros2Node, deliver: Deliver) -> None:
        """Say of which topics no message goes from a writer to a reader: at once when it changes, and now
        and then.
        """
        said: dict[str, str] | None = None
        said_s = 0.0
        while True:
            if not any(True for _ in node.unheard):
                found = {self.names.ours(topic): why for topic, why in node.mismatches().items()}
                if found != said or time.monotonic() - said_s >= MISMATCHES_S:
                    deliver(MISMATCHES, found, None)
                    said, said_s = found, time.monotonic()
            await beat(LOOK_S)

    def _hearing(
        self, topic: str, wanted: list[tuple[str, str]], unheard: Unheard, deliver: Deliver
    ) -> OnMessage:
        fields = [(source, field) for source, field in wanted if field]
        counted = [source for source, field in wanted if not field]

        tap = self._tap(self._described)

        def heard(message: Message) -> None:
            if unheard.drains and not message.latched:
                return
            time_ns = self._made_ns(message)
            if tap is not None:
                tap(topic, time_ns, message.data, (message.wire_type, message.type_hash))
            for source in counted:
                deliver(source, None, time_ns)
            if not fields:
                return
            try:
                opened = self._opened(message)
                for source, field in fields:
                    try:
                        deliver(source, opened.at(field), time_ns)
                    except MissingField as error:
                        self._tell(f"{topic} by {{}}, {field}", message, str(error))
            except UnreadableMessage as error:
                self._tell(f"messages of {topic} by {{}}", message, error)
            else:
                self.problems.over(f"messages of {topic} by {message.node}", MIXED_S)

        return heard

    def _opened(self, message: Message) -> OpenedMessage:
        return self._readers.open(ros_type(message.wire_type), message.type_hash, message.data)

    def _described(self, about: tuple[str, str]) -> TopicDescription:
        wire_type, type_hash = about
        return self._readers.described(ros_type(wire_type), type_hash)

    def _tell(self, place: str, message: Message, why: str | Exception) -> None:
        """Tell what is wrong with a node's messages, as soon as it has a name: more of them will come."""
        if message.node:
            self.problems.tell(place.format(message.node), why)

    def _made_ns(self, message: Message) -> int:
        """Return when a message was made, by the agent's clock."""
        now_ns = time.time_ns() if self._parts is None else self._parts.clock.now_ns()
        if message.stamp_ns is None:
            return now_ns
        if len(self._ages) >= MOST_WRITERS:
            self._ages.clear()  # of writers that have gone, most of them
        ages = self._ages.setdefault(message.writer, Ages())
        return now_ns - ages.age_ns(message.stamp_ns, now_ns)


def _domain(section: Section) -> int:
    said = os.environ.get("ROS_DOMAIN_ID", "")
    default = int(said) if said.isdecimal() and int(said) <= HIGHEST_DOMAIN else 0
    found = section.number("domain", default, least=0, most=HIGHEST_DOMAIN)
    if found != int(found):
        raise section.error("domain", f"must be a whole number, not {found:g}")
    return int(found)
