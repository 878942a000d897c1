"""One field of a recorded message, without making the message: what is before it is skipped.

    header {stamp, frame_id}   string: skipped by its length
    orientation …              numbers: skipped at once
    angular_velocity.z         unpacked

A path is compiled once for a type, into steps. Numbers behind one another are one step; alignment (CDR aligns
numbers to their size, ROS 1 does not) is worked out beforehand where it can be. A path through sequences of
messages is left to rosbags, which makes the whole message.
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Mapping
from typing import Any

from rosbags.interfaces import Nodetype

Extract = Callable[[bytes], Any]

Fields = Mapping[str, Any]
"""A typestore's fielddefs: type -> (constants, [(name, description)])."""

FORMATS = {
    "bool": "?", "byte": "B", "char": "B", "int8": "b", "uint8": "B", "int16": "h", "uint16": "H",
    "int32": "i", "uint32": "I", "int64": "q", "uint64": "Q", "float32": "f", "float64": "d",
}  # fmt: skip

MOST_DEPTH = 20

EMPTY = "structure_needs_at_least_one_member"
"""The field of messages that have none: a byte of CDR, and nothing in ROS 1."""


class NoField(ValueError):
    """A type has no such field, or it is no single value."""


class _NeedsAll(Exception):
    """What is before the field cannot be skipped."""


class _Steps:
    """What is to be skipped, as (alignment, size) of numbers, or of sequences of them."""

    def __init__(self, fields: Fields, cdr: bool) -> None:
        self.fields = fields
        self.cdr = cdr
        self.done: list[tuple[str, int, int]] = []

    def skip(self, description: Any, depth: int = 0) -> None:
        kind, detail = description
        if depth > MOST_DEPTH:
            raise _NeedsAll
        if kind == Nodetype.BASE:
            self._base(detail[0], 1)
        elif kind == Nodetype.NAME:
            for name, inner in self.fields[detail][1]:
                if name != EMPTY or self.cdr:
                    self.skip(inner, depth + 1)
        elif kind == Nodetype.ARRAY:
            (inner_kind, inner), count = detail
            if inner_kind == Nodetype.BASE:
                self._base(inner[0], count)
            else:
                for _ in range(min(count, 1000)):
                    self.skip((inner_kind, inner), depth + 1)
                if count > 1000:
                    raise _NeedsAll
        else:
            (inner_kind, inner), _ = detail
            if inner_kind != Nodetype.BASE or inner[0] == "string":
                raise _NeedsAll
            size = struct.calcsize(FORMATS[inner[0]])
            self.done.append(("sequence", size, size))

    def _base(self, name: str, count: int) -> None:
        if name == "string":
            self.done.extend([("string", 4, 0)] * count)
            return
        size = struct.calcsize(FORMATS[name]) if name in FORMATS else 0
        if not size:
            raise _NeedsAll
        self.done.append(("numbers", size, size * count))


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
    check_path(fields, type_name, path)
    steps = _Steps(fields, cdr)
    try:
        last = _walk(steps, type_name, path.split("."))
    except _NeedsAll:
        return lambda data: value_at(whole(data), path)
    return _reader(steps.done, last, cdr)


def _walk(steps: _Steps, type_name: str, path: list[str]) -> str:
    """Note what is before a field; return the type of the field."""
    for number, name in enumerate(path):
        for field, description in steps.fields[type_name][1]:
            if field == name:
                break
            steps.skip(description)
        kind, detail = description
        if kind == Nodetype.NAME:
            type_name = detail
            continue
        if kind == Nodetype.BASE and number == len(path) - 1 and detail[0] in FORMATS:
            return str(detail[0])
        if kind == Nodetype.ARRAY and number == len(path) - 2 and detail[0][0] == Nodetype.BASE:
            base, place = detail[0][1][0], int(path[-1])
            if base in FORMATS and 0 <= place < detail[1]:
                if place:
                    steps.skip((Nodetype.ARRAY, (detail[0], place)))
                return str(base)
        raise _NeedsAll
    raise _NeedsAll


def _reader(steps: list[tuple[str, int, int]], last: str, cdr: bool) -> Extract:
    """Return the function; where nothing before the field varies in size, it is one `unpack_from`."""
    size = struct.calcsize(FORMATS[last])
    origin = 4 if cdr else 0  # CDR begins with its kind, and aligns from behind that
    little, big = struct.Struct("<" + FORMATS[last]), struct.Struct(">" + FORMATS[last])
    prefix, rest = _fixed(steps, cdr)
    counts = struct.Struct("<I"), struct.Struct(">I")

    def read(data: bytes) -> Any:
        big_endian = cdr and not data[1] & 1
        count = counts[big_endian].unpack_from
        at = prefix
        for kind, align, width in rest:
            if cdr and kind != "numbers":
                at = (at + 3) & ~3
            if kind == "numbers":
                if cdr:
                    at = (at + align - 1) & -align
                at += width
            elif kind == "string":
                at += 4 + count(data, origin + at)[0]
            else:
                length = count(data, origin + at)[0]
                at += 4
                if length:
                    if cdr:
                        at = (at + align - 1) & -align
                    at += width * length
        if cdr:
            at = (at + size - 1) & -size
        return (big if big_endian else little).unpack_from(data, origin + at)[0]

    return read


def _fixed(steps: list[tuple[str, int, int]], cdr: bool) -> tuple[int, list[tuple[str, int, int]]]:
    """Return how much is skipped before anything varies in size, and the steps from there."""
    at = 0
    for number, (kind, align, width) in enumerate(steps):
        if kind != "numbers":
            return at, steps[number:]
        if cdr:
            at = (at + align - 1) & -align
        at += width
    return at, []


def check_path(fields: Fields, type_name: str, path: str) -> None:
    """Refuse a path that the type does not have, or that ends in more than one value."""
    here: Any = (Nodetype.NAME, type_name)
    for name in path.split("."):
        kind, detail = here
        if kind == Nodetype.NAME:
            inner = dict(fields[detail][1])
            if name not in inner:
                raise NoField(f"{type_name} has no field {path}: {detail} has {', '.join(inner) or 'none'}")
            here = inner[name]
        elif kind in (Nodetype.ARRAY, Nodetype.SEQUENCE) and name.isdecimal():
            here = detail[0]
        else:
            raise NoField(f"{type_name} has no field {path}: {name!r} is not there")
    if here[0] != Nodetype.BASE:
        raise NoField(f"{path} of {type_name} is more than one value")


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
