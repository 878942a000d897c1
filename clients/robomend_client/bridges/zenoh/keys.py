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
from dataclasses import dataclass

import xxhash

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
