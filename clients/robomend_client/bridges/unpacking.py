"""One field of a message, without making the message: what is before it is skipped.

    header {stamp, frame_id}   string: skipped by its length
    orientation …              numbers: skipped at once
    angular_velocity.z         unpacked

A path (paths.py) is compiled once for a type, into steps. Numbers behind one another are one step; alignment
(CDR aligns numbers to their size, ROS 1 does not) is worked out beforehand where it can be. Of a list, the
elements before the wanted ones are skipped likewise, one by one where they differ in size; what is behind
them is not looked at. Where something before the field cannot be skipped, rosbags makes the whole message,
for which it loads numpy. Texts may be of any bytes: what is no UTF-8 is replaced.
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Mapping
from typing import Any

from rosbags.interfaces import Nodetype

from robomend_client.bridges.fields import MissingField
from robomend_client.paths import BadPath, Key, NotThere, Step, follow, several, steps, too_short

Extract = Callable[[bytes], Any]

Plain = Callable[[bytes], bytes]

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
            if inner_kind != Nodetype.BASE:
                raise _NeedsAll
            if inner[0] == "string":
                self.done.append(("strings", 4, 0))
                return
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


def unpacker(
    fields: Fields, type_name: str, path: str, *, cdr: bool, exact: bool = False, plain: Plain | None = None
) -> Extract | None:
    """Return a function from a message's bytes to a field of it; None where only the whole message has it.

    Args:
        fields: of the typestore.
        type_name: of the message.
        path: see paths.py, e.g. `twist.twist.linear.x`, `status_list[-1].status`, `level,name,msg`.
        cdr: ROS 2's encoding, else ROS 1's.
        exact: refuse messages that are longer or shorter than their type, as rosbags does; without it, and of
            lists, what is behind the field is not looked at. Refused is by ValueError, struct.error or
            IndexError.
        plain: unpacks a message, or refuses it, before anything of it is looked at.

    Raises:
        NoField: the type has no such field. The function itself raises MissingField where a message's list
            has no such element.
    """
    paths = several(path)
    if len(paths) > 1:
        found = {one: unpacker(fields, type_name, one, cdr=cdr, exact=exact, plain=plain) for one in paths}
        parts = {one: extract for one, extract in found.items() if extract is not None}
        return (lambda data: {o: e(data) for o, e in parts.items()}) if len(parts) == len(paths) else None
    check_path(fields, type_name, path)
    before, after = _Steps(fields, cdr), _Steps(fields, cdr)
    try:
        way = steps(path)
        if through := _list_on_the_way(fields, type_name, way):
            return _list_reader(before, type_name, way, through, path, plain)
        last, behind = _walk(before, type_name, [str(step) for step in way])
        for description in behind if exact else ():
            after.skip(description)
    except _NeedsAll:
        return None
    make = _text_reader if last == "string" else _number_reader
    return make(before.done, last, cdr, after.done if exact else None, plain)


def layout(fields: Fields, type_name: str, path: str, *, cdr: bool) -> tuple[int, Steps, str, Steps] | None:
    """Return what is around a number in each message of a type; None where only the whole message has it.

    That is how many bytes at first, then the steps that vary in size, the number's format (struct), and the
    steps behind it.

    Args:
        fields: as for `unpacker`, and so are the others.

    Raises:
        NoField: the type has no such field.
    """
    if len(several(path)) > 1:
        return None
    check_path(fields, type_name, path)
    before, after = _Steps(fields, cdr), _Steps(fields, cdr)
    way = steps(path)
    if _list_on_the_way(fields, type_name, way):
        return None
    try:
        last, behind = _walk(before, type_name, [str(step) for step in way])
        for description in behind:
            after.skip(description)
    except _NeedsAll:
        return None
    if last == "string" or any(kind == "strings" for kind, _, _ in (*before.done, *after.done)):
        return None
    return (*_fixed(before.done, cdr), FORMATS[last], after.done)


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


def _number_reader(before: Steps, last: str, cdr: bool, after: Steps | None, plain: Plain | None) -> Extract:
    """Return the function. A message as long as the one before it, and with the same texts, is laid out as it
    is, so that what was found of that holds.
    """
    size = struct.calcsize(FORMATS[last])
    origin = 4 if cdr else 0  # CDR begins with its kind, and aligns from behind that
    orders = struct.Struct("<" + FORMATS[last]).unpack_from, struct.Struct(">" + FORMATS[last]).unpack_from
    prefix, rest = _fixed(before, cdr)
    varying = max((number for number, step in enumerate(rest, 1) if step[0] != "numbers"), default=0)
    texts_first = all(kind != "sequence" for kind, _, _ in rest)
    remembered = texts_first and all(kind == "numbers" for kind, _, _ in after or ())
    only_numbers = after is not None and all(kind == "numbers" for kind, _, _ in (*rest, *after))
    first = behind = origin + prefix
    length, head, texts, place, unpack = -1, b"", b"", 0, orders[0]

    def read(data: bytes) -> Any:
        nonlocal length, head, texts, behind, place, unpack
        if len(data) == length and data[:2] == head and data[first:behind] == texts:
            return unpack(data, place)[0]
        if plain is not None:
            data = plain(data)
        big_endian = cdr and not data[1] & 1
        if big_endian and only_numbers:
            raise ValueError("it says that it is big endian, and has no length that shows it")
        at = end = _skipped(data, prefix, rest[:varying], cdr, big_endian)
        at = _skipped(data, at, rest[varying:], cdr, big_endian)
        if cdr:
            at = (at + size - 1) & -size
        if after is not None:
            _check_end(data, at + size, after, cdr)
        found = orders[big_endian](data, origin + at)[0]
        if remembered:
            length, head, texts, behind = len(data), data[:2], data[first : origin + end], origin + end
            place, unpack = origin + at, orders[big_endian]
        return found

    return read


def _text_reader(before: Steps, last: str, cdr: bool, after: Steps | None, plain: Plain | None) -> Extract:
    origin = 4 if cdr else 0
    prefix, rest = _fixed(before, cdr)

    def read(data: bytes) -> str:
        data = data if plain is None else plain(data)
        big_endian = cdr and not data[1] & 1
        at = _skipped(data, prefix, rest, cdr, big_endian)
        end = _skipped(data, at, [("string", 4, 0)], cdr, big_endian)
        if after is not None:
            _check_end(data, end, after, cdr)
        if cdr:
            at = (at + 3) & ~3
        # CDR's texts end with a zero.
        return data[origin + at + 4 : origin + end - cdr].decode(errors="replace")

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
        elif kind == "strings":
            length = count(data, origin + at)[0]
            if length > len(data):
                raise ValueError(f"a list of {length} texts in {len(data)} bytes")
            at = _skipped(data, at + 4, [("string", 4, 0)] * length, cdr, big_endian)
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
    try:
        way = steps(path)
    except BadPath as error:
        raise NoField(str(error)) from error
    here: Any = (Nodetype.NAME, type_name)
    for step in way:
        kind, detail = here
        listed = kind in (Nodetype.ARRAY, Nodetype.SEQUENCE)
        if kind == Nodetype.NAME and isinstance(step, str):
            inner = dict(fields[detail][1])
            if step not in inner:
                raise NoField(f"{type_name} has no field {path}: {detail} has {', '.join(inner) or 'none'}")
            here = inner[step]
        elif listed and isinstance(step, Key):
            here = detail[0]
            if here[0] != Nodetype.NAME:
                raise NoField(
                    f"{type_name} has no field {path}: elements that are no messages have no keys, write [0]"
                )
            check_key(fields, here[1], type_name, path, step)
        elif listed and (not isinstance(step, str) or step.isdecimal()):
            here = detail[0]
        elif listed:
            raise NoField(
                f"{type_name} has no field {path}: {step!r} is in a list, write [0], [-1] or [key=value] "
                "before it"
            )
        else:
            raise NoField(f"{type_name} has no field {path}: {_shown(step)} is not there")
    if here[0] != Nodetype.BASE and not any(isinstance(step, int | slice | Key) for step in way):
        raise NoField(f"{path} of {type_name} is more than one value")


def check_key(fields: Fields, element: str, type_name: str, path: str, key: Key) -> None:
    """Refuse a key that the elements of a list do not have."""
    here = element
    for name in steps(key.path):
        inner = dict(fields[here][1]) if here in fields else {}
        if name not in inner:
            has = ", ".join(inner) or "none"
            raise NoField(f"{type_name} has no field {path}: {here or 'what is there'} has {has}")
        kind, detail = inner[name]
        here = detail if kind == Nodetype.NAME else ""


def _shown(step: Step) -> str:
    return f"[{step.start or ''}:{step.stop or ''}]" if isinstance(step, slice) else repr(str(step))


# --- lists -----------------------------------------------------------------------------------------------


def _list_on_the_way(fields: Fields, type_name: str, way: tuple[Step, ...]) -> int:
    """Return at which step a path goes into a list that is more than an array of numbers and its place; 0: at
    none.
    """
    here: Any = (Nodetype.NAME, type_name)
    for number, step in enumerate(way):
        kind, detail = here
        if kind == Nodetype.NAME:
            here = dict(fields[detail][1])[step]
            continue
        simple = kind == Nodetype.ARRAY and detail[0][0] == Nodetype.BASE and isinstance(step, str)
        return 0 if simple and detail[0][1][0] != "string" else number
    return 0


def _list_reader(
    before: _Steps, type_name: str, way: tuple[Step, ...], number: int, path: str, plain: Plain | None
) -> Extract:
    """Return the function from a message to elements of a list, or to what is in them."""
    fields, cdr = before.fields, before.cdr
    for step in way[:number]:
        inner = fields[type_name][1]
        place = next(place for place, (field, _) in enumerate(inner) if field == step)
        for _, description in inner[:place]:
            before.skip(description)
        kind, detail = inner[place][1]
        type_name = detail if kind == Nodetype.NAME else type_name
    element, length = detail
    parts = _Parts(fields, cdr)
    one = _Steps(fields, cdr)
    one.skip(element)
    prefix, rest = _fixed(before.done, cdr)
    wanted, then = way[number], way[number + 1 :]
    count_of = None if kind == Nodetype.ARRAY else COUNTS
    width = struct.calcsize(FORMATS[element[1][0]]) if _is_number(element) else 0

    def read(data: bytes) -> Any:
        data = data if plain is None else plain(data)
        big_endian = cdr and not data[1] & 1
        origin = 4 if cdr else 0
        if cdr and data[:2] not in HEADERS:
            raise ValueError("it is no plain CDR")
        at = _skipped(data, prefix, rest, cdr, big_endian)
        count = length
        if count_of is not None:
            at = (at + 3) & ~3 if cdr else at
            count = count_of[big_endian].unpack_from(data, origin + at)[0]
            at += 4
        if count > len(data):
            raise ValueError(f"a list of {count} elements in {len(data)} bytes")
        if isinstance(wanted, Key):
            for _ in range(count):
                value, at = parts.value(element, data, at, big_endian)
                if wanted.matches(value):
                    return ends(value)
            raise MissingField(f"no field {path}: no element has {wanted}")
        if isinstance(wanted, slice):
            places = range(count)[wanted]
        else:
            place = int(wanted)
            if not -count <= place < count:
                raise MissingField(str(too_short(count, place, path)))
            places = range(count)[place : place + 1 or None]
        if places and width:
            at = ((at + width - 1) & -width if cdr else at) + width * places.start
        else:
            for _ in range(places.start if places else 0):
                at = _skipped(data, at, one.done, cdr, big_endian)
        values = []
        for _ in places:
            value, at = parts.value(element, data, at, big_endian)
            values.append(ends(value))
        return values if isinstance(wanted, slice) else values[0]

    def ends(value: Any) -> Any:
        try:
            return follow(value, then, path) if then else value
        except NotThere as error:
            raise MissingField(str(error)) from None

    return read


def _is_number(description: Any) -> bool:
    kind, detail = description
    return bool(kind == Nodetype.BASE and detail[0] in FORMATS)


class _Parts:
    """Makes numbers, texts, lists and mappings of any part of a message."""

    def __init__(self, fields: Fields, cdr: bool) -> None:
        self._fields = fields
        self._cdr = cdr

    def value(
        self, description: Any, data: bytes, at: int, big_endian: bool, depth: int = 0
    ) -> tuple[Any, int]:
        """Return what is there, and where one is behind it."""
        kind, detail = description
        origin = 4 if self._cdr else 0
        if depth > MOST_DEPTH:
            raise ValueError("it is nested too deeply")
        if kind == Nodetype.NAME:
            found = {}
            for name, inner in self._fields[detail][1]:
                if name != EMPTY or self._cdr:
                    found[name], at = self.value(inner, data, at, big_endian, depth + 1)
            return found, at
        if kind == Nodetype.BASE and detail[0] == "string":
            end = _skipped(data, at, [("string", 4, 0)], self._cdr, big_endian)
            if origin + end > len(data):
                raise ValueError("it ends within a text")
            at = (at + 3) & ~3 if self._cdr else at
            return data[origin + at + 4 : origin + end - self._cdr].decode(errors="replace"), end
        if kind == Nodetype.BASE:
            values, at = self._numbers(detail[0], 1, data, at, big_endian)
            return values[0], at
        element, count = detail
        if kind == Nodetype.SEQUENCE:
            at = (at + 3) & ~3 if self._cdr else at
            count = COUNTS[big_endian].unpack_from(data, origin + at)[0]
            at += 4
        if count > len(data):
            raise ValueError(f"a list of {count} elements in {len(data)} bytes")
        if _is_number(element):
            return self._numbers(element[1][0], count, data, at, big_endian)
        items = []
        for _ in range(count):
            item, at = self.value(element, data, at, big_endian, depth + 1)
            items.append(item)
        return items, at

    def _numbers(
        self, name: str, count: int, data: bytes, at: int, big_endian: bool
    ) -> tuple[list[Any], int]:
        form = FORMATS[name]
        size = struct.calcsize(form)
        if self._cdr and count:
            at = (at + size - 1) & -size
        order = ">" if big_endian else "<"
        values = struct.unpack_from(f"{order}{count}{form}", data, at + (4 if self._cdr else 0))
        return list(values), at + size * count
