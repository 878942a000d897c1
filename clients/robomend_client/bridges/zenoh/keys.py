"""What rmw_zenoh writes into zenoh's keys, and what it attaches to messages.

    message   DOMAIN/TOPIC/TYPE/HASH
    node      @ros2_lv/DOMAIN/SESSION/NODE/ENTITY/NN/ENCLAVE/NAMESPACE/NAME
    others    @ros2_lv/DOMAIN/SESSION/NODE/ENTITY/KIND/ENCLAVE/NAMESPACE/NAME/TOPIC/TYPE/HASH/QOS
              MP publisher, MS subscriber, SS server, SC client

A key with @ros2_lv is a liveliness token: it is there as long as its node is. In it `/` inside a name is `%`;
a topic of a message's key keeps its slashes. Quality of service is a list of numbers, of which what is left
out is the default: RELIABILITY:DURABILITY:HISTORY,DEPTH:….

A message's attachment has its number, its time and its publisher (the hash of the publisher's token), in one
of three forms: since April 2025 the bare values, with or without the last one's length; before that, with a
name before each.

Source: rmw_zenoh, docs/design.md; the attachment by what its releases send.
"""

from __future__ import annotations

import struct
from collections import defaultdict
from collections.abc import Collection, Iterator
from dataclasses import dataclass

import xxhash

from robomend_client.bridges.ros2.names import ros_type
from robomend_client.ros_graph import GOALS_END, RosGraph

TOKENS = "@ros2_lv"
NODE, PUBLISHER, SUBSCRIBER, SERVER, CLIENT = "NN", "MP", "MS", "SS", "SC"
KINDS = (NODE, PUBLISHER, SUBSCRIBER, SERVER, CLIENT)
NODE_PARTS, TOPIC_PARTS = 9, 13
NO_HASH = "TypeHashNotSupported"
"""What releases up to Humble have in the place of the hash."""

LATCHED = "1"
"""Durability: transient local."""

GID = 16
GIDS = (16, 24)  # up to Humble 24
STAMPED = struct.Struct("<qq")
LONGEST_KEY = 4096


class BadKey(ValueError):
    """It is no key of rmw_zenoh."""


@dataclass(frozen=True)
class LivelinessToken:
    """A node, or something that a node has."""

    domain: int
    session: str
    kind: str
    node: str  # whole: /sensors/laser
    topic: str = ""  # or service, whole
    type: str = ""
    type_hash: str = ""  # nothing: it tells none
    latched: bool = False
    node_id: str = "0"
    entity_id: str = "0"


def parse_token(key: str) -> LivelinessToken:
    """Return what a token says.

    Raises:
        BadKey: it is none.
    """
    parts = key.split("/")
    if len(key) > LONGEST_KEY or len(parts) < NODE_PARTS or parts[0] != TOKENS or not all(parts):
        raise BadKey(f"{key[:200]!r} is no token")
    kind = parts[5]
    if kind not in KINDS or not parts[1].isdecimal() or len(parts[1]) > 3:
        raise BadKey(f"{key[:200]!r} is no token of a node, a publisher or a subscriber")
    node = f"{_name(parts[7]).rstrip('/')}/{_name(parts[8]).strip('/')}"
    node = "/" + node.lstrip("/")
    if kind == NODE:
        return LivelinessToken(int(parts[1]), parts[2], kind, node, node_id=parts[3], entity_id=parts[4])
    if len(parts) < TOPIC_PARTS:
        raise BadKey(f"{key[:200]!r} does not say which topic")
    quality = parts[12].split(":")
    return LivelinessToken(
        int(parts[1]),
        parts[2],
        kind,
        node,
        "/" + _name(parts[9]).strip("/"),
        _name(parts[10]),
        _hash(parts[11]),
        len(quality) > 1 and quality[1] == LATCHED,
        parts[3],
        parts[4],
    )


def token_key(token: LivelinessToken) -> str:
    """Return the key of a token; its enclave is none, its quality of service the default."""
    namespace, _, name = token.node.rpartition("/")
    parts = [TOKENS, str(token.domain), token.session, token.node_id, token.entity_id, token.kind, "%"]
    parts += [namespace.replace("/", "%") or "%", name]
    if token.kind != NODE:
        parts += [token.topic.replace("/", "%"), token.type, token.type_hash or NO_HASH, "::,10:,:,:,,"]
    return "/".join(parts)


def _name(part: str) -> str:
    return part.replace("%", "/")


def _hash(part: str) -> str:
    return "" if part == NO_HASH else part


# --- messages --------------------------------------------------------------------------------------------


def message_key(domain: int, topic: str, kind: str, type_hash: str) -> str:
    """Return where messages go; `*` as type and hash stands for any."""
    return f"{domain}/{topic.strip('/')}/{kind}/{type_hash or NO_HASH}"


def type_of(key: str) -> tuple[str, str]:
    """Return type and hash of a message by its key.

    Raises:
        BadKey: there are none in it.
    """
    parts = key.rsplit("/", 2)
    if len(parts) != 3:
        raise BadKey(f"{key[:200]!r} has no type")
    return parts[1], _hash(parts[2])


def gid(token: str) -> bytes:
    """Return what stands for the one who has this token."""
    return xxhash.xxh3_128(token.encode()).intdigest().to_bytes(GID, "little")


@dataclass(frozen=True)
class Attachment:
    """What comes with a message."""

    number: int
    stamp_ns: int
    gid: bytes = b""  # of its publisher; nothing: it does not say


def attach(attachment: Attachment) -> bytes:
    """Return the bytes that say so."""
    told = STAMPED.pack(attachment.number, attachment.stamp_ns)
    return told + bytes([len(attachment.gid)]) + attachment.gid


def read_attachment(data: bytes) -> Attachment | None:
    """Return what is attached; None if it is nothing that is known here."""
    if (place := data.find(b"source_timestamp")) >= 0:
        return _named(data, place)
    if len(data) < STAMPED.size:
        return None
    number, stamp_ns = STAMPED.unpack_from(data)
    rest = data[STAMPED.size :]
    if rest and rest[0] == len(rest) - 1 and rest[0] in GIDS:
        rest = rest[1:]
    return Attachment(number, stamp_ns, rest) if len(rest) in (0, *GIDS) else None


def _named(data: bytes, place: int) -> Attachment | None:
    """Read the form with names: each a length and its letters; the publisher's hash is backwards."""
    stamp = data[place + len(b"source_timestamp") :][:8]
    if len(stamp) < 8:
        return None
    name = data.find(b"source_gid")
    found = data[name + len(b"source_gid") + 1 :] if name >= 0 else b""
    return Attachment(0, int.from_bytes(stamp, "little", signed=True), found[::-1][-GID:])


# --- who is there, by the tokens: nodes, what they publish and what they listen to. A value, no sockets.

MOST_TOKENS = 65536
MOST_NODES = 4096
SOMEBODY = "/unknown_node"
"""Who publishes without a token."""


class Graph:
    """All tokens of a domain that are there, and the nodes that were."""

    def __init__(self) -> None:
        self.own = ""  # our session: what it has is nobody else's
        self._tokens: dict[str, LivelinessToken] = {}
        self._by_gid: dict[bytes, LivelinessToken] = {}
        self._by_topic: dict[str, dict[str, LivelinessToken]] = defaultdict(dict)
        self._ever: dict[str, str] = {}  # node -> its session, the last one

    def add(self, key: str) -> None:
        """Somebody has come.

        Raises:
            BadKey: it is no token of rmw_zenoh.
        """
        token = parse_token(key)
        if len(self._tokens) >= MOST_TOKENS:
            raise BadKey(f"there are more than {MOST_TOKENS} tokens")
        self._tokens[key] = token
        if token.kind == NODE:
            if len(self._ever) < MOST_NODES or token.node in self._ever:
                self._ever[token.node] = token.session
        else:
            self._by_topic[token.topic].pop(key, None)  # the newest comes last
            self._by_topic[token.topic][key] = token
            self._by_gid[gid(key)] = token

    def remove(self, key: str) -> None:
        """Somebody has gone."""
        token = self._tokens.pop(key, None)
        if token is not None and token.kind != NODE:
            self._by_gid.pop(gid(key), None)
            self._by_topic[token.topic].pop(key, None)
            if not self._by_topic[token.topic]:
                del self._by_topic[token.topic]

    # --- what follows from it --------------------------------------------------------------------------

    def publishers(self, topic: str) -> list[LivelinessToken]:
        """Return others' publishers of a topic, the newest last."""
        return [token for token in self._others(topic) if token.kind == PUBLISHER]

    def subscribers(self, topic: str) -> list[LivelinessToken]:
        """Return who else listens to a topic."""
        return [token for token in self._others(topic) if token.kind == SUBSCRIBER]

    def publisher(self, gid: bytes, topic: str, kind: str) -> str:
        """Return the name of the node that has published a message of this type."""
        if (token := self._by_gid.get(gid)) is not None:
            return token.node
        may_be = {token.node for token in self.publishers(topic) if token.type == kind}
        return may_be.pop() if len(may_be) == 1 else SOMEBODY

    def sessions(self) -> set[str]:
        """Return the sessions that have nodes, but for our own."""
        return {t.session for t in self._tokens.values() if t.kind == NODE} - {self.own}

    def session_of(self, node: str) -> str:
        """Return the session that a node has, or had."""
        return self._ever.get(node, "")

    def nodes(self, stopped: Collection[str] = ()) -> dict[str, bool]:
        """Return which of all nodes that ever were run; those of `stopped` sessions do not."""
        table = dict.fromkeys(self._ever, False)
        for token in self._tokens.values():
            if token.kind == NODE and token.session not in stopped:
                table[token.node] = True
        return table

    def graph(self) -> RosGraph:
        """Return it as any ROS graph."""
        kinds = (PUBLISHER, SUBSCRIBER, SERVER, CLIENT)
        tables: dict[str, dict[str, set[str]]] = {kind: defaultdict(set) for kind in kinds}
        types: dict[str, str] = {}
        actions: dict[str, set[str]] = defaultdict(set)
        for token in self._tokens.values():
            if token.kind == PUBLISHER and token.session != self.own and token.topic.endswith(GOALS_END):
                actions[token.topic.removesuffix(GOALS_END)].add(token.node)
            if token.kind in tables and token.session != self.own and "/_action/" not in token.topic:
                tables[token.kind][token.topic].add(token.node)
                if token.kind in (PUBLISHER, SUBSCRIBER):
                    types[token.topic] = ros_type(token.type)
        publishers, subscribers, services, clients = (
            {name: frozenset(found) for name, found in table.items()} for table in tables.values()
        )
        served = {name: frozenset(found) for name, found in actions.items()}
        return RosGraph(publishers, subscribers, services, types, actions=served, clients=clients)

    def mismatches(self) -> dict[str, str]:
        """Return the topics of which no message goes from a publisher to a subscriber, and why.

        To zenoh any quality of service will do; but messages of another type, or of the same one with
        another definition, have another key.
        """
        found = {}
        for topic in self._by_topic:
            for publisher in self.publishers(topic):
                for subscriber in self.subscribers(topic):
                    if why := _why_not(publisher, subscriber):
                        found[topic] = why
        return found

    def _others(self, topic: str) -> Iterator[LivelinessToken]:
        return (t for t in self._by_topic.get(topic, {}).values() if t.session != self.own)


def _why_not(publisher: LivelinessToken, subscriber: LivelinessToken) -> str:
    if publisher.type != subscriber.type:
        told, wanted = ros_type(publisher.type), ros_type(subscriber.type)
    elif publisher.type_hash != subscriber.type_hash:
        told = wanted = f"{ros_type(publisher.type)} of another definition"
    else:
        return ""
    return f"{publisher.node} publishes {told}, {subscriber.node} asks for {wanted}: no message goes there"
