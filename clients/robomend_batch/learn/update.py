"""What was learned, as changes of a file that exists: a unified diff, and nothing is written.

Entries of the file keep the keys that nothing was learned about. A number that differs by less than CLOSE
stays as it is, so that the same logs propose nothing twice. Comments outside of a changed entry stay.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from difflib import unified_diff
from pathlib import Path

import yaml

from robomend.errors import InputError
from robomend.model.from_graph import Entries, Entry, comment, entry_line

CLOSE = 0.1
"""Of a number."""


def proposed(file: Path, entries: Entries) -> str:
    """Return the diff that brings the observers of a file to what was learned; empty: nothing to change.

    Raises:
        InputError: the file is no YAML with observers.
    """
    text = file.read_text("utf-8")
    try:
        root = yaml.compose(text, Loader=yaml.SafeLoader)
    except yaml.YAMLError as error:
        raise InputError(f"{file}: {error}") from error
    if root is not None and not isinstance(root, yaml.MappingNode):
        raise InputError(f"{file}: a mapping with `topics:` or `observers:` is needed")
    sections = {} if root is None else {key.value: value for key, value in root.value}
    if "robomend" in sections:
        raise InputError(f"{file} is a model: --update takes the file with the observers, such as agent.yaml")
    edits: list[tuple[int, int, str]] = []  # from line, to line, text
    lines = text.splitlines(keepends=True)
    if lines and not lines[-1].endswith("\n"):
        lines[-1] += "\n"
    tail: list[str] = []
    for section, learned in (("topics", entries.topics), ("observers", entries.observers)):
        if not learned:
            continue
        learned = _fed(learned, section, sections)
        node = sections.get(section)
        if node is None:
            tail += [f"\n{section}:\n", *_added(learned, entries, "  ")]
        elif isinstance(node, yaml.MappingNode) and not node.flow_style:
            edits += _of_section(node, learned, entries, lines)
        else:
            raise InputError(f"{file}:{node.start_mark.line + 1}: {section} is to be a block of entries")
    changed = list(lines)
    for first, last, new in sorted(edits, reverse=True):
        changed[first:last] = new.splitlines(keepends=True)
    changed += [line for block in tail for line in block.splitlines(keepends=True)]
    return "".join(unified_diff(lines, changed, f"a/{file.name}", f"b/{file.name}"))


def _fed(learned: Mapping[str, Entry], section: str, sections: Mapping[str, yaml.Node]) -> dict[str, Entry]:
    """Return what was learned, new entries fed as the file's topics are, if these are all fed by one.

    A new topic of a robot with ROS that said nothing would be one of the bus, and silent.
    """
    said = _origin(sections.get("rate"))
    there = _entries(sections.get(section))
    origins = {_origin(entry) or said for entry in _entries(sections.get("topics")).values()}
    origin = origins.pop() if len(origins) == 1 else ""
    if not origin or (section == "topics" and origin == said):
        return dict(learned)
    return {name: entry if name in there else {"from": origin, **entry} for name, entry in learned.items()}


def _entries(node: yaml.Node | None) -> dict[str, yaml.Node]:
    pairs = node.value if isinstance(node, yaml.MappingNode) else ()
    return {str(key.value).removeprefix("/"): value for key, value in pairs}


def _origin(node: yaml.Node | None) -> str:
    """Return who feeds an entry; empty: it does not say."""
    origin = _entries(node).get("from")
    return str(origin.value) if isinstance(origin, yaml.ScalarNode) else ""


def _of_section(
    node: yaml.MappingNode, learned: Mapping[str, Entry], entries: Entries, lines: list[str]
) -> list[tuple[int, int, str]]:
    """Return the edits of a section."""
    edits = []
    indent = " " * (node.value[0][0].start_mark.column if node.value else 2)
    there = {key.value.removeprefix("/"): (key, value) for key, value in node.value}
    end = node.start_mark.line
    for key, value in node.value:
        end = max(end, _end(key, value, lines))
    for name, entry in learned.items():
        if name not in there:
            continue
        key, value = there[name]
        merged = _merged(value, entry)
        if merged is not None:
            written = ", ".join(f"{k}: {v}" for k, v in merged.items())
            why = "".join(f"{indent}# {comment(line)}\n" for line in entries.evidence[name])
            written_key = lines[key.start_mark.line][key.start_mark.column : key.end_mark.column]
            new = f"{why}{indent}{written_key}: {{{written}}}\n"
            edits.append((key.start_mark.line, _end(key, value, lines), new))
    missing = {name: entry for name, entry in learned.items() if name not in there}
    if missing:
        edits.append((end, end, "".join(_added(missing, entries, indent))))
    return edits


def _end(key: yaml.Node, value: yaml.Node, lines: list[str]) -> int:
    """Return the line behind an entry: a block's mark is behind the blanks and comments that follow it."""
    last = value.end_mark.line if value.end_mark.column == 0 else value.end_mark.line + 1
    last = max(last, key.start_mark.line + 1)
    while last > key.start_mark.line + 1 and lines[last - 1].strip()[:1] in ("", "#"):
        last -= 1
    return last


def _merged(value: yaml.Node, entry: Entry) -> Entry | None:
    """Return an entry with what was learned; None if it says about the same already."""
    old: Entry = {}
    if isinstance(value, yaml.MappingNode):
        old = {key.value: _flow(inner) for key, inner in value.value}
    new = {**old, **entry}
    return None if all(key in old and _same(old[key], text) for key, text in new.items()) else new


def _flow(node: yaml.Node) -> str:
    """Return a node in one line."""
    if isinstance(node, yaml.SequenceNode):
        return f"[{', '.join(map(_flow, node.value))}]"
    if isinstance(node, yaml.MappingNode):
        return f"{{{', '.join(f'{_flow(key)}: {_flow(inner)}' for key, inner in node.value)}}}"
    assert isinstance(node, yaml.ScalarNode)
    plain = node.style is None and not any(letter in node.value for letter in ",[]{}#:\n")
    return str(node.value) if plain else json.dumps(node.value, ensure_ascii=False)


def _same(old: str, new: str) -> bool:
    try:
        before, after = float(old), float(new)
    except ValueError:
        return bool(yaml.safe_load(old) == yaml.safe_load(new))
    return abs(before - after) <= CLOSE * max(abs(before), abs(after))


def _added(learned: Mapping[str, Entry], entries: Entries, indent: str) -> list[str]:
    found = []
    for name, entry in learned.items():
        found += [f"{indent}# {comment(line)}\n" for line in entries.evidence[name]]
        found.append(f"{indent}{entry_line(name, entry)}\n")
    return found
