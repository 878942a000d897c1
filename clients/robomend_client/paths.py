"""Where in a message a value is, by a path: `twist.twist.angular.z`, `ranges[0]`, `status_list[-1].status`.

    name             a field of a message
    3, [3]           a place of a list, counted from 0
    [-1]             the last element, [-2] the one before it
    [name=laser]     the first element whose field `name` is that; the field may be a path: [goal_id.id=7]
    [-64:]           the last 64 elements, as a list; [:10] the first ten
    a.b,c            several values at once: a mapping from each path to its value

A key may lead to an id that is a message of its own: [goal_id=7] looks into its `id` or `uuid`; bytes are
compared as hexadecimal.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from functools import lru_cache
from typing import Any, NamedTuple

INSIDE = re.compile(r"\[[^\[\]]*\]")
STEP = re.compile(r"(?P<name>[^.\[\]]+)|\[(?P<inside>[^\[\]]*)\]")
PLACE = re.compile(r"-?\d+\Z")
SLICE = re.compile(r"(-?\d+)?:(-?\d+)?\Z")

WRITE = "write field.field, field[0], field[-1], field[key=value] or field[-10:]"


class BadPath(ValueError):
    """A path that cannot be read; the message says what to write."""


class NotThere(LookupError):
    """A message that has nothing there; the message says where the path ends."""


class Key(NamedTuple):
    """An element of a list, by a field of it."""

    path: str
    value: str

    def matches(self, element: object) -> bool:
        """Return whether an element has that value there."""
        try:
            found = at(element, self.path)
        except NotThere:
            return False
        for name in ("id", "uuid"):
            if (inner := _field(found, name)) is not None:
                found = inner
        if isinstance(found, Sequence) and not isinstance(found, str):
            try:
                found = bytes(found).hex()
            except (ValueError, TypeError):
                return False
        if isinstance(found, float):
            try:
                return found == float(self.value)
            except ValueError:
                return False
        return str(found).casefold() == self.value.casefold()

    def __str__(self) -> str:
        return f"[{self.path}={self.value}]"


Step = str | int | slice | Key
"""A name (of digits: a place), a place, a part of a list, an element by a key."""


@lru_cache(maxsize=1024)
def several(path: str) -> tuple[str, ...]:
    """Return the paths that a path is made of: one, where it has no comma."""
    plain = INSIDE.sub(lambda found: "\0" * len(found[0]), path)
    ends = [place for place, letter in enumerate(plain) if letter == ","]
    return tuple(path[i + 1 : j] for i, j in zip([-1, *ends], [*ends, len(path)], strict=True))


@lru_cache(maxsize=1024)
def steps(path: str) -> tuple[Step, ...]:
    """Return the steps of one path.

    Raises:
        BadPath: it is none.
    """
    found: list[Step] = []
    place = 0
    while place < len(path):
        if found and path[place] == ".":
            place += 1
        elif found and path[place] != "[":
            raise BadPath(f"{path!r} is no path at {path[place:]!r}: {WRITE}")
        step = STEP.match(path, place)
        if step is None:
            raise BadPath(f"{path!r} is no path at {path[place:]!r}: {WRITE}")
        place = step.end()
        found.append(step["name"] if step["name"] is not None else _bracket(path, step["inside"]))
    if not found or path.endswith("."):
        raise BadPath(f"{path!r} is no path: {WRITE}")
    return tuple(found)


def _bracket(path: str, inside: str) -> Step:
    if PLACE.match(inside):
        return int(inside)
    if part := SLICE.match(inside):
        begin, end = (None if one is None else int(one) for one in part.groups())
        return slice(begin, end)
    key, equals, value = inside.partition("=")
    if key.strip() and equals and value.strip():
        steps(key.strip())
        return Key(key.strip(), value.strip().strip("'\""))
    raise BadPath(f"{path!r}: [{inside}] is no place of a list: write [0], [-1], [-10:] or [key=value]")


def at(message: object, path: str) -> Any:
    """Return what a path leads to in a message of mappings and lists, or of objects with fields.

    Raises:
        BadPath: it is none.
        NotThere: the message has nothing there.
    """
    paths = several(path)
    if len(paths) > 1:
        return {one: follow(message, steps(one), one) for one in paths}
    return follow(message, steps(path), path)


def follow(value: Any, way: Sequence[Step], path: str) -> Any:
    """Return what these steps lead to; `path` is what a complaint calls them."""
    for number, step in enumerate(way):
        if isinstance(step, slice):
            items = _items(value, step, path)[step]
            rest = way[number + 1 :]
            return [follow(item, rest, path) for item in items] if rest else items
        if isinstance(step, Key):
            value = next((item for item in _items(value, step, path) if step.matches(item)), None)
            if value is None:
                raise NotThere(f"no field {path}: no element has {step}")
        elif isinstance(step, int) or (step.isdecimal() and not isinstance(value, Mapping)):
            value = element(_items(value, step, path), int(step), path)
        else:
            inner = _field(value, step)
            if inner is None:
                listed = "is in a list: write [0], [-1] or [key=value] before it"
                raise NotThere(f"no field {path}: {step!r} {listed if _is_list(value) else 'is not there'}")
            value = inner
    return value


def element(items: Any, place: int, path: str) -> Any:
    """Return an element of a list."""
    if not -len(items) <= place < len(items):
        raise too_short(len(items), place, path)
    return items[place]


def too_short(count: int, place: int, path: str) -> NotThere:
    return NotThere(f"no field {path}: '{place}' is not there, the list has {count or 'no'} elements")


def _field(value: object, name: str) -> Any:
    if isinstance(value, Mapping):
        return value.get(name)
    if name.startswith("__") or isinstance(value, (str, int, float)) or _is_list(value):
        return None  # those of Python's own are none of a message's
    return getattr(value, name, None)


def _items(value: Any, step: object, path: str) -> Any:
    if not _is_list(value):
        raise NotThere(f"no field {path}: {str(step)!r} is not there, as that is no list")
    return value


def _is_list(value: object) -> bool:
    return isinstance(value, (list, tuple)) or (hasattr(value, "tolist") and getattr(value, "ndim", 0) > 0)
