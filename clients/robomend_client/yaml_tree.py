"""YAML text to a tree of scalars, lists and mappings that know their lines.

Built from parser events, so that every limit holds before anything grows: nesting, number of nodes, no key
twice. Scalars stay the text that was written: a node named `on` is a name here, not the boolean of YAML 1.1.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass, field

import yaml

MAX_CHARACTERS = 256 * 1024 * 1024
MAX_NESTING = 20
MAX_NODES = 20_000_000
EXCERPT = 60
NEVER_IN_YAML = re.compile(r"[^\t\n\r -~\x85\xa0-\ud7ff\ue000-\ufffd\U00010000-\U0010ffff]")
"""YAML 1.1, section 5.1: outside the printable characters."""

EMPTY = frozenset({"", "~", "null", "Null", "NULL"})
"""What means "no value" where it stands without quotes."""


class YamlError(ValueError):
    """A text that is no YAML, or none that is read here; `line` is None where nobody knows it."""

    def __init__(self, message: str, line: int | None = None) -> None:
        super().__init__(message, line)
        self.message = message
        self.line = line

    def __str__(self) -> str:
        return self.message


class RepeatedKey(YamlError):
    """A mapping has one key twice; `place` is the way to it, key by key."""

    def __init__(self, place: tuple[str, ...], first: int, line: int) -> None:
        super().__init__(f"`{place[-1][:EXCERPT]}` is written twice (first in line {first})", line)
        self.place = place


@dataclass(slots=True)
class Scalar:
    """A leaf; `plain` when it was written without quotes."""

    text: str
    line: int
    plain: bool

    @property
    def empty(self) -> bool:
        """Whether it stands for no value."""
        return self.plain and self.text in EMPTY


@dataclass(slots=True)
class Sequence:
    """A list."""

    items: list[Tree]
    line: int


@dataclass(slots=True)
class Mapping:
    """Keys (always scalars) to values, in the order of the file."""

    items: dict[str, Tree]
    line: int
    lines: dict[str, int] = field(default_factory=dict)  # of the keys


Tree = Scalar | Sequence | Mapping


def read_tree(text: str, *, aliases: bool = False) -> Tree:
    """Return the one document of a YAML text.

    Args:
        aliases: an alias is the very node that it names. Only for whoever goes to a fixed depth, since a
            kilobyte of aliases unfolds into gigabytes for one who walks all of it.

    Raises:
        YamlError: no YAML, more than one document, an alias where they are not read, a key twice, or larger
            than anything that is written by hand.
    """
    if len(text) > MAX_CHARACTERS:
        raise YamlError(f"the file has {len(text)} characters; at most {MAX_CHARACTERS} are read")
    loader = getattr(yaml, "CSafeLoader", yaml.SafeLoader)
    try:
        return _Builder(aliases).build(yaml.parse(text, loader))
    except yaml.YAMLError as error:
        mark = getattr(error, "problem_mark", None)
        problem = getattr(error, "problem", None) or getattr(error, "reason", None) or "cannot be read"
        if mark is None and (found := NEVER_IN_YAML.search(text)):  # of which the parser knows no line
            line = text.count("\n", 0, found.start()) + 1
            raise YamlError(f"not YAML: character #x{ord(found[0]):02x} is not allowed", line) from error
        if mark is not None and _at(text, mark.line, mark.column) == "\t":
            problem = "a tab; lines are indented with spaces"
        if "nesting depth" in problem:  # libyaml 0.2.6 reads ahead of our bound up to one of its own
            raise YamlError(f"nested deeper than {MAX_NESTING}", mark.line + 1 if mark else None) from error
        raise YamlError(f"not YAML: {problem}", mark.line + 1 if mark else None) from error
    except (OverflowError, RecursionError) as error:
        raise YamlError(f"not YAML: {error}") from error


def _at(text: str, line: int, column: int) -> str:
    """Return the character at a place, counted from 0; none behind the end."""
    lines = text.split("\n")
    return lines[line][column : column + 1] if line < len(lines) else ""


@dataclass(slots=True)
class _Open:
    """A list or mapping whose end has not come yet."""

    node: Sequence | Mapping
    anchor: str | None
    under: str | None  # the key that it is the value of
    key: str | None = None  # of a mapping: the key that waits for its value


class _Builder:
    """The tree as far as it was read."""

    def __init__(self, aliases: bool) -> None:
        self._aliases = aliases
        self._open: list[_Open] = []
        self._named: dict[str, Tree] = {}

    def build(self, events: Iterator[yaml.Event]) -> Tree:
        root: Tree | None = None
        nodes = 0
        for event in events:
            if isinstance(event, yaml.CollectionEndEvent):
                ended = self._open.pop()
                if ended.anchor is not None:
                    self._named[ended.anchor] = ended.node
            elif isinstance(event, yaml.NodeEvent):
                nodes += 1
                mark = event.start_mark
                line = mark.line + 1 if mark is not None else 0
                if nodes > MAX_NODES:
                    raise YamlError(f"more than {MAX_NODES} entries", line)
                if root is not None and not self._open:
                    raise YamlError("a second document begins; one is read", line)
                node = self._node(event, line)
                root = root or node
                under = self._attach(node, line) if self._open else None
                if isinstance(event, yaml.CollectionStartEvent):
                    assert not isinstance(node, Scalar)
                    self._open.append(_Open(node, event.anchor, under))
                    if len(self._open) > MAX_NESTING:
                        raise YamlError(f"nested deeper than {MAX_NESTING}", line)
        if root is None:
            raise YamlError("the file is empty")
        return root

    def _node(self, event: yaml.NodeEvent, line: int) -> Tree:
        if isinstance(event, yaml.ScalarEvent):
            scalar = Scalar(event.value, line, not event.style)  # plain is "" in C, None in Python
            if event.anchor is not None:
                self._named[event.anchor] = scalar
            return scalar
        if isinstance(event, yaml.AliasEvent):
            if not self._aliases:
                raise YamlError(f"`*{event.anchor}`: aliases are not read; write it out", line)
            if event.anchor not in self._named:
                raise YamlError(f"`*{event.anchor}` names nothing that is whole before it", line)
            return self._named[event.anchor]
        return Sequence([], line) if isinstance(event, yaml.SequenceStartEvent) else Mapping({}, line)

    def _attach(self, node: Tree, line: int) -> str | None:
        """Put the node into what is open, and return the key that it is the value of."""
        parent = self._open[-1]
        if isinstance(parent.node, Sequence):
            parent.node.items.append(node)
            return None
        if parent.key is not None:
            key, parent.key = parent.key, None
            parent.node.items[key] = node
            return key
        if not isinstance(node, Scalar):
            raise YamlError("a key must be a name, not a list or a mapping", line)
        if node.text in parent.node.items:
            way = (one.under for one in self._open if one.under is not None)
            raise RepeatedKey((*way, node.text), parent.node.lines[node.text], line)
        parent.node.lines[node.text] = line
        parent.key = node.text
        return None
