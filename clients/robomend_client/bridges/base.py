"""What the bridges to ROS have in common: their keys in the agent's file, and their place in the agent."""

from __future__ import annotations

import re
import time
from abc import ABC, abstractmethod
from collections.abc import Collection, Iterable, Mapping, Sequence
from typing import Protocol

from robomend_client.agent.feeds import AgentParts, Deliver
from robomend_client.agent.ring import Describe, Tap
from robomend_client.beats import beat
from robomend_client.bridges.listening import Listening
from robomend_client.bridges.names import Names, resolved
from robomend_client.bridges.problems import Problems
from robomend_client.bridges.telling import Telling, ToldTopic
from robomend_client.observers import Change, Contact, Publishers
from robomend_client.ros_graph import lasting_name
from robomend_client.yaml_reader import Section

NODES, DIAGNOSTICS = "nodes", "diagnostics"
"""Sources that are more than a topic's messages or a field of them."""

ALL_DIAGNOSTICS = "/diagnostics"
"""In any namespace: the aggregator knows none. Drivers may have it remapped into theirs."""

GLOBAL = ("rosout",)
"""Topics that are the same in any namespace."""

NAME = re.compile(r"/?[A-Za-z][A-Za-z0-9_/]*\Z")

NODE_NAME = re.compile(r"(/[A-Za-z_][A-Za-z0-9_]*)+\Z")
"""What ROS allows; who speaks the protocol by itself may call itself anything."""

MOST_NAMES = 4096


PUBLISHERS_S = 1.0
"""How often it is looked who publishes a topic."""


Runs = bool | Mapping[str, str] | None
"""Whether a node runs, or why not (as the node observer takes it); None: that is unknown."""


class RosPart(Protocol):
    """Our node on the robot's network."""

    @property
    def unseen(self) -> Collection[str]:
        """Topics of which nothing would be heard now if there were something."""
        ...

    def read_now(self) -> None:
        """Hand on what has come by now."""

    def publishers(self, topic: str) -> tuple[str, ...]:
        """Return the nodes that publish a topic, once for each publisher."""
        ...


class RosBridge(ABC):
    """A node of the robot, which the agent is."""

    def __init__(self, section: Section, where: str, tells: Collection[str]) -> None:
        """`where` is what the bridge leads to, for the log; `tells` is all that it can tell the robot."""
        section.explain(
            name="this node's name on the robot; by default robomend_AGENT",
            namespace="where the model's names are: `scan` is `/robot1/scan` in `/robot1`",
            names="names of the model that ROS calls something else: {hokuyo_node: /sensors/laser}",
            publish=f"what the robot is told: a list of {', '.join(tells)}; by default all, [] for nothing",
            hear_observations="whether what other nodes say on /observations goes to the service",
            observations_s="how long such a sentence holds that nobody repeats, in seconds",
            ignore="nodes whose sentences are not heard, names or patterns; agents of robomend never are",
        )
        self.name = section.optional("name")
        if self.name is not None and not NAME.match(self.name):
            raise section.error("name", f"must be of letters, digits, _ and /, not {self.name!r}")
        self.names = Names(section.text("namespace", "/"), section.section("names").words())
        given = section.texts("publish")
        self.publishes = given if "publish" in section else tuple(tells)
        for topic in self.publishes:
            if topic not in tells:
                raise section.error("publish", f"must be of {', '.join(tells)}, not {topic!r}")
        self.hears = section.flag("hear_observations", True)
        self.lifetime_s = section.number("observations_s", 10.0, least=0.5, most=86400)
        self.ignored = (*section.texts("ignore"), "/robomend*")
        self.problems = Problems(where)
        self._parts: AgentParts | None = None
        self._telling: Telling | None = None
        self._names_seen: set[str] = set()
        self._topics: dict[str, list[tuple[str, str]]] = {}  # topic -> sources, each with its field
        self._unseen: frozenset[str] = frozenset()  # topics at which the bridge does not look now
        self._deliver: Deliver | None = None  # while it runs
        self._publishers: dict[str, tuple[str, ...]] = {}  # topic -> its publishers, as they were told last
        self._publishers_s = float("-inf")

    def attach(self, parts: AgentParts) -> None:
        """Be a part of this agent; without one, the bridge only feeds observers."""
        self._parts = parts

    def changed(self, changes: Sequence[Change]) -> None:
        """Tell the robot what the agent's observers have found."""
        if self._telling is not None:
            self._telling.changed(changes)

    @abstractmethod
    def read_now(self) -> None:
        """Deliver what has come by now; an agent asks for it each beat, and before it judges."""

    def look(self, node: RosPart) -> None:
        """Deliver what the node has heard, and before and after it, what is not looked at and is again; now
        and then, who publishes what.
        """
        now = frozenset(node.unseen)
        for topic in now - self._unseen:
            self._tell_sight(topic, Contact.LOST)
        node.read_now()
        for topic in self._unseen - now:
            self._tell_sight(topic, Contact.BACK)
        self._unseen = now
        if time.monotonic() - self._publishers_s >= PUBLISHERS_S:
            self._publishers_s = time.monotonic()
            for topic in self._topics.keys() - now:
                self._tell_publishers(topic, node.publishers(topic))

    def _tell_publishers(self, topic: str, nodes: tuple[str, ...]) -> None:
        """Deliver who publishes a topic, when it has changed."""
        if self._deliver is not None and self._publishers.get(topic) != nodes:
            self._publishers[topic] = nodes
            for source, _ in self._topics[topic]:
                self._deliver(source, Publishers(nodes), None)

    def topic_of(self, name: str) -> str:
        """Return what ROS calls the topic of a source."""
        return f"/{name}" if name in GLOBAL else self.names.ros(name)

    def _tell_sight(self, topic: str, sight: Contact) -> None:
        if self._deliver is not None:
            for source, _ in self._topics.get(topic, ()):
                self._deliver(source, sight, None)

    def _tap(self, describe: Describe) -> Tap | None:
        """Return what each message is handed to, if somebody keeps some."""
        if self._parts is None or self._parts.tap is None:
            return None
        return self._parts.tap(describe)

    # --- for those who derive from it --------------------------------------------------------------------

    async def read_on(self) -> None:
        """Read each beat, where no agent asks for it."""
        while True:
            self.read_now()
            await beat()

    @property
    def node_name(self) -> str:
        """Our own node's, with its slash."""
        agent = "" if self._parts is None else "_" + re.sub(r"[^A-Za-z0-9_]", "_", self._parts.agent)
        return resolved(self.name or f"robomend{agent}")

    def table(self, found: Mapping[str, Runs]) -> dict[str, Runs]:
        """Return which nodes run by the model's names; one whose name is another at each start also by what
        stays of it.
        """
        told = {self.names.ours(name): runs for name, runs in found.items()}
        for name, runs in found.items():
            lasting = self.names.ours(lasting_name(name))
            if lasting_name(name) != name and told.get(lasting) is not True:
                told[lasting] = runs
        return told

    def look_at_names(self, nodes: Iterable[str]) -> None:
        """Tell of nodes whose names are none; they are watched all the same."""
        for name in set(nodes) - self._names_seen:
            if len(self._names_seen) < MOST_NAMES:
                self._names_seen.add(name)
                if not NODE_NAME.match(name):
                    self.problems.tell(f"the node {name!r}"[:200], "ROS allows no such name; taken as it is")

    def hear_diagnostics(self) -> None:
        """Have diagnostics heard where drivers publish them, and where they were remapped to."""
        for topic in {ALL_DIAGNOSTICS, self.names.ros(DIAGNOSTICS)}:
            self._topics.setdefault(topic, []).append((DIAGNOSTICS, "status"))

    def told_topic(self, what: str) -> str:
        """Return the topic on which something is told."""
        return ALL_DIAGNOSTICS if what == DIAGNOSTICS else self.names.ros(what)

    def tell_by(self, parts: AgentParts, topics: Mapping[str, ToldTopic]) -> Telling:
        """Tell the robot on these topics from now on; the caller runs what is returned."""
        self._telling = Telling(parts, self.problems, topics)
        return self._telling

    def listening(self, parts: AgentParts, folder: str) -> Listening:
        """Return what takes in the sentences of others; the caller runs it."""
        return Listening(parts, self.names, self.problems, self.lifetime_s, self.ignored, folder)
