"""The brackets of PDDL: text to nested groups of words, each with its place.

    (:action power_up …)   ──►   Brackets(items=(Word(":action"), Word("power_up"), …), line=…)

Words fold to lower case, as PDDL wants, except those in double quotes: `"Front/Lidar"` names an object
whose name is no PDDL word. A comment runs from `;` to the end of its line. Nothing here knows what the
words mean: see robomend.planning.domain.loading.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import NoReturn

from robomend.errors import DomainError

MAX_DEPTH = 100
"""Deeper nesting is refused: no sane formula has it, and every walk over groups recurses."""

TOKEN = re.compile(
    r"""(?P<space>\s+|;[^\n]*)|(?P<open>\()|(?P<close>\))|"(?P<quoted>[^"\n]*)"|(?P<word>[^\s()";]+)|(?P<bad>.)"""
)


@dataclass(frozen=True, slots=True)
class Word:
    """One word and where it stands."""

    text: str
    line: int
    file: str | None = None
    quoted: bool = False


@dataclass(frozen=True, slots=True)
class Brackets:
    """One pair of brackets and what is between them."""

    items: tuple[Word | Brackets, ...]
    line: int
    file: str | None = None

    @property
    def head(self) -> str | None:
        """The first word, when there is one: `and`, `:action`, …"""
        first = self.items[0] if self.items else None
        return first.text if isinstance(first, Word) else None


def fail(where: Word | Brackets, message: str) -> NoReturn:
    """Refuse a word or group with DomainError, at its place."""
    raise DomainError(message, where.file, where.line)


def read(text: str, file: str | None = None) -> Brackets:
    """Return the one group that the text consists of.

    Raises:
        DomainError: brackets that do not match, or more or less than one group, with file and line.
    """
    line = 1
    open_groups: list[tuple[int, list[Word | Brackets]]] = []
    found: Brackets | None = None
    for match in TOKEN.finditer(text):
        kind = match.lastgroup
        if kind == "space":
            line += match.group().count("\n")
            continue
        if found is not None:
            raise DomainError("more text after the last bracket; one (define …) a file", file, line)
        if kind == "open":
            if len(open_groups) >= MAX_DEPTH:
                raise DomainError(f"more than {MAX_DEPTH} brackets inside each other", file, line)
            open_groups.append((line, []))
        elif kind == "close":
            if not open_groups:
                raise DomainError("')' without its '('", file, line)
            started, items = open_groups.pop()
            group = Brackets(tuple(items), started, file)
            if open_groups:
                open_groups[-1][1].append(group)
            else:
                found = group
        elif not open_groups:
            raise DomainError(f"{match.group()!r} outside of any bracket; expected (define …)", file, line)
        elif kind == "quoted":
            open_groups[-1][1].append(Word(match.group("quoted"), line, file, quoted=True))
        elif kind == "word":
            open_groups[-1][1].append(Word(match.group().lower(), line, file))
        else:
            raise DomainError(f"a quote that is not closed in this line: {match.group()!r}", file, line)
    if open_groups:
        raise DomainError("'(' is never closed", file, open_groups[-1][0])
    if found is None:
        raise DomainError("no (define …) in this text", file, 1)
    return found


def render(item: Word | Brackets, width: int = 100, indent: int = 0) -> str:
    """Return the group as text again: on one line where it fits, else one item a line, indented."""
    if isinstance(item, Word):
        return f'"{item.text}"' if item.quoted else item.text
    flat = "(" + " ".join(render(part, 10**9) for part in item.items) + ")"
    if len(flat) + indent <= width:
        return flat
    pad = "\n" + " " * (indent + 2)
    lead = 0
    while lead < len(item.items):
        word = item.items[lead]
        if isinstance(word, Brackets) or (lead > 0 and word.text.startswith(":")):
            break
        lead += 1
    head = " ".join(render(part) for part in item.items[:lead])
    parts: list[str] = []
    for part in item.items[lead:]:
        text = render(part, width, indent + 2)
        # `:precondition (…)` stay together.
        if parts and parts[-1].startswith(":") and "(" not in parts[-1]:
            parts[-1] += " " + text
        else:
            parts.append(text)
    return "(" + head + "".join(pad + part for part in parts) + ")"
