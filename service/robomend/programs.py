"""Argument lists of programs that the service may run: templates of its settings, filled from a plan.

    {"usb-reset": ["usbreset", "--bus", "{0}"]}        {0}, {1}, …: the action's parameters

Parameters are names of PDDL objects, which whoever configures a robot over HTTP chooses. So a value that
begins with `-` (an option), holds a path separator or is `.` or `..` (a file) is refused, unless its place
allows it:

    {0:path}    a file: separators and dots are allowed
    {0:any}     anything; only behind `--`, after which programs take nothing for an option

A value is always one argument, or a part of one: no shell sees it.
"""

from __future__ import annotations

import re
from collections.abc import Sequence

PLACE = re.compile(r"\{(\d+)(?::(\w*))?\}")
KINDS = frozenset({"", "path", "any"})


class Unfit(ValueError):
    """A template that cannot be, or a value that its place does not allow."""


def check_template(template: Sequence[str]) -> None:
    """Refuse (Unfit) an argument list that leaves to a plan what it must not."""
    if not template or not template[0]:
        raise Unfit("it names no program")
    if PLACE.search(template[0]):
        raise Unfit(f"{template[0]!r}: what runs must not depend on a parameter")
    behind = False
    for part in template[1:]:
        for place in PLACE.finditer(part):
            kind = place[2] or ""
            if kind not in KINDS:
                raise Unfit(f"{place[0]}: a place is {{n}}, {{n:path}} or {{n:any}}")
            if kind == "any" and not behind:
                raise Unfit(f"{place[0]}: {{n:any}} stands behind `--` only, so that no value is an option")
        behind = behind or part == "--"


def arguments(template: Sequence[str], values: Sequence[str]) -> list[str]:
    """Return the argument list for an action's parameters.

    Raises:
        Unfit: there are too few of them, or one that its place does not allow.
    """

    def fill(place: re.Match[str]) -> str:
        number, kind = int(place[1]), place[2] or ""
        if number >= len(values):
            raise Unfit(f"wants more than {len(values)} parameters")
        value = values[number]
        why = _refusal(value, kind)
        if why:
            raise Unfit(f"takes no {value!r} for {place[0]}: {why}")
        return value

    return [PLACE.sub(fill, part) for part in template]


def _refusal(value: str, kind: str) -> str:
    if "\0" in value:
        return "no argument holds a NUL"
    if kind == "any":
        return ""
    if value.startswith("-"):
        return "it would be an option"
    if kind != "path" and ("/" in value or "\\" in value or value in {".", ".."}):
        return "it would be a path"
    return ""
