"""Fields of recorded messages: unpacked by themselves where their types allow it, else from the whole."""

from __future__ import annotations

from typing import Any

from robomend_client.bridges.unpacking import Extract, Fields, unpacker


def compile_field(fields: Fields, type_name: str, path: str, *, cdr: bool, whole: Extract) -> Extract:
    """Return a function from a message's bytes to a field of it.

    Args:
        fields: of the typestore.
        type_name: of the message.
        path: dotted, e.g. `twist.twist.linear.x`; a number is a place in an array or sequence.
        cdr: ROS 2's encoding, else ROS 1's.
        whole: makes the whole message, for what cannot be skipped.

    Raises:
        NoField: the type has no such field.
    """
    alone = unpacker(fields, type_name, path, cdr=cdr)
    return alone or (lambda data: value_at(whole(data), path))


def value_at(message: Any, path: str) -> Any:
    """Return a field of a whole message; None if a sequence is too short."""
    for name in path.split("."):
        if name.isdecimal():
            if int(name) >= len(message):
                return None
            message = message[int(name)]
        else:
            message = getattr(message, name)
    return message.item() if hasattr(message, "item") else message


def plain(value: Any) -> Any:
    """Return a message as mappings and lists, as observers take it from the bus."""
    if hasattr(value, "__dataclass_fields__"):
        return {name: plain(getattr(value, name)) for name in value.__dataclass_fields__ if name[0] != "_"}
    if isinstance(value, list):
        return [plain(one) for one in value]
    return value.tolist() if hasattr(value, "tolist") else value
