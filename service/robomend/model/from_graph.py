"""A first model from a ROS graph: a graph in, YAML with comments out. Nothing is looked up, nothing is kept.

    node that publishes          → a node with its topics; without inputs it is probably a driver
    topic that it listens to     → an input of all that it publishes: a guess, which the comment says
    topics of ROS itself, of actions, of several publishers → left out, and listed at the end

So it serves ROS 1, ROS 2 and bags alike; whoever reads the graph knows where it is from.
"""

from __future__ import annotations

import json
import re
from collections.abc import Iterable, Iterator
from dataclasses import replace
from fnmatch import fnmatchcase

from robomend.errors import InputError
from robomend.model.component_yaml import MAX_NAME
from robomend_client.literals import PLAIN_NAME
from robomend_client.ros_graph import RosGraph, Table

TOOLS = (
    *("/rosout", "/robomend*", "/record_*", "/play_*", "/rostopic_*", "/rosservice_*", "/rqt_*"),
    *("/rviz_[0-9]*", "/_ros2cli*", "/launch_ros*", "/roslaunch*", "/transform_listener_impl*"),
)
"""Nodes that come and go with whoever looks at the robot."""

PLUMBING = (
    *("/rosout", "/rosout_agg", "/clock", "/statistics", "/diagnostics*", "/parameter_events"),
    *("*/parameter_updates", "*/parameter_descriptions", "/ros_discovery_info"),
    *("/observations", "/diagnosis", "/board_measurments"),
)
"""Topics of ROS and of robomend, which say nothing about the robot's own work."""

ACTION = re.compile(r"(?:Action(?:Goal|Result|Feedback)|actionlib_msgs/(?:msg/)?\w+)\Z")
"""Types of topics that are published when somebody acts."""

YAML_WORD = re.compile(r"[A-Za-z_][A-Za-z0-9_./-]*\Z")


def model_from_graph(graph: RosGraph, name: str, source: str) -> str:
    """Return a model of the robot as YAML.

    Args:
        name: of the model.
        source: where the graph is from, for people.

    Raises:
        InputError: no node in it is the robot's own.
    """
    graph = _legal(graph)
    topics = _topics(graph)
    nodes = sorted(node for node in graph.nodes if not _is_any_of(node, TOOLS))
    if not nodes:
        raise InputError(f"{source}: there is no node of the robot's own, of {len(graph.nodes)}")
    lines = [
        f"# A first model of {_comment(name)}, from {_comment(source)}.",
        "# It is a proposal: go through it, then `robomend model check FILE`, then `robomend compile FILE`.",
        "robomend: 1",
        f"name: {_word(name)}",
        "",
        "# hardware:                   # your devices; `channel:` if a power board switches them",
        "#   lidar: {channel: 3}       # then say which node drives it: drives: [lidar]",
        "",
        "nodes:",
        *_nodes(graph, nodes, topics),
    ]
    rated = [topic for topic in sorted(topics) if topic in graph.rates_hz]
    if rated:
        lines += ["", "topics:                       # rates as they were there"]
        lines += [f"  {_word(topic)}: {_rate(graph.rates_hz[topic])}" for topic in rated]
    else:
        lines += ["", "# topics:                     # the rate of messages, and how far it may stray"]
        lines += [f"#   {_word(topic)}: {{rate_hz: 10, tolerance_hz: 1}}" for topic in sorted(topics)[:3]]
    lines += _left_out(graph, topics)
    return "\n".join(lines) + "\n"


def _legal(graph: RosGraph) -> RosGraph:
    """Return the graph without names that no model can have; ROS has none, recordings may."""

    def table(found: Table) -> Table:
        whole: dict[str, frozenset[str]] = {}
        for name, nodes in found.items():
            if _is_name(name):
                key = "/" + name.strip("/")
                legal = frozenset("/" + node.strip("/") for node in nodes if _is_name(node))
                whole[key] = whole.get(key, frozenset()) | legal
        return whole

    return replace(
        graph,
        publishers=table(graph.publishers),
        subscribers=table(graph.subscribers),
        services=table(graph.services),
    )


def _is_name(name: str) -> bool:
    return name.isprintable() and bool(name.strip("/")) and len(name) <= MAX_NAME


def _topics(graph: RosGraph) -> dict[str, str]:
    """Return the topics that the model speaks of, each with its one publisher."""
    found = {}
    for topic, publishers in graph.publishers.items():
        ours = [node for node in publishers if not _is_any_of(node, TOOLS)]
        if len(ours) == 1 and not _is_aside(topic, graph):
            found[topic] = ours[0]
    return found


def is_plumbing(topic: str) -> bool:
    """Whether a topic is one of ROS itself, or ours."""
    return _is_any_of(topic, PLUMBING)


def _is_aside(topic: str, graph: RosGraph) -> bool:
    return is_plumbing(topic) or bool(ACTION.search(graph.types.get(topic, "")))


def _nodes(graph: RosGraph, nodes: Iterable[str], topics: dict[str, str]) -> Iterator[str]:
    for node in nodes:
        outputs = sorted(topic for topic, publisher in topics.items() if publisher == node)
        inputs = sorted(t for t, listeners in graph.subscribers.items() if node in listeners and t in topics)
        inputs = [topic for topic in inputs if topic not in outputs]
        if not outputs:
            why = "publishes nothing that the model speaks of"
            heard = f", listens to {', '.join(_comment(topic) for topic in inputs)}" if inputs else ""
            yield f"  {_word(node)}: {{}}    # {why}{heard}"
            continue
        hint = "listens to nothing: probably a driver; of which device?" if not inputs else ""
        hint = hint or "all that it publishes rests on all that it listens to: strike out what does not"
        yield f"  {_word(node)}:    # {hint}"
        if not inputs:
            yield "    # drives: []"
        yield "    publishes:"
        for topic in outputs:
            kind = graph.types.get(topic)
            rests_on = ", ".join(map(_word, inputs))
            yield f"      {_word(topic)}: [{rests_on}]" + (f"    # {_comment(kind)}" if kind else "")


def _left_out(graph: RosGraph, topics: dict[str, str]) -> list[str]:
    """Return comments on what the model does not speak of."""
    shared, asked, silent = [], [], []
    for topic in sorted(graph.publishers.keys() | graph.subscribers.keys()):
        ours = [node for node in graph.publishers.get(topic, ()) if not _is_any_of(node, TOOLS)]
        if topic in topics or is_plumbing(topic):
            continue
        if ACTION.search(graph.types.get(topic, "")):
            asked.append(_comment(topic))
        elif len(ours) > 1:
            shared.append(f"{_comment(topic)} ({', '.join(_comment(node) for node in sorted(ours))})")
        elif not ours:
            silent.append(_comment(topic))
    lines = []
    for what, found in (
        ("Topics of several publishers: the silence of one does not show", shared),
        ("Topics of actions: there are messages when somebody acts", asked),
        ("Topics that no node of the robot publishes: tools do, or nobody", silent),
    ):
        if found:
            lines += ["", f"# {what}:", *(f"#   {line}" for line in found)]
    return lines


def _is_any_of(name: str, patterns: Iterable[str]) -> bool:
    return any(fnmatchcase(name, pattern) for pattern in patterns)


def _rate(rate_hz: float) -> str:
    return f"{{rate_hz: {rate_hz:.3g}, tolerance_hz: {rate_hz / 10:.2g}}}"


def _word(name: str) -> str:
    """Return a name as YAML has it, without the leading slash."""
    name = name.removeprefix("/")
    return name if YAML_WORD.match(name) and PLAIN_NAME.match(name) else json.dumps(name, ensure_ascii=False)


def _comment(text: str) -> str:
    """Return a text in which nothing ends the comment."""
    return "".join(letter if letter.isprintable() else "?" for letter in text.removeprefix("/"))
