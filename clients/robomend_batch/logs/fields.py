"""Fields of recorded messages: unpacked by themselves where their types allow it, else from the whole."""

from __future__ import annotations

from typing import Any

from robomend_batch.logs.mcap_chunk import unpacked
from robomend_client.bridges.fields import value_at
from robomend_client.bridges.unpacking import HEADERS, Extract, Fields, unpacker

ZSTD = b"\x28\xb5\x2f\xfd"
"""How a message begins that rosbag2 has packed by itself (`compression_mode: MESSAGE`)."""


def plain_cdr(data: bytes) -> bytes:
    """Return a message as CDR, unpacked if it is packed; ValueError if it is in another encoding."""
    if data[:4] == ZSTD:
        data = unpacked("zstd", data)
    if data[:2] not in HEADERS:
        raise ValueError("it is no plain CDR")
    return data


def compile_field(
    fields: Fields, type_name: str, path: str, *, cdr: bool, whole: Extract, exact: bool = True
) -> Extract:
    """Return a function from a message's bytes to a field of it.

    Args:
        fields: of the typestore.
        type_name: of the message.
        path: see paths.py, e.g. `twist.twist.linear.x`, `ranges[-1]`.
        cdr: ROS 2's encoding, else ROS 1's.
        whole: makes the whole message, for what cannot be skipped.
        exact: refuse messages that are longer or shorter than their type.

    Raises:
        NoField: the type has no such field.
    """
    alone = unpacker(fields, type_name, path, cdr=cdr, exact=exact, plain=plain_cdr if cdr else None)
    return alone or (lambda data: value_at(whole(data), path))


def plain(value: Any) -> Any:
    """Return a message as mappings and lists, as observers take it from the bus."""
    if hasattr(value, "__dataclass_fields__"):
        return {name: plain(getattr(value, name)) for name in value.__dataclass_fields__ if name[0] != "_"}
    if isinstance(value, list):
        return [plain(one) for one in value]
    return value.tolist() if hasattr(value, "tolist") else value
