"""A node as rmw_cyclonedds of Humble has it, played by the wheel of Cyclone DDS; as ros2_node.py.

    {"do": "publish", "topic": "/scan", "data": "x", "rate": 10}    a std_msgs/String

Its types are written down here and not taken from our code: it is the other side. Up to Humble, ids of
participants have 24 bytes, and nobody tells the hash of a type.
"""

from __future__ import annotations

import json
import sys
import threading
from dataclasses import dataclass
from types import new_class
from typing import Any

import cyclonedds.idl.types
from cyclonedds.core import Policy, Qos
from cyclonedds.domain import DomainParticipant
from cyclonedds.idl import IdlStruct
from cyclonedds.idl.annotations import final
from cyclonedds.pub import DataWriter
from cyclonedds.topic import Topic
from cyclonedds.util import duration

types: Any = cyclonedds.idl.types  # mypy does not know that these are generic


def struct(name: str, **members: Any) -> Any:
    """Return the class of a message."""
    body = {"__annotations__": members, "__module__": __name__}
    made: Any = new_class(name, (IdlStruct,), {"typename": name}, lambda namespace: namespace.update(body))
    return final(dataclass(made))


String = struct("std_msgs.msg.dds_.String_", data=str)
Gid = struct("rmw_dds_common.msg.dds_.Gid_", data=types.array[types.uint8, 24])
NodeInfo = struct(
    "rmw_dds_common.msg.dds_.NodeEntitiesInfo_",
    node_namespace=str,
    node_name=str,
    reader_gid_seq=types.sequence[Gid],
    writer_gid_seq=types.sequence[Gid],
)
ParticipantInfo = struct(
    "rmw_dds_common.msg.dds_.ParticipantEntitiesInfo_",
    gid=Gid,
    node_entities_info_seq=types.sequence[NodeInfo],
)

RELIABLE = Policy.Reliability.Reliable(duration(milliseconds=100))
LATCHED = Qos(RELIABLE, Policy.Durability.TransientLocal, Policy.History.KeepLast(1))
ORDINARY = Qos(RELIABLE, Policy.Durability.Volatile, Policy.History.KeepLast(10))


def gid(entity: Any) -> Any:
    return Gid(data=list(entity.guid.bytes.ljust(24, b"\0")))


class Commands:
    def __init__(self, domain: int, name: str) -> None:
        self.name = name
        self.domain = domain
        self.kept: list[Any] = []
        self.participant = DomainParticipant(domain, qos=Qos(Policy.Userdata(b"enclave=/;")))
        topic: Any = Topic(self.participant, "ros_discovery_info", ParticipantInfo)
        self.graph = DataWriter(self.participant, topic, qos=LATCHED)
        self.writers: list[Any] = []
        self.tell()

    def tell(self) -> None:
        """Say which node this is, and what it has."""
        node = NodeInfo("/", self.name, [], [gid(writer) for writer in self.writers])
        self.graph.write(ParticipantInfo(gid(self.participant), [node]))

    def nothing(self, line: dict[str, Any]) -> None:
        pass

    def garbage(self, line: dict[str, Any]) -> None:
        """Say something on the graph's topic that is no graph."""
        other: Any = struct("rmw_dds_common.msg.dds_.ParticipantEntitiesInfo_", what=str)
        participant = DomainParticipant(self.domain, qos=Qos(Policy.Userdata(b"enclave=/;")))
        topic: Any = Topic(participant, "ros_discovery_info", other)
        writer: Any = DataWriter(participant, topic, qos=LATCHED)
        self.kept.append((participant, writer))
        for number in range(3):
            writer.write(other(what=f"no graph {number}"))

    def publish(self, line: dict[str, Any]) -> None:
        topic: Any = Topic(self.participant, "rt" + line["topic"], String)
        writer: Any = DataWriter(self.participant, topic, qos=ORDINARY)
        self.writers.append(writer)
        self.tell()
        stop = threading.Event()

        def talk() -> None:
            while not stop.wait(1 / line["rate"]):
                writer.write(String(line["data"]))

        threading.Thread(target=talk, daemon=True).start()


def main() -> None:
    commands = Commands(int(sys.argv[1]), sys.argv[2])
    for text in sys.stdin:
        line = json.loads(text)
        getattr(commands, line["do"])(line)
        sys.stdout.write('{"answer": null}\n')
        sys.stdout.flush()


if __name__ == "__main__":
    main()
