"""The names that templates are filled with."""

from __future__ import annotations

import keyword
import re

from robomend.errors import InputError

SNAKE = re.compile(r"[a-z][a-z0-9_]{0,60}\Z")


def snake(name: str) -> str:
    """Return a name that is a module, a function and an action of PDDL.

    Raises:
        InputError: it is none.
    """
    if not SNAKE.match(name) or keyword.iskeyword(name):
        raise InputError(f"{name!r} cannot be it: small letters, digits and _, as in too_hot")
    return name


def camel(name: str) -> str:
    """Return the name of the class: TooHot of too_hot."""
    return "".join(word.capitalize() for word in name.split("_"))
