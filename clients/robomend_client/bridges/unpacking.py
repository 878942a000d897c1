"""One field of a message, without making the message: what is before it is skipped.

    header {stamp, frame_id}   string: skipped by its length
    orientation …              numbers: skipped at once
    angular_velocity.z         unpacked

A path is compiled once for a type, into steps. Numbers behind one another are one step; alignment (CDR aligns
numbers to their size, ROS 1 does not) is worked out beforehand where it can be. A path through sequences of
messages is none that is compiled: rosbags makes the whole message then, for which it loads numpy.
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


HEADERS = (b"\0\0", b"\0\1")
"""How plain CDR begins: big and little endian."""

COUNTS = struct.Struct("<I"), struct.Struct(">I")


class NoField(ValueError):
    """A type has no such field, or it is no single value."""


class _NeedsAll(Exception):
    """The field, or what is around it, cannot be skipped."""


Steps = list[tuple[str, int, int]]


class _Steps:
    """What is to be skipped, as (alignment, size) of numbers, or of sequences of them."""

    def __init__(self, fields: Fields, cdr: bool) -> None:
        self.fields = fields
        self.cdr = cdr
        self.done: Steps = []

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


def unpacker(fields: Fields, type_name: str, path: str, *, cdr: bool, exact: bool = False) -> Extract | None:
    """Return a function from a message's bytes to a field of it; None where only the whole message has it.

    Args:
        fields: of the typestore.
        type_name: of the message.
        path: dotted, e.g. `twist.twist.linear.x`; a number is a place in an array.
        cdr: ROS 2's encoding, else ROS 1's.
        exact: refuse messages that are longer or shorter than their type, as rosbags does; without it, what
            is behind the field is not looked at. Refused is by ValueError, struct.error or IndexError.

    Raises:
        NoField: the type has no such field.
    """
    check_path(fields, type_name, path)
    before, after = _Steps(fields, cdr), _Steps(fields, cdr)
    try:
        last, behind = _walk(before, type_name, path.split("."))
        for description in behind if exact else ():
            after.skip(description)
    except _NeedsAll:
        return None
    make = _text_reader if last == "string" else _number_reader
    return make(before.done, last, cdr, after.done if exact else None)


def layout(fields: Fields, type_name: str, path: str, *, cdr: bool) -> tuple[int, Steps, str, Steps] | None:
    """Return what is around a number in each message of a type; None where only the whole message has it.

    That is how many bytes at first, then the steps that vary in size, the number's format (struct), and the
    steps behind it.

    Args:
        fields: as for `unpacker`, and so are the others.

    Raises:
        NoField: the type has no such field.
    """
    check_path(fields, type_name, path)
    before, after = _Steps(fields, cdr), _Steps(fields, cdr)
    try:
        last, behind = _walk(before, type_name, path.split("."))
        for description in behind:
            after.skip(description)
    except _NeedsAll:
        return None
    return None if last == "string" else (*_fixed(before.done, cdr), FORMATS[last], after.done)


def _walk(steps: _Steps, type_name: str, path: list[str]) -> tuple[str, list[Any]]:
    """Note what is before a field; return the type of the field, and what is behind it."""
    behind: list[Any] = []
    for number, name in enumerate(path):
        fields = steps.fields[type_name][1]
        place = next(place for place, (field, _) in enumerate(fields) if field == name)
        for _, description in fields[:place]:
            steps.skip(description)
        behind = [description for _, description in fields[place + 1 :]] + behind
        kind, detail = fields[place][1]
        if kind == Nodetype.NAME:
            type_name = detail
            continue
        if kind == Nodetype.BASE and number == len(path) - 1 and detail[0] in (*FORMATS, "string"):
            return str(detail[0]), behind
        if kind == Nodetype.ARRAY and number == len(path) - 2 and detail[0][0] == Nodetype.BASE:
            (_, (base, _)), count = detail
            at = int(path[-1])
            if base in FORMATS and 0 <= at < count:
                if at:
                    steps.skip((Nodetype.ARRAY, (detail[0], at)))
                left = [(Nodetype.ARRAY, (detail[0], count - at - 1))] if at + 1 < count else []
                return base, left + behind
        raise _NeedsAll
    raise _NeedsAll


def _number_reader(before: Steps, last: str, cdr: bool, after: Steps | None) -> Extract:
    """Return the function; where nothing before the field varies in size, it is one `unpack_from`."""
    size = struct.calcsize(FORMATS[last])
    origin = 4 if cdr else 0  # CDR begins with its kind, and aligns from behind that
    orders = struct.Struct("<" + FORMATS[last]), struct.Struct(">" + FORMATS[last])
    prefix, rest = _fixed(before, cdr)

    def read(data: bytes) -> Any:
        big_endian = cdr and not data[1] & 1
        at = _skipped(data, prefix, rest, cdr, big_endian) if rest else prefix
        if cdr:
            at = (at + size - 1) & -size
        if after is not None:
            _check_end(data, at + size, after, cdr)
        return orders[big_endian].unpack_from(data, origin + at)[0]

    return read


def _text_reader(before: Steps, last: str, cdr: bool, after: Steps | None) -> Extract:
    origin = 4 if cdr else 0
    prefix, rest = _fixed(before, cdr)

    def read(data: bytes) -> str:
        big_endian = cdr and not data[1] & 1
        at = _skipped(data, prefix, rest, cdr, big_endian)
        end = _skipped(data, at, [("string", 4, 0)], cdr, big_endian)
        if after is not None:
            _check_end(data, end, after, cdr)
        if cdr:
            at = (at + 3) & ~3
        return data[origin + at + 4 : origin + end - cdr].decode()  # CDR's texts end with a zero

    return read


def _skipped(data: bytes, at: int, steps: Steps, cdr: bool, big_endian: bool) -> int:
    """Return where one is behind these steps."""
    origin = 4 if cdr else 0
    count = COUNTS[big_endian].unpack_from
    for kind, align, width in steps:
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
    return at


def _check_end(data: bytes, at: int, after: Steps, cdr: bool) -> None:
    """Refuse a message that does not end where its type does; CDR may be padded."""
    if cdr and data[:2] not in HEADERS:
        raise ValueError("it is no plain CDR")
    end = _skipped(data, at, after, cdr, cdr and not data[1] & 1)
    spare = len(data) - end - (4 if cdr else 0)
    if not 0 <= spare <= (3 if cdr else 0):
        how = f"{spare} bytes longer" if spare > 0 else f"{-spare} bytes shorter"
        raise ValueError(f"it is {how} than its type")


def _fixed(steps: Steps, cdr: bool) -> tuple[int, Steps]:
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
