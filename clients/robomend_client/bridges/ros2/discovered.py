"""What DDS has discovered: participants, their nodes, who publishes and who listens. A value, no sockets.

    participant ──┬── node (ros_discovery_info) ── keys of its readers and writers
                  └── endpoints (discovery) ────── key, topic, type, quality of service

The keys are the same on both sides, so that a topic has the names of its nodes.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass

from robomend_client.bridges.ros2.cdr import Entities
from robomend_client.bridges.ros2.names import ros_service, ros_topic, ros_type
from robomend_client.ros_graph import GOALS_END, RosGraph

MOST_PARTICIPANTS = 2048
MOST_ENDPOINTS = 65536
SOMEBODY = "/unknown_node"
"""Whose endpoint it is that no node claims: DDS without ROS, or a node that has just begun."""

DURABILITY = ("volatile", "transient local", "transient", "persistent")


@dataclass(frozen=True)
class Participant:
    """One process's part in DDS, or one of its parts."""

    key: bytes
    address: str = ""  # where it takes messages: host number and port
    port: int = 0
    pid: int = 0  # as it says itself; 0: it does not
    is_ros: bool = True


@dataclass(frozen=True)
class Endpoint:
    """A reader or a writer."""

    key: bytes
    participant: bytes
    topic: str  # as on the wire
    type: str
    writes: bool
    reliable: bool = True
    durability: int = 0  # an index of DURABILITY
    deadline_ns: int | None = None
    handle: int = 0  # what samples name their writer by
    type_hash: str = ""


class Discovered:
    """All of it; who tells it what, says so in its methods' names."""

    def __init__(self, own: bytes = b"") -> None:
        """`own` is our own participant's key: what it has is nobody else's."""
        self.own = own
        self.participants: dict[bytes, Participant] = {}
        self.endpoints: dict[bytes, Endpoint] = {}
        self.entities: dict[bytes, Entities] = {}
        self.lost: dict[Participant, tuple[str, ...]] = {}  # gone, and the nodes it had not taken back
        self._silent: dict[bytes, frozenset[str]] = {}  # gone, and have not told anything since; its topics
        self.gid_size = 0  # of others' messages; 0: none came yet
        self._owners: dict[bytes, str] = {}
        self._by_handle: dict[int, Endpoint] = {}
        self._by_topic: dict[str, dict[bytes, Endpoint]] = defaultdict(dict)

    def participant(self, found: Participant) -> None:
        if len(self.participants) < MOST_PARTICIPANTS:
            self.participants[found.key] = found

    def participant_gone(self, key: bytes) -> None:
        """It said goodbye, or is not heard any more: who ends in order takes its nodes back before."""
        gone, told = self.participants.pop(key, None), self.entities.pop(key, None)
        topics = frozenset(
            one.topic for one in self.endpoints.values() if one.participant == key and one.writes
        )
        if told is None:
            return
        self._claim()
        if gone is not None and told.nodes and len(self.lost) < MOST_PARTICIPANTS > len(self._silent):
            self.lost[gone] = tuple(node.name for node in told.nodes)
            self._silent[key] = topics

    def endpoint(self, found: Endpoint) -> None:
        if len(self.endpoints) < MOST_ENDPOINTS:
            self.endpoint_gone(found.key)  # the newest comes last
            self.endpoints[found.key] = self._by_topic[found.topic][found.key] = found
            if found.writes:
                self._by_handle[found.handle] = found

    def endpoint_gone(self, key: bytes) -> None:
        found = self.endpoints.pop(key, None)
        if found is not None:
            self._by_handle.pop(found.handle, None)
            del self._by_topic[found.topic][key]
            if not self._by_topic[found.topic]:
                del self._by_topic[found.topic]

    def told(self, found: Entities) -> None:
        """A participant has told its nodes."""
        if len(self.entities) < MOST_PARTICIPANTS or found.participant in self.entities:
            self.entities[found.participant] = found
            if found.participant != self.own:
                self.gid_size = found.gid_size
            self._claim()
            self._silent.pop(found.participant, None)
            again = {node.name for node in found.nodes}
            for gone, nodes in tuple(self.lost.items()):
                left = tuple(name for name in nodes if name not in again)
                if left and gone.key != found.participant:
                    self.lost[gone] = left
                else:
                    del self.lost[gone]

    # --- what follows from it --------------------------------------------------------------------------

    def node_of(self, endpoint: Endpoint) -> str:
        """Return whose it is."""
        node = self._owners.get(endpoint.key)
        if node is None:  # a participant with one node has no doubt
            found = self.entities.get(endpoint.participant)
            node = found.nodes[0].name if found is not None and len(found.nodes) == 1 else SOMEBODY
        return node

    def is_named(self, endpoint: Endpoint) -> bool:
        """Return whether it is known whose it is, as far as it ever will be: that is told a little later."""
        participant = self.participants.get(endpoint.participant)
        nameless = participant is not None and not participant.is_ros
        return nameless or self.node_of(endpoint) != SOMEBODY

    def name_of(self, endpoint: Endpoint) -> str:
        """Return whose it is; nothing, as long as that may still be told."""
        name = self.node_of(endpoint)
        return name if name != SOMEBODY or self.is_named(endpoint) else ""

    def writer(self, handle: int) -> Endpoint | None:
        """Return the writer that a sample is of."""
        return self._by_handle.get(handle)

    def writers(self, topic: str) -> list[Endpoint]:
        """Return others' writers of a topic, the newest last."""
        return [e for e in self._of(topic) if e.writes and e.participant != self.own]

    def listened(self, topic: str) -> bool:
        """Return whether anybody else listens to a topic."""
        return any(not e.writes and e.participant != self.own for e in self._of(topic))

    @property
    def untold(self) -> bool:
        """Whether there are participants of ROS that have not told their nodes yet."""
        return any(p.is_ros and p.key not in self.entities for p in self.participants.values())

    @property
    def unknown_nodes(self) -> set[bytes]:
        """Participants that have not told their nodes."""
        return self.participants.keys() - self.entities.keys()

    @property
    def unnamed(self) -> bool:
        """Whether there are topics and services of which it may still be told whose they are."""
        return any(
            (ros_topic(one.topic) is not None or ros_service(one.topic) is not None)
            and not self.is_named(one)
            for one in self._others()
        )

    @property
    def returned(self) -> set[bytes]:
        """Participants that had gone, are heard again, and do not tell their nodes (yet)."""
        return self._silent.keys() & self.participants.keys()

    @property
    def untold_topics(self) -> set[str]:
        """Topics on the wire of which only such participants were writers."""
        topics = {topic for key in self.returned for topic in self._silent[key]}
        return {topic for topic in topics if not self.writers(topic)}

    def knows_writers_of(self, other: Discovered, topics: Iterable[str]) -> bool:
        """Return whether of these topics all writers are known here that another one knows."""
        return all(
            one.key in self.endpoints or one.participant not in other.participants
            for topic in topics
            for one in other.writers(topic)
        )

    def become(self, other: Discovered) -> None:
        """Know what another one knows, and nothing else."""
        self.__dict__.update(other.__dict__)

    def nodes(self, alive: Mapping[bytes, bool | None]) -> dict[str, bool | None]:
        """Return which nodes run; None: it is unknown. `alive` has the participants of which something is
        known that discovery does not know, or not yet.
        """
        table = {name: alive.get(gone.key) for gone, nodes in self.lost.items() for name in nodes}
        for key, found in self.entities.items():
            runs = key in self.participants and alive.get(key, True)
            for node in found.nodes:
                table[node.name] = runs or table.get(node.name, False)
        return table

    def graph(self) -> RosGraph:
        """Return it as any ROS graph."""
        publishers: dict[str, set[str]] = defaultdict(set)
        subscribers: dict[str, set[str]] = defaultdict(set)
        services: dict[str, set[str]] = defaultdict(set)
        clients: dict[str, set[str]] = defaultdict(set)
        actions: dict[str, set[str]] = defaultdict(set)
        types: dict[str, str] = {}
        for endpoint in self._others():
            node = self.node_of(endpoint)
            topic, service = ros_topic(endpoint.topic), ros_service(endpoint.topic)
            if topic is not None and endpoint.writes and topic.endswith(GOALS_END):
                actions[topic.removesuffix(GOALS_END)].add(node)
            if topic is not None and "/_action/" not in topic:
                (publishers if endpoint.writes else subscribers)[topic].add(node)
                types[topic] = ros_type(endpoint.type)
            elif service is not None:
                (clients if endpoint.writes else services)[service].add(node)
        return RosGraph(
            {name: frozenset(found) for name, found in publishers.items()},
            {name: frozenset(found) for name, found in subscribers.items()},
            {name: frozenset(found) for name, found in services.items()},
            types,
            actions={name: frozenset(found) for name, found in actions.items()},
            clients={name: frozenset(found) for name, found in clients.items()},
        )

    def mismatches(self) -> dict[str, str]:
        """Return the topics of which no message goes from a writer to a reader, and why.

        DDS does not say so to anybody: a topic is silent, and all nodes run.
        """
        found = {}
        for wire in self._by_topic:
            topic, why = ros_topic(wire), self._mismatch(wire)
            if topic and why:
                found[topic] = why
        return found

    # --- inside ----------------------------------------------------------------------------------------

    def _mismatch(self, topic: str) -> str:
        """Return who does not meet whom on a topic; of those that are alike, one stands for all."""
        sides: tuple[dict[object, Endpoint], dict[object, Endpoint]] = ({}, {})
        for one in self._of(topic):
            ours = one.participant == self.own and not one.writes  # our readers follow the writers
            if not ours and self.is_named(one):
                alike = (one.type, one.reliable, one.durability, one.deadline_ns)
                sides[0 if one.writes else 1].setdefault(alike, one)
        for writer in sides[0].values():
            for reader in sides[1].values():
                why = _why_not(writer, reader)
                if why:
                    offers, asks = f"{self.node_of(writer)} publishes {why[0]}", f"asks for {why[1]}"
                    return f"{offers}, {self.node_of(reader)} {asks}: no message goes there"
        return ""

    def _of(self, topic: str) -> Iterable[Endpoint]:
        return self._by_topic[topic].values() if topic in self._by_topic else ()

    def _others(self) -> Iterator[Endpoint]:
        return (e for e in self.endpoints.values() if e.participant != self.own)

    def _claim(self) -> None:
        self._owners = {
            key: node.name
            for found in self.entities.values()
            for node in found.nodes
            for key in (*node.readers, *node.writers)
        }


def _why_not(writer: Endpoint, reader: Endpoint) -> tuple[str, str] | None:
    """Return what is offered and what is asked for, where DDS does not bring the two together."""
    if writer.type != reader.type:
        return ros_type(writer.type), ros_type(reader.type)
    if reader.reliable and not writer.reliable:
        return "best effort", "reliable"
    if reader.durability > writer.durability:
        return DURABILITY[writer.durability], DURABILITY[reader.durability]
    offered, asked = writer.deadline_ns, reader.deadline_ns
    if asked is not None and (offered is None or offered > asked):
        shown = "no deadline" if offered is None else f"a deadline of {offered / 1e9:g} s"
        return shown, f"one of {asked / 1e9:g} s"
    return None
