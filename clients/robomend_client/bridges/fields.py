"""Fields of messages that rosbags has read, by their paths."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import fields, is_dataclass
from typing import Any

from robomend_client.bridges.problems import Complaint
from robomend_client.paths import NotThere, at


class UnreadableMessage(Complaint):
    """A definition or a message that cannot be read, or has no such field."""


class MissingField(UnreadableMessage):
    """A message that has no such field."""


def value_at(message: Any, path: str) -> Any:
    """Return what a path (paths.py) leads to, as numbers, texts, lists and mappings.

    Raises:
        MissingField: the message has none.
    """
    try:
        return plain(at(message, path))
    except NotThere as error:
        raise MissingField(str(error)) from None


ITEMS, LONG = 8, 200
"""Of a list that many items are in a text of it, and of a text within so many characters."""


def as_text(message: Any, most: int) -> str:
    """Return a message as text, a field a line, of so many characters at most; long lists are cut short."""
    lines: list[str] = []
    left = most
    for line in _lines(message, 0):
        left -= len(line) + 1
        if left < 0:
            lines.append("…")
            break
        lines.append(line)
    return "\n".join(lines)[:most]


def _lines(value: Any, depth: int) -> Iterator[str]:
    indent = "  " * depth
    for field in fields(value):
        if field.name.startswith("__"):
            continue
        inner = getattr(value, field.name)
        if is_dataclass(inner):
            yield f"{indent}{field.name}:"
            yield from _lines(inner, depth + 1)
        elif isinstance(inner, list) and inner and is_dataclass(inner[0]):
            for number, one in enumerate(inner[:ITEMS]):
                yield f"{indent}{field.name}[{number}]:"
                yield from _lines(one, depth + 1)
            if len(inner) > ITEMS:
                yield f"{indent}{field.name}: … {len(inner)} in all"
        else:
            yield f"{indent}{field.name}: {_short(inner)}"


def _short(value: Any) -> str:
    if isinstance(value, str):
        return repr(value[:LONG]) + ("…" if len(value) > LONG else "")
    if hasattr(value, "__len__") and not isinstance(value, bytes):
        some = plain(value[:ITEMS])
        more = f", … {len(value)} in all]" if len(value) > ITEMS else "]"
        return "[" + ", ".join(map(_short, some)) + more
    return f"{value:.6g}" if isinstance(value, float) else str(value)[:LONG]


def plain(value: Any) -> Any:
    """Return a value of a message without the classes of rosbags and numpy."""
    if isinstance(value, (int, float, str, bool)):
        return value
    if isinstance(value, list):
        return [plain(item) for item in value]
    if isinstance(value, dict):
        return {name: plain(item) for name, item in value.items()}
    if hasattr(value, "tolist"):  # numpy's arrays and numbers
        return value.tolist()
    if not is_dataclass(value):
        return str(value)
    names = (field.name for field in fields(value))
    return {name: plain(getattr(value, name)) for name in names if not name.startswith("__")}
