"""Fields of messages that rosbags has read, by their dotted paths."""

from __future__ import annotations

from dataclasses import fields, is_dataclass
from functools import lru_cache
from typing import Any

from robomend_client.bridges.problems import Complaint


class UnreadableMessage(Complaint):
    """A definition or a message that cannot be read, or has no such field."""


class MissingField(UnreadableMessage):
    """A message that has no such field."""


def value_at(message: Any, path: str) -> Any:
    """Return what a dotted path leads to, as numbers, texts, lists and mappings.

    Raises:
        MissingField: the message has none.
    """
    value = message
    for name in steps(path):
        try:
            value = value[int(name)] if name.isdigit() else getattr(value, name)
        except (AttributeError, IndexError, TypeError, KeyError):
            raise MissingField(f"no field {path}: {name!r} is not there") from None
    return plain(value)


@lru_cache(maxsize=1024)
def steps(path: str) -> tuple[str, ...]:
    """Return a path's names; those of Python's own are none of a message's."""
    return tuple("-" if name.startswith("__") else name for name in path.split("."))


def plain(value: Any) -> Any:
    """Return a value of a message without the classes of rosbags and numpy."""
    if isinstance(value, (int, float, str, bool)):
        return value
    if isinstance(value, list):
        return [plain(item) for item in value]
    if hasattr(value, "tolist"):  # numpy's arrays and numbers
        return value.tolist()
    if not is_dataclass(value):
        return str(value)
    names = (field.name for field in fields(value))
    return {name: plain(getattr(value, name)) for name in names if not name.startswith("__")}
