"""A topic that comes in, and one that goes out."""

from __future__ import annotations

import time

from robomend_client.bridges.problems import Complaint, Problems
from robomend_client.bridges.ros2.base import Message, OnMessage
from robomend_client.bridges.ros2.formats import DIAGNOSTICS, STRING
from robomend_client.bridges.ros2.names import ros_type, wire_type
from robomend_client.bridges.zenoh.graph import Graph
from robomend_client.bridges.zenoh.keys import (
    PUBLISHER,
    Attachment,
    LivelinessToken,
    attach,
    gid,
    message_key,
    read_attachment,
    token_key,
    type_of,
)
from robomend_client.bridges.zenoh.session import KeyReader, KeyWriter, ZenohSession

DEPTH = 100
"""Messages of one topic that may come between two looks: 1 kHz, and twice that."""

HASHES = {
    STRING: "RIHS01_df668c740482bbd48fb39d76a70dfd4bd59db1288021743503259e948f6b1a18",
    DIAGNOSTICS: "RIHS01_5a8a36efb05fb25070fa0fb3810290c0e6cd4862b54a8fb975a1ee8dc55a333e",
}
"""Of the types that we publish: their definitions have not changed since there are hashes."""


class ZenohTopic:
    """One topic, of whatever type: it is in the message's key."""

    def __init__(self, domain: int, topic: str, on_message: OnMessage, problems: Problems) -> None:
        self.topic = topic
        self._key = message_key(domain, topic, "*", "*")
        self._on_message = [on_message]
        self._problems = problems
        self._reader: KeyReader | None = None
        self._latched = False
        self._type = ""

    def add(self, on_message: OnMessage) -> None:
        """Somebody else wants the topic, too."""
        self._on_message.append(on_message)

    def follow(self, session: ZenohSession, graph: Graph) -> None:
        """Listen as its publishers speak now: from the start, where all of them are latched."""
        publishers = graph.publishers(self.topic)
        latched = bool(publishers) and all(publisher.latched for publisher in publishers)
        if self._reader is None or latched != self._latched:
            self.close()
            self._latched = latched
            self._reader = session.reader(self._key, DEPTH, latched)
        if publishers and publishers[-1].type != self._type:
            kind, before = ros_type(publishers[-1].type), ros_type(self._type)
            if self._type:
                what = f"{publishers[-1].node} publishes {kind}"
                self._problems.tell(self.topic, f"{what}, where {before} came before")
            self._type = publishers[-1].type

    def take(self, graph: Graph) -> bool:
        """Hand on what has come in; return whether anything had."""
        if self._reader is None:
            return False
        came = False
        for sample in self._reader.take():
            kind, type_hash = type_of(sample.key)
            about = read_attachment(sample.attachment)
            writer = about.gid if about is not None else b""
            node = graph.publisher(writer, self.topic, kind)
            stamp_ns = None if about is None else about.stamp_ns
            if about is None and sample.attachment:
                place = f"what {node} attaches to messages of {self.topic}"
                size = f"{len(sample.attachment)} bytes"
                self._problems.tell(place, Complaint("not understood, timed by its arrival", size))
            message = Message(sample.data, kind, type_hash, writer or node, node, stamp_ns, self._latched)
            came = True
            for on_message in self._on_message:
                on_message(message)
        return came

    def close(self) -> None:
        if self._reader is not None:
            self._reader.close()
            self._reader = None


class OfferedTopic:
    """A topic that we publish, under the key of each hash that somebody listens for.

    Robots up to Humble know no hashes; their subscribers have a key of their own.
    """

    def __init__(self, domain: int, topic: str, kind: str, graph: Graph) -> None:
        self.topic = topic
        self._domain = domain
        self._kind = wire_type(kind)
        self._hashes = (HASHES[kind], "")
        self._graph = graph
        self._session: ZenohSession | None = None
        self._writers: dict[str, KeyWriter] = {}
        self._gid = b""
        self._number = 0

    def open(self, session: ZenohSession, node: LivelinessToken, entity_id: int) -> None:
        """Say that we publish it."""
        topic = (self.topic, self._kind, self._hashes[0])
        whole = LivelinessToken(
            node.domain, node.session, PUBLISHER, node.node, *topic, entity_id=str(entity_id)
        )
        key = token_key(whole)
        session.token(key)
        self._gid = gid(key)
        self._session = session

    @property
    def wanted(self) -> bool:
        """Whether anybody else listens."""
        return bool(self._listened())

    def publish(self, message: bytes) -> None:
        if self._session is None:
            return
        self._number += 1
        about = attach(Attachment(self._number, time.time_ns(), self._gid))
        for type_hash in self._listened():
            if type_hash not in self._writers:
                key = message_key(self._domain, self.topic, self._kind, type_hash)
                self._writers[type_hash] = self._session.writer(key)
            self._writers[type_hash].write(message, about)

    def close(self) -> None:
        self._session = None
        self._writers.clear()

    def _listened(self) -> set[str]:
        listeners = self._graph.subscribers(self.topic)
        return {
            listener.type_hash
            for listener in listeners
            if listener.type == self._kind and listener.type_hash in self._hashes
        }
