"""Listening to a running robot of which nothing is known: all its topics, nodes, statuses, into one value.

    graph ──► topics that are new ──► listened to        each LOOK_S
    messages ──► times; of /diagnostics, /rosout and lifecycles what they say
    nodes ──► who runs, who ended meanwhile

Nothing is published, and no service is called.
"""

from __future__ import annotations

import asyncio
import os
import re
import time
from abc import ABC, abstractmethod
from collections import Counter
from collections.abc import Awaitable, Callable, Collection, Mapping, Sequence
from functools import partial
from importlib import import_module
from typing import TYPE_CHECKING, Any, Protocol

from robomend_client.beats import beat
from robomend_client.bridges.fields import MissingField, UnreadableMessage
from robomend_client.bridges.opened import OpenedMessage
from robomend_client.bridges.problems import Problems
from robomend_client.counts import first_few
from robomend_client.observers.rosout import reaches
from robomend_client.python310 import end
from robomend_client.ros_graph import Ear, Heard, HeardDevice, HeardStatus, RosGraph, lasting_name, logged_by

if TYPE_CHECKING:  # what they need may not be installed
    from robomend_client.bridges.ros1.node import RosNode
    from robomend_client.bridges.ros2.base import Message
    from robomend_client.bridges.ros2.dds import Sample
    from robomend_client.bridges.ros2.discovered import Endpoint
    from robomend_client.bridges.ros2.node import DdsNode
    from robomend_client.bridges.zenoh.node import ZenohNode

NAME = "/robomend_attach"
LOOK_S = 0.5
AT_ONCE = 16
"""Topics that are asked for side by side: a master answers each in milliseconds, and a robot has hundreds."""

DIAGNOSTICS = "diagnostic_msgs/DiagnosticArray"
ROSOUT = "/rosout"
LOGS = ("rosgraph_msgs/Log", "rcl_interfaces/Log")
TRANSITION = "lifecycle_msgs/TransitionEvent"
NOISY = {"sensor_msgs/Imu": "linear_acceleration.z", "sensor_msgs/LaserScan": "ranges[:20]"}
"""Fields that are never twice the same, of sensors that work: where they have noise, which is looked for."""

ACTION_RESULT = "ActionResult"
"""Ends the type of the topic on which an action server of ROS 1 tells its results."""

DESCRIPTION = "/robot_description"
CONTROLLED = re.compile(r'<ros2_control\s[^>]*?name="([^"<>]+)".*?</ros2_control>', re.DOTALL)
PLUGIN = re.compile(r"<plugin>\s*([^<>]+?)\s*</plugin>")
MOST_DEVICES = 200
NO_DEVICE = frozenset(("", "none", "unknown", "n/a"))
"""What drivers without a device tell as its id."""

NOT_HEARD = frozenset(("/parameter_events", "/ros_discovery_info"))

MOST_TOPICS = 4096
MOST_STATUSES = 1000
JUMP_S = 1.0
"""More than that, and the clock was set."""

PING_S = 1.0
SETTLED_S = 3.0
"""After a connection of zenoh was made, all who are there are known."""

SHOWN = 10
"""Topics that are named of those with the same reason."""

LEAST_VALUES = 20
"""Of a field, all different from the one before: then it is one that does not stand still."""


class Reads(Protocol):
    """A node of ours, at which messages wait until they are read."""

    def read_now(self) -> None: ...


class Hearing(ABC):
    """What is heard of one robot."""

    def __init__(self, source: str, origin: Mapping[str, Any], known: Collection[str] = ()) -> None:
        """
        Args:
            source: where it is heard, for people.
            origin: the section of the agent's file for it, by its name.
            known: topics that are not listened to any more.
        """
        self.problems = Problems(source)
        self.graph = RosGraph()
        self.ears: dict[str, Ear] = {}
        self._source = source
        self.origin = origin
        self._known = frozenset(known)
        self._levels: dict[str, set[int]] = {}
        self._status_ears: dict[str, Ear] = {}
        self._status_publishers: dict[str, set[str]] = {}
        self._errors: Counter[str] = Counter()
        self._devices: dict[str, HeardDevice] = {}
        self._states: dict[str, str] = {}
        self._values: dict[str, tuple[Any, int, int]] = {}  # topic -> newest value, changes, messages
        self._seen_ns: dict[str, int] = {}  # node -> when it was seen to run first
        self._runs: Mapping[str, bool | None] = {}
        self._left = 1  # topics of the newest graph that are yet to be asked for; at first nobody knows
        self._began_s = time.monotonic()
        self._ahead_ns = time.time_ns() - time.monotonic_ns()

    @property
    def behind(self) -> int:
        """How many topics are not listened to yet: they are not silent."""
        return self._left + len(self._unheard())

    def now_ns(self) -> int:
        """Return the time by a clock that is not set while it is listened."""
        return time.monotonic_ns() + self._ahead_ns

    async def run(self) -> None:
        """Listen until cancelled."""
        await asyncio.to_thread(import_module, "rosbags.typesys")  # a third of a second
        self._began_s = time.monotonic()
        self._ahead_ns = time.time_ns() - time.monotonic_ns()
        await self._listen()

    def begin(self) -> None:
        """What came by now came while the robot was being found: only what is latched stays."""
        self._began_s = time.monotonic()
        latched = self._latched()
        for topic, ear in self.ears.items():
            if topic not in latched:
                ear.forget()

    def heard(self) -> Heard:
        """Return what was heard so far."""
        seconds = time.monotonic() - self._began_s
        latched = self._latched()
        topics = {name: ear.heard(name in latched) for name, ear in self.ears.items()}
        runs: dict[str, bool] = {}
        for name, one in self._runs.items():
            runs[lasting_name(name)] = runs.get(lasting_name(name), False) or one is not False
        known = self._seen_ns.keys() | runs.keys() if self._runs else set()
        gone = {node for node in known if not runs.get(node, False)}
        graph = self.graph.renamed()
        jump_s = (time.time_ns() - time.monotonic_ns() - self._ahead_ns) / 1e9
        remarks = [f"the clock was set by {jump_s:+.1f} s meanwhile"] if abs(jump_s) > JUMP_S else []
        alike: dict[str, list[str]] = {}
        for topic, why in sorted(self._mismatches().items()):
            alike.setdefault(why, []).append(topic.removeprefix("/"))
        for why, named in alike.items():
            remarks.append(f"{first_few(named, SHOWN)}: {why}")
        statuses = {
            name: HeardStatus(
                frozenset(levels),
                frozenset(self._status_publishers[name]),
                self._status_ears[name].heard(),
            )
            for name, levels in self._levels.items()
        }
        return Heard(
            graph,
            self._source,
            seconds,
            self.now_ns(),
            topics,
            statuses,
            {name: lasting_name(node) for name, node in self._actions().items()},
            self._lifecycle(graph),
            dict(self._errors),
            {
                topic: NOISY[self._kind(topic)]
                for topic, (_, changed, came) in self._values.items()
                if came >= LEAST_VALUES and changed == came
            },
            frozenset(gone),
            dict(self._seen_ns),
            tuple(remarks),
            {name: dict(keys) for name, keys in self.origin.items()},
            dict(self._devices),
        )

    @abstractmethod
    async def _listen(self) -> None: ...

    @abstractmethod
    def _latched(self) -> Collection[str]:
        """Return the topics whose publishers all keep the last message."""

    @abstractmethod
    def _actions(self) -> dict[str, str]:
        """Return the actions, each with the node that serves it."""

    def _unheard(self) -> Collection[str]:
        """Return the topics of which not all that there is would be heard now."""
        return ()

    def _mismatches(self) -> Mapping[str, str]:
        """Return the topics of which no message goes from a publisher to a listener, and why."""
        return {}

    # --- for those who derive from it --------------------------------------------------------------------

    async def _hear_on(
        self,
        node: Reads,
        tasks: Sequence[asyncio.Task[None]],
        look: Callable[[], Awaitable[tuple[RosGraph, Mapping[str, bool | None]] | None]],
        listen: Callable[[str], Awaitable[None]],
    ) -> None:
        """Take in what comes, and listen to topics that are new, until one of the tasks ends.

        Args:
            tasks: the node's own work; the error of one that failed is raised.
            look: returns the graph, and which nodes run; None: nobody knows now.
            listen: to a topic, with this node.
        """
        looked_s = float("-inf")
        while not any(task.done() for task in tasks):
            node.read_now()
            if time.monotonic() - looked_s >= LOOK_S:
                looked_s = time.monotonic()
                found = await look()
                new = [] if found is None else self._found(*found)
                for first in range(0, len(new), AT_ONCE):
                    self._left = len(new) - first
                    await asyncio.gather(*map(listen, new[first : first + AT_ONCE]))
                    node.read_now()
                self._left = int(found is None)
            await beat()
        for task in tasks:
            if task.done():
                task.result()

    def _found(self, graph: RosGraph, runs: Mapping[str, bool | None]) -> list[str]:
        """This is the graph now; return the topics to listen to as well."""
        self.graph = graph
        self._runs = runs
        for name, one in runs.items():
            if one:
                self._seen_ns.setdefault(lasting_name(name), self.now_ns())
        new = sorted(graph.publishers.keys() - self.ears.keys() - NOT_HEARD - self._known)
        new = new[: MOST_TOPICS - len(self.ears)]
        for topic in new:
            self.ears[topic] = Ear()
        return new

    def _looks(self, topic: str) -> bool:
        return topic.endswith(DESCRIPTION) or self._kind(topic) in (DIAGNOSTICS, TRANSITION, *LOGS, *NOISY)

    def _look(self, topic: str, node: str, time_ns: int, message: OpenedMessage) -> None:
        """Look into a message of a kind that says something of nodes."""
        kind = self._kind(topic)
        try:
            if kind == DIAGNOSTICS:
                for status in message.at("status"):
                    said = f"hardware_id of the status {str(status['name'])!r}"
                    self._device(str(status.get("hardware_id", "")), said, node)
                    self._status(str(status["name"]).removeprefix("/"), status["level"], node, time_ns)
            elif kind == TRANSITION:
                self._states[node] = str(message.at("goal_state.label"))
            elif topic.endswith(DESCRIPTION):
                for found in CONTROLLED.finditer(str(message.at("data"))):
                    plugin = PLUGIN.search(found[0])
                    of = f", {plugin[1]}" if plugin else ""
                    self._device(found[1], f"ros2_control of {topic.removeprefix('/')}{of}", "")
            elif kind in NOISY:
                value = message.at(NOISY[kind])
                before, changed, came = self._values.get(topic, (None, 0, 0))
                self._values[topic] = (value, changed + (value != before), came + 1)
            elif kind in LOGS and reaches(int(message.at("level")), "error"):
                self._errors[logged_by(str(message.at("name")))] += 1
        except (MissingField, UnreadableMessage, TypeError, ValueError, KeyError) as error:
            self.problems.tell(f"messages of {topic} by {node}", str(error))

    def _status(self, name: str, level: Any, node: str, time_ns: int) -> None:
        if name not in self._levels and len(self._levels) >= MOST_STATUSES:
            return
        self._levels.setdefault(name, set()).add(level[0] if isinstance(level, bytes) else int(level))
        self._status_ears.setdefault(name, Ear()).message(time_ns)
        if node:
            self._status_publishers.setdefault(name, set()).add(lasting_name(node))
        self._status_publishers.setdefault(name, set())

    def _device(self, name: str, source: str, node: str) -> None:
        name = name.strip()
        known = self._devices.get(name)
        if name.lower() in NO_DEVICE or (known is None and len(self._devices) >= MOST_DEVICES):
            return
        if known is None or (node and not known.node):  # whose message it is may be known later
            self._devices[name] = HeardDevice(source, lasting_name(node))

    def _kind(self, topic: str) -> str:
        return self.graph.types.get(topic, "").replace("/msg/", "/")

    def _lifecycle(self, graph: RosGraph) -> dict[str, str]:
        """Return the nodes that have a lifecycle, with their states as they were said last."""
        of_kind = [topic for topic, kind in graph.types.items() if kind == TRANSITION]
        nodes = {node for topic in of_kind for node in graph.publishers.get(topic, ())}
        states = {lasting_name(node): state for node, state in self._states.items()}
        return {node: states.get(node, "") for node in nodes}


class Ros2Hearing(Hearing):
    """A domain of ROS 2."""

    def __init__(self, domain: int, known: Collection[str] = ()) -> None:
        super().__init__(f"domain {domain} of ROS 2", {"ros2": {"domain": domain}}, known)
        self._domain = domain
        self._node: DdsNode | None = None

    async def _listen(self) -> None:
        from robomend_client.bridges.ros2.dds import Dds, configuration, only_here
        from robomend_client.bridges.ros2.liveness import Liveness
        from robomend_client.bridges.ros2.messages import MessageReaders, folders_of
        from robomend_client.bridges.ros2.node import DdsNode, Forgotten

        readers = MessageReaders(folders_of(os.environ, ()))
        config = configuration(os.environ, only_here(os.environ), ())
        while True:
            dds = await asyncio.to_thread(Dds, self._domain, config)
            node = self._node = DdsNode(NAME, self.problems)
            liveness = Liveness(node.found, self.problems, node.unheard)
            listen = partial(self._hear, node, readers)
            for topic in self.ears:
                await listen(topic)
            task = asyncio.create_task(node.run(dds))
            try:
                await self._hear_on(node, [task], partial(self._look_around, node, liveness), listen)
            except Forgotten:
                continue
            finally:
                await end([task])
                liveness.close()
                dds.close()

    @staticmethod
    async def _look_around(node: DdsNode, liveness: Any) -> tuple[RosGraph, Mapping[str, bool | None]]:
        return node.found.graph(), await liveness.look()

    async def _hear(self, node: DdsNode, readers: Any, topic: str) -> None:
        from robomend_client.bridges.ros2.names import ros_type
        from robomend_client.bridges.ros2.stamps import Ages

        ear, ages = self.ears[topic], dict[bytes, Ages]()

        def heard(writer: Endpoint, sample: Sample) -> None:
            now_ns = self.now_ns()
            time_ns = now_ns - ages.setdefault(writer.key, Ages()).age_ns(sample.time_ns, now_ns)
            ear.message(time_ns)
            if self._looks(topic):
                try:
                    message = readers.open(ros_type(writer.type), writer.type_hash, sample.data)
                except UnreadableMessage as error:
                    self.problems.tell(f"messages of {topic}", str(error))
                    return
                self._look(topic, node.found.name_of(writer), time_ns, message)

        node.subscribe(topic, heard)

    def _latched(self) -> Collection[str]:
        from robomend_client.bridges.ros2.names import wire_topic

        found = set()
        for topic in self.ears:
            writers = [] if self._node is None else self._node.found.writers(wire_topic(topic))
            if writers and all(one.durability and one.reliable for one in writers):
                found.add(topic)
        return found

    def _mismatches(self) -> Mapping[str, str]:
        return {} if self._node is None else self._node.found.mismatches()

    def _actions(self) -> dict[str, str]:
        return {name: next(iter(nodes)) for name, nodes in self.graph.actions.items() if len(nodes) == 1}


class ZenohHearing(Hearing):
    """A domain of ROS 2 over zenoh."""

    def __init__(self, domain: int, connect: str, known: Collection[str] = ()) -> None:
        """`connect`: where others are, as zenoh writes it."""
        origin = {"zenoh": {"domain": domain, "connect": [connect]}}
        super().__init__(f"domain {domain} of ROS 2 over zenoh at {connect}", origin, known)
        self._domain = domain
        self._connect = connect
        self._node: ZenohNode | None = None

    async def _listen(self) -> None:
        from robomend_client.bridges.ros2.messages import MessageReaders, folders_of
        from robomend_client.bridges.zenoh.node import Liveness, ZenohNode
        from robomend_client.bridges.zenoh.session import NoZenoh, ZenohSession

        readers = MessageReaders(folders_of(os.environ, ()))
        try:
            session = await asyncio.to_thread(ZenohSession, (self._connect,), None)
        except NoZenoh as error:
            raise ConnectionError(f"no session of zenoh can be opened: {error}") from error
        node = self._node = ZenohNode(NAME, self._domain, self._connect, self.problems)
        liveness = Liveness(node, session, SETTLED_S)
        task = asyncio.create_task(node.run(session))

        async def look() -> tuple[RosGraph, Mapping[str, bool | None]]:
            return node.graph.graph(), await liveness.look() or {}

        try:
            await self._hear_on(node, [task], look, partial(self._hear, node, readers))
        finally:
            await end([task])
            session.close()

    async def _hear(self, node: ZenohNode, readers: Any, topic: str) -> None:
        from robomend_client.bridges.ros2.names import ros_type
        from robomend_client.bridges.ros2.stamps import Ages

        ear, ages = self.ears[topic], dict[Any, Ages]()

        def heard(message: Message) -> None:
            time_ns = now_ns = self.now_ns()
            if message.stamp_ns is not None:
                time_ns -= ages.setdefault(message.writer, Ages()).age_ns(message.stamp_ns, now_ns)
            ear.message(time_ns)
            if self._looks(topic):
                try:
                    opened = readers.open(ros_type(message.wire_type), message.type_hash, message.data)
                except UnreadableMessage as error:
                    self.problems.tell(f"messages of {topic}", str(error))
                    return
                self._look(topic, message.node, time_ns, opened)

        node.subscribe(topic, heard)

    def _latched(self) -> Collection[str]:
        if self._node is None:
            return ()
        told = {topic: self._node.graph.publishers(topic) for topic in self.ears}
        return {topic for topic, tokens in told.items() if tokens and all(one.latched for one in tokens)}

    def _actions(self) -> dict[str, str]:
        return {name: next(iter(nodes)) for name, nodes in self.graph.actions.items() if len(nodes) == 1}


class Ros1Hearing(Hearing):
    """A master of ROS 1."""

    def __init__(self, uri: str, known: Collection[str] = ()) -> None:
        super().__init__(f"the master at {uri}", {"ros1": {"master": uri}}, known)
        self._uri = uri
        self._keeps: set[str] = set()  # topics of which a publisher keeps the last message,
        self._keeps_not: set[str] = set()  # or one does not
        self._node: RosNode | None = None

    async def _listen(self) -> None:
        from robomend_client.bridges.ros1.liveness import Liveness
        from robomend_client.bridges.ros1.messages import MessageReaders
        from robomend_client.bridges.ros1.node import RosNode
        from robomend_client.bridges.ros1.xmlrpc import PeerError

        own = os.environ.get("ROS_HOSTNAME") or os.environ.get("ROS_IP")
        node = self._node = RosNode(NAME, self._uri, own, self.problems, self.now_ns)
        readers, runs = MessageReaders(), dict[str, bool | None]()

        def table(found: dict[str, bool | None]) -> None:
            runs.clear()
            runs.update(found)

        async def look() -> tuple[RosGraph, Mapping[str, bool | None]] | None:
            try:
                return await node.master.graph(), dict(runs)
            except PeerError as error:
                self.problems.tell("the master", str(error))
                return None

        self.ears[ROSOUT] = Ear()
        await self._hear(node, readers, ROSOUT)  # before it is connected for the sake of who runs
        liveness = Liveness(node, table, PING_S, PING_S)
        tasks = [asyncio.create_task(node.run()), asyncio.create_task(liveness.run())]
        try:
            await self._hear_on(node, tasks, look, partial(self._hear, node, readers))
        finally:
            await end(tasks)

    async def _hear(self, node: RosNode, readers: Any, topic: str) -> None:
        from robomend_client.bridges.ros1.subscription import Publisher
        from robomend_client.bridges.ros1.xmlrpc import PeerError

        ear, looks = self.ears[topic], topic == ROSOUT or self._looks(topic)

        def heard(publisher: Publisher, body: bytes, time_ns: int) -> None:
            ear.message(time_ns)
            (self._keeps if publisher.latched else self._keeps_not).add(topic)
            if looks:
                try:
                    message = readers.open(publisher, body)
                except UnreadableMessage as error:
                    self.problems.tell(f"messages of {topic} by {publisher.node}", str(error))
                    return
                self._look(topic, publisher.node, time_ns, message)

        try:
            await node.listen(topic, heard, keep=looks)
        except PeerError as error:  # it is tried again with the next registration
            self.problems.tell("the master", str(error))

    def _latched(self) -> Collection[str]:
        return self._keeps - self._keeps_not

    def _unheard(self) -> Collection[str]:
        return () if self._node is None else self._node.connecting & self.ears.keys()

    def _mismatches(self) -> Mapping[str, str]:
        why = "no publisher was connected in all that time, so that nothing could be heard"
        return {topic: why for topic in self._unheard() if not self.ears[topic].count}

    def _actions(self) -> dict[str, str]:
        found = {}
        for topic, kind in self.graph.types.items():
            nodes = self.graph.publishers.get(topic, frozenset())
            if kind.endswith(ACTION_RESULT) and topic.endswith("/result") and len(nodes) == 1:
                found[topic.removesuffix("/result")] = next(iter(nodes))
        return found
