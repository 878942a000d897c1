"""Fields of messages that rosbags has read, by their paths."""

from __future__ import annotations

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
