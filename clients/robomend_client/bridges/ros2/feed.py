"""The bridge as a feed: the section `ros2:` of the agent's file, and who gets what.

topics ──► ticks and fields ──┐
nodes ──► table ──────────────┼──► observers with `from: ros2`
/diagnostics ──► statuses ────┘
"""

from __future__ import annotations

import asyncio
import os
import re
import time
from collections.abc import Callable, Coroutine, Sequence
from importlib import import_module
from pathlib import Path
from typing import Any

from robomend_client.agent.feeds import AgentParts, Deliver, split
from robomend_client.bridges.fields import UnreadableMessage, value_at
from robomend_client.bridges.listening import Listening
from robomend_client.bridges.names import Names, resolved
from robomend_client.bridges.problems import Problems
from robomend_client.bridges.ros2 import formats
from robomend_client.bridges.ros2.dds import Dds, NoDds, Sample, configuration, only_here
from robomend_client.bridges.ros2.discovered import Endpoint
from robomend_client.bridges.ros2.liveness import Liveness
from robomend_client.bridges.ros2.messages import MessageReaders, folders_of
from robomend_client.bridges.ros2.names import ros_type
from robomend_client.bridges.ros2.node import LOOK_S, DdsNode
from robomend_client.bridges.ros2.stamps import Ages
from robomend_client.bridges.telling import Telling, ToldTopic
from robomend_client.observers import Change
from robomend_client.python310 import end
from robomend_client.yaml_reader import Section

NODES, DIAGNOSTICS = "nodes", "diagnostics"
"""Sources that are more than a topic's messages or a field of them."""

ALL_DIAGNOSTICS = "/diagnostics"
"""In any namespace: the aggregator knows none."""

TELLS: dict[str, tuple[str, Callable[..., bytes | None]]] = {
    "observations": (formats.STRING, formats.observations),
    "diagnosis": (formats.STRING, formats.diagnosis),
    "diagnostics": (formats.DIAGNOSTICS, formats.diagnostics),
}

NAME = re.compile(r"/?[A-Za-z][A-Za-z0-9_/]*\Z")
HIGHEST_DOMAIN = 232
AGAIN_S = 3.0
TABLE_S = 0.5
"""How often it is told which nodes run, changed or not."""

MOST_UNTOLD = 3
"""Whoever was found and has not told its nodes after so many times discovery_s will not do so."""

MOST_WRITERS = 4096


class Ros2:
    """The feed `ros2`."""

    def __init__(self, section: Section, base: Path, sources: frozenset[str]) -> None:
        self.name = section.optional("name")
        if self.name is not None and not NAME.match(self.name):
            raise section.error("name", f"must be of letters, digits, _ and /, not {self.name!r}")
        self.domain = _domain(section)
        ranges = ("subnet", "localhost")
        self.localhost = section.choice("discovery", ranges, ranges[only_here(os.environ)]) == "localhost"
        self.peers = section.texts("peers")
        self.discovery_s = section.number("discovery_s", 3.0, least=0.1, most=60)
        self.names = Names(section.text("namespace", "/"), section.section("names").words())
        self.messages = tuple(base / folder for folder in section.texts("messages"))
        given = section.texts("publish")
        self.publishes = given if "publish" in section else tuple(TELLS)
        for topic in self.publishes:
            if topic not in TELLS:
                raise section.error("publish", f"must be of {', '.join(TELLS)}, not {topic!r}")
        self.hears = section.flag("hear_observations", True)
        self.lifetime_s = section.number("observations_s", 10.0, least=0.5, most=86400)
        self.ignored = (*section.texts("ignore"), "/robomend*")
        self.problems = Problems("ROS 2")
        self._parts: AgentParts | None = None
        self._telling: Telling | None = None
        self._readers = MessageReaders(folders_of(os.environ, self.messages))
        self._ages: dict[int, Ages] = {}
        self._topics: dict[str, list[tuple[str, str]]] = {}  # topic -> sources, each with its field
        for source in sorted(sources - {NODES}):
            if source == DIAGNOSTICS:
                self._topics.setdefault(ALL_DIAGNOSTICS, []).append((source, "status"))
            else:
                topic, field = split(source)
                self._topics.setdefault(self.names.ros(topic), []).append((source, field))
        self._watches_nodes = NODES in sources
        self._looks = any(field for wanted in self._topics.values() for _, field in wanted)

    def attach(self, parts: AgentParts) -> None:
        """Be a part of this agent; without one, the bridge only feeds observers."""
        self._parts = parts

    def changed(self, changes: Sequence[Change]) -> None:
        """Tell the robot what the agent's observers have found."""
        if self._telling is not None:
            self._telling.changed(changes)

    async def run(self, deliver: Deliver) -> None:
        """Be a node of the domain, and deliver what it hears, until cancelled."""
        if self._looks:
            await asyncio.to_thread(import_module, "rosbags.typesys")
        dds = await self._open()
        try:
            await self._run(dds, deliver)
        finally:
            dds.close()

    async def _open(self) -> Dds:
        config = configuration(os.environ, self.localhost, self.peers)
        while True:
            try:
                dds = await asyncio.to_thread(Dds, self.domain, config)
            except NoDds as error:
                self.problems.tell("DDS", f"{error} (are the network and CYCLONEDDS_URI right?)")
                await asyncio.sleep(AGAIN_S)
            else:
                self.problems.over("DDS")
                return dds

    async def _run(self, dds: Dds, deliver: Deliver) -> None:
        agent = "" if self._parts is None else "_" + re.sub(r"[^A-Za-z0-9_]", "_", self._parts.agent)
        node = DdsNode(resolved(self.name or f"robomend{agent}"), self.problems)
        for topic, wanted in self._topics.items():
            node.subscribe(topic, self._hearing(node, topic, wanted, deliver))
        work = [node.run(dds)]
        if self._watches_nodes:
            work.append(self._tables(node, deliver))
        if self._parts is not None:
            work += self._with(node, self._parts)
        tasks = [asyncio.create_task(part) for part in work]
        try:
            await asyncio.gather(*tasks)
        finally:
            await end(tasks)

    def _with(self, node: DdsNode, parts: AgentParts) -> list[Coroutine[Any, Any, None]]:
        """Return what else there is to do as a part of an agent."""
        topics = {}
        for name in self.publishes:
            kind, message = TELLS[name]
            topic = ALL_DIAGNOSTICS if name == "diagnostics" else self.names.ros(name)
            topics[name] = ToldTopic(node.publish(topic, kind), message)
        self._telling = Telling(parts, self.problems, topics)
        work = [self._telling.run()]
        if self.hears:
            args = (self.problems, self.lifetime_s, self.ignored, "ros2-observations")
            listening = Listening(parts, self.names, *args)

            def said(writer: Endpoint, sample: Sample) -> None:
                self._said(node, listening, writer, sample)

            node.subscribe(self.names.ros("observations"), said)
            work.append(listening.run())
        return work

    def _said(self, node: DdsNode, listening: Listening, writer: Endpoint, sample: Sample) -> None:
        """Somebody has said something on /observations: in `data`, or in a list `obs`."""
        name = node.found.node_of(writer)
        if not node.found.is_named(writer) or listening.ignores(name):
            return
        try:
            message = self._readers.read(ros_type(writer.type), writer.type_hash, sample.data)
            found = value_at(message, "obs" if hasattr(message, "obs") else "data")
        except UnreadableMessage as error:
            self.problems.tell(f"/observations by {name}", str(error))
            return
        listening.heard(name, map(str, found if isinstance(found, list) else [found]))

    # --- what observers get ----------------------------------------------------------------------------

    async def _tables(self, node: DdsNode, deliver: Deliver) -> None:
        """Say which nodes run: at once when one begins or ends, and now and then."""
        liveness = Liveness(node.found)
        await asyncio.sleep(self.discovery_s)  # whoever was not found by then is not there
        told_by = time.monotonic() + MOST_UNTOLD * self.discovery_s
        while node.found.untold and time.monotonic() < told_by:
            await asyncio.sleep(LOOK_S)
        said: dict[str, bool] | None = None
        said_s = 0.0
        while True:
            table = {self.names.ours(name): runs for name, runs in (await liveness.look()).items()}
            if table != said or time.monotonic() - said_s >= TABLE_S:
                deliver(NODES, table, None)
                said, said_s = table, time.monotonic()
            await asyncio.sleep(LOOK_S)

    def _hearing(
        self, node: DdsNode, topic: str, wanted: list[tuple[str, str]], deliver: Deliver
    ) -> Callable[[Endpoint, Sample], None]:
        looks = any(field for _, field in wanted)

        def heard(writer: Endpoint, sample: Sample) -> None:
            time_ns = self._made_ns(sample)
            message = self._read(node, topic, writer, sample) if looks else None
            for source, field in wanted:
                if not field:
                    deliver(source, None, time_ns)
                elif message is not None:
                    try:
                        value = value_at(message, field)
                    except UnreadableMessage as error:
                        self._tell(node, f"{topic} by {{}}, {field}", writer, str(error))
                    else:
                        deliver(source, value, time_ns)

        return heard

    def _read(self, node: DdsNode, topic: str, writer: Endpoint, sample: Sample) -> Any:
        try:
            message = self._readers.read(ros_type(writer.type), writer.type_hash, sample.data)
        except UnreadableMessage as error:
            self._tell(node, f"messages of {topic} by {{}}", writer, str(error))
            return None
        self.problems.over(f"messages of {topic} by {node.found.node_of(writer)}")
        return message

    def _tell(self, node: DdsNode, place: str, writer: Endpoint, why: str) -> None:
        """Tell what is wrong with a writer's messages, as soon as it has a name: more of them will come."""
        if node.found.is_named(writer):
            self.problems.tell(place.format(node.found.node_of(writer)), why)

    def _made_ns(self, sample: Sample) -> int:
        """Return when a sample was made, by the agent's clock."""
        if len(self._ages) >= MOST_WRITERS:
            self._ages.clear()  # of writers that have gone, most of them
        ages = self._ages.setdefault(sample.writer, Ages())
        now_ns = time.time_ns() if self._parts is None else self._parts.clock.now_ns()
        return now_ns - ages.age_ns(sample.time_ns, now_ns)


def _domain(section: Section) -> int:
    said = os.environ.get("ROS_DOMAIN_ID", "")
    default = int(said) if said.isdecimal() and int(said) <= HIGHEST_DOMAIN else 0
    found = section.number("domain", default, least=0, most=HIGHEST_DOMAIN)
    if found != int(found):
        raise section.error("domain", f"must be a whole number, not {found:g}")
    return int(found)
