"""What else says how a robot is made, beside its live graph and its recordings: text in, values out.

    launch files (launch_files.py)      nodes, under which names, from which packages
    a dump of the graph                 `rosnode info`, `ros2 node info`, `rosgraph`, a .dot of rqt_graph, or
                                        the master's getSystemState as JSON
    analyzers of diagnostic_aggregator  statuses, by group

Each is put on top of what is known already (`Heard`), or stands alone.
"""

from __future__ import annotations

import json
import re
from collections.abc import Mapping
from dataclasses import replace
from fnmatch import fnmatchcase
from typing import Any

import yaml

from robomend.errors import InputError
from robomend.model.from_graph import comment, slug, word
from robomend.model.launch_files import Launched
from robomend_client.literals import holds
from robomend_client.ros_graph import Heard, HeardStatus, RosGraph

MOST_BYTES = 16 << 20
MOST_GROUPS = 2000


def with_launched(heard: Heard, launched: Launched) -> Heard:
    """Return what was heard with the nodes of a launch file, and what it leaves open."""
    unsure = "; it may not be started"
    nodes = {node.name: node.said + ("" if node.sure else unsure) for node in launched.nodes}
    return replace(
        heard,
        launched={**heard.launched, **nodes},
        remarks=(*heard.remarks, *launched.questions),
    )


def with_statuses(heard: Heard, statuses: Mapping[str, str]) -> Heard:
    """Return what was heard with the statuses that analyzers name, but for those that were heard."""
    named = {
        status: HeardStatus(frozenset({0}), frozenset())
        for status in statuses
        if not any(fnmatchcase(name.removeprefix("/"), status) for name in heard.statuses)
    }
    return replace(heard, statuses={**named, **heard.statuses})


# --- a dump of the graph ----------------------------------------------------------------------------------

NODE_LINE = re.compile(r"(?:Node \[(?P<ros1>[^\]]+)\]|(?P<plain>/\S+?)(?: :)?)\s*\Z")
PARTS = {
    "publications": "publishers", "publishers": "publishers", "outbound": "publishers",
    "subscriptions": "subscribers", "subscribers": "subscribers", "inbound": "subscribers",
    "services": "services", "service servers": "services",
}  # fmt: skip
NAMED = re.compile(r"\*?\s*(?P<name>/[^\s:\[]+)\s*(?::\s*(?P<kind2>\S+)|\[(?P<kind1>[^\]]+)\])?")
LABEL = re.compile(r"^\s*\"?([\w/.-]+)\"?\s*\[(.*)\]\s*;?\s*$", re.MULTILINE)
EDGE = re.compile(r"\"?([\w/.-]+)\"?\s*->\s*\"?([\w/.-]+)\"?(?:\s*\[(.*)\])?")
OF_LABEL = re.compile(r"\blabel=\"?([^\",\]]+)")


def read_dump(text: str, file: str) -> RosGraph:
    """Return the graph of a dump; InputError if it is none that is known."""
    if len(text) > MOST_BYTES:
        raise InputError(f"{file}: larger than {MOST_BYTES >> 20} MB")
    if text.lstrip()[:1] in ("[", "{"):
        found = _of_json(text, file)
    elif re.search(r"^\s*(?:strict\s+)?digraph\b", text, re.MULTILINE):
        found = _of_dot(text)
    else:
        found = _of_info(text)
    if not found.nodes:
        raise InputError(
            f"{file}: no graph that is known: `rosnode info`, `ros2 node info`, `rosgraph`, a .dot of "
            "rqt_graph, or the master's getSystemState as JSON"
        )
    return found


class _Tables:
    def __init__(self) -> None:
        self.of: dict[str, dict[str, set[str]]] = {"publishers": {}, "subscribers": {}, "services": {}}
        self.types: dict[str, str] = {}

    def add(self, table: str, name: str, node: str) -> None:
        self.of[table].setdefault(_slashed(name), set()).add(_slashed(node))

    def graph(self) -> RosGraph:
        tables = {
            table: {name: frozenset(nodes) for name, nodes in found.items()}
            for table, found in self.of.items()
        }
        whole = RosGraph(tables["publishers"], tables["subscribers"], tables["services"], self.types)
        return whole.renamed()


def _slashed(name: str) -> str:
    return "/" + name.strip().strip("/")


def _of_info(text: str) -> RosGraph:
    found, node, part = _Tables(), "", ""
    for line in text.splitlines():
        word = line.strip().rstrip(":").strip().lower().partition(" [")[0]
        if word in PARTS or word in ("connections", "pid", "nodes", "service clients", "action servers"):
            part = PARTS.get(word, "")
            continue
        if word.startswith(("contacting node", "pid:", "action clients")):
            part = ""
            continue
        named, begun = NAMED.match(line.strip()), NODE_LINE.match(line.strip())
        inside = line[:1] in (" ", "*", "\t") and not line.rstrip().endswith(" :")
        if named and part and node and inside:
            found.add(part, named["name"], node)
            kind = named["kind1"] or named["kind2"]
            if kind and kind != "unknown type" and part != "services":
                found.types[_slashed(named["name"])] = kind.replace("/msg/", "/")
        elif begun:
            node, part = begun["ros1"] or begun["plain"], ""
    return found.graph()


def _of_dot(text: str) -> RosGraph:
    found = _Tables()
    labels: dict[str, tuple[str, bool]] = {}  # id -> label, whether it is a topic
    for name, attributes in LABEL.findall(text):
        label = OF_LABEL.search(attributes)
        if label and "->" not in name:
            topic = "shape=box" in attributes or name.startswith("t_")
            labels[name] = label[1].strip(), topic
    for begin, end, attributes in EDGE.findall(text):
        (first, of_topic), (second, to_topic) = (labels.get(one, (one, False)) for one in (begin, end))
        label = OF_LABEL.search(attributes or "")
        if label and not of_topic and not to_topic:
            found.add("publishers", label[1], first)
            found.add("subscribers", label[1], second)
        elif to_topic and not of_topic:
            found.add("publishers", second, first)
        elif of_topic and not to_topic:
            found.add("subscribers", first, second)
    return found.graph()


def _of_json(text: str, file: str) -> RosGraph:
    found = _Tables()
    try:
        tree: Any = json.loads(text)
        if isinstance(tree, dict):
            tree = [tree.get(table) or {} for table in found.of]
        if len(tree) == 3 and isinstance(tree[0], int):  # code, message, the state
            tree = tree[2]
        for table, rows in zip(found.of, tree, strict=False):
            for name, nodes in rows.items() if isinstance(rows, dict) else rows:
                for node in nodes:
                    found.add(table, str(name), str(node))
    except (ValueError, TypeError, AttributeError, RecursionError) as error:
        raise InputError(f"{file}: no state of a master: {error}") from error
    return found.graph()


# --- analyzers --------------------------------------------------------------------------------------------


def read_analyzers(text: str, file: str) -> dict[str, str]:
    """Return the statuses that analyzers name, as names or patterns, with the path of each one's group.

    Raises:
        InputError: there are none.
    """
    if len(text) > MOST_BYTES:
        raise InputError(f"{file}: larger than {MOST_BYTES >> 20} MB")
    try:
        tree = yaml.safe_load(text)
    except (yaml.YAMLError, RecursionError) as error:
        raise InputError(f"{file}: {error}") from error
    found: dict[str, str] = {}
    _analyzers(tree, (), found, 0)
    if not found:
        raise InputError(f"{file}: no analyzers of diagnostic_aggregator are in it")
    return found


def _analyzers(tree: object, path: tuple[str, ...], found: dict[str, str], depth: int) -> None:
    if not isinstance(tree, dict) or depth > 30 or len(found) >= MOST_GROUPS:
        return
    here = (*path, str(tree["path"])) if isinstance(tree.get("path"), str) else path
    if "type" in tree:
        group = "/".join(here)
        for key, before, behind in (
            ("name", "", ""), ("expected", "", ""), ("startswith", "", "*"), ("contains", "*", "*"),
            ("find_and_remove_prefix", "", "*"),
        ):  # fmt: skip
            given = tree.get(key)
            for one in given if isinstance(given, list) else [] if given is None else [given]:
                if not (key == "name" and str(tree["type"]).endswith("AnalyzerGroup")):
                    found.setdefault(f"{before}{one}{behind}", group)
    for inner in tree.values():
        _analyzers(inner, here, found, depth + 1)


def model_of_groups(statuses: Mapping[str, str], name: str, source: str) -> str:
    """Return a model as YAML in which each group of statuses is a component: all that analyzers say alone."""
    parts: dict[str, str] = {}
    for group in dict.fromkeys(statuses.values()):
        parts[group] = slug(group.rpartition("/")[2] or group, parts.values())
    taken = set(parts.values())
    lines = [
        f"# A first model of {comment(name)}, from {comment(source)}: each group of statuses is a component.",
        "# Which nodes there are, and what they publish, no analyzer says.",
        "robomend: 1",
        f"name: {word(name)}",
        "",
        "hardware:",
        *(f"  {word(part)}: {{}}    # {comment(group)}" for group, part in parts.items()),
        "",
        "properties:                   # what is said on /diagnostics",
    ]
    rules = []
    for status, group in statuses.items():
        said = slug(status, taken)
        taken.add(said)
        lines.append(f"  {word(said)}: {{}}    # {comment(status)}")
        rules.append(f"  - 'not ab({word(parts[group])}) -> {holds('ok', said)}'")
    return "\n".join([*lines, "", "rules:", *rules]) + "\n"
