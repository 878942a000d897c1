"""YAML text to a tree of scalars, lists and mappings that know their lines.

Built from parser events, so that every limit holds before anything grows: nesting, number of nodes, no
aliases (with them a kilobyte can unfold into gigabytes), no key twice. Scalars stay the text that was
written: a node named `on` is a name here, not the boolean of YAML 1.1.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass, field

import yaml

from robomend.errors import ModelError

MAX_CHARACTERS = 256 * 1024 * 1024
MAX_NESTING = 20
MAX_NODES = 20_000_000
EXCERPT = 60
NEVER_IN_YAML = re.compile(r"[^\t\n\r -~\x85\xa0-\ud7ff\ue000-\ufffd\U00010000-\U0010ffff]")
"""YAML 1.1, section 5.1: outside the printable characters."""


@dataclass(slots=True)
class Scalar:
    """A leaf; `plain` when it was written without quotes."""

    text: str
    line: int
    plain: bool


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


def read_tree(text: str, file: str | None = None) -> Tree:
    """Return the one document of a YAML text.

    Raises:
        ModelError: no YAML, more than one document, an alias, a key twice, or larger than any model is.
    """
    if len(text) > MAX_CHARACTERS:
        raise ModelError(f"the file has {len(text)} characters; at most {MAX_CHARACTERS} are read", file)
    loader = getattr(yaml, "CSafeLoader", yaml.SafeLoader)
    try:
        return _build(yaml.parse(text, loader), file)
    except yaml.YAMLError as error:
        mark = getattr(error, "problem_mark", None)
        problem = getattr(error, "problem", None) or getattr(error, "reason", None) or "cannot be read"
        line = mark.line + 1 if mark else _line_of_control_character(text)
        raise ModelError(f"not YAML: {problem}", file, line) from error
    except (ValueError, OverflowError, RecursionError) as error:
        raise ModelError(f"not YAML: {error}", file) from error


def _line_of_control_character(text: str) -> int | None:
    """Return the line of the first character that YAML never takes, which the parser gives no line of."""
    found = NEVER_IN_YAML.search(text)
    return text.count("\n", 0, found.start()) + 1 if found else None


def _build(events: Iterator[yaml.Event], file: str | None) -> Tree:
    root: Tree | None = None
    open_: list[Sequence | Mapping] = []
    keys: list[Scalar | None] = []  # of each open mapping: the key that waits for its value
    nodes = 0
    for event in events:
        if isinstance(event, (yaml.SequenceEndEvent, yaml.MappingEndEvent)):
            open_.pop()
            keys.pop()
            continue
        if not isinstance(event, yaml.NodeEvent):
            continue
        nodes += 1
        mark = event.start_mark
        line = mark.line + 1 if mark is not None else 0
        if isinstance(event, yaml.AliasEvent):
            raise ModelError(f"`*{event.anchor}`: aliases are not read; write it out", file, line)
        if nodes > MAX_NODES:
            raise ModelError(f"more than {MAX_NODES} entries", file, line)
        node: Tree
        if isinstance(event, yaml.ScalarEvent):
            node = Scalar(event.value, line, event.style is None)
        elif isinstance(event, yaml.SequenceStartEvent):
            node = Sequence([], line)
        else:
            node = Mapping({}, line)
        if not open_:
            if root is not None:
                raise ModelError("a second document begins; a model is one document", file, line)
            root = node
        else:
            _attach(open_[-1], keys, node, file)
        if not isinstance(node, Scalar):
            open_.append(node)
            keys.append(None)
            if len(open_) > MAX_NESTING:
                raise ModelError(f"nested deeper than {MAX_NESTING}", file, line)
    if root is None:
        raise ModelError("the file is empty", file)
    return root


def _attach(parent: Sequence | Mapping, keys: list[Scalar | None], node: Tree, file: str | None) -> None:
    if isinstance(parent, Sequence):
        parent.items.append(node)
        return
    key = keys[-1]
    if key is None:
        if not isinstance(node, Scalar):
            raise ModelError("a key must be a name, not a list or a mapping", file, node.line)
        if node.text in parent.items:
            first = parent.lines[node.text]
            raise ModelError(
                f"`{node.text[:EXCERPT]}` is written twice (first in line {first})", file, node.line
            )
        keys[-1] = node
        return
    parent.items[key.text] = node
    parent.lines[key.text] = key.line
    keys[-1] = None
