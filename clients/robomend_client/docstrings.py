"""What a docstring says of each parameter or attribute: what editors and the reference show at a key.

    Args:
        slope: b, in units of the value per second: above it the value increases,
            below −b it decreases.

`Attributes:` of a dataclass is read alike. Of a class, what its own docstrings say counts before what those
of its bases do.
"""

from __future__ import annotations

import inspect
import re
from collections.abc import Callable, Iterator
from typing import Any

HEADINGS = ("Args:", "Attributes:")
ENTRY = re.compile(r"(?P<name>\w+): (?P<text>.+)")


def documented(what: Callable[..., Any]) -> dict[str, str]:
    """Return what a class or function says of its parameters and attributes, each text in one line."""
    found: dict[str, str] = {}
    for docstring in _docstrings(what):
        for name, text in _entries(docstring):
            found.setdefault(name, text)
    return found


def _docstrings(what: Callable[..., Any]) -> Iterator[str]:
    makers: tuple[Any, ...] = (what,)
    if inspect.isclass(what):
        makers = tuple(part for c in what.__mro__[:-1] for part in (c, vars(c).get("__init__")))
    for maker in makers:
        if docstring := getattr(maker, "__doc__", None):
            yield inspect.cleandoc(docstring)


def _entries(docstring: str) -> Iterator[tuple[str, str]]:
    """Yield the entries under a heading; a line that is further in goes on with the one above."""
    entries: list[str] = []
    inside, depth = False, 0
    for line in docstring.splitlines():
        indent = len(line) - len(line.lstrip())
        if line.rstrip() in HEADINGS:
            inside, depth = True, 0
        elif not line.strip() or not inside:
            continue
        elif not indent:
            inside = False
        elif not depth or indent == depth:
            depth = indent
            entries.append(line.strip())
        else:
            entries[-1] += f" {line.strip()}"
    for entry in entries:
        if found := ENTRY.fullmatch(entry):
            yield found["name"], found["text"].removesuffix(".")
