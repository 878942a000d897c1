"""The drafted model: the graph that the logs show, and what the observers speak of besides topics."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field

from robomend.model.from_graph import is_plumbing, model_from_graph, rests, word
from robomend.model.loading import load_text
from robomend_batch.learn.delays import DelayFound
from robomend_batch.learn.gathering import DIAGNOSTICS, UNNAMED, Topic
from robomend_batch.learn.words import comment
from robomend_client.literals import holds
from robomend_client.ros_graph import Ear, HeardTopic, RosGraph

REPLAYED = "/play_"


@dataclass
class Declared:
    """What a model declares beside nodes and topics."""

    properties: dict[str, str] = field(default_factory=dict)  # name -> the node to blame, with its slash
    values: dict[str, tuple[str, str]] = field(default_factory=dict)  # name -> topic, field
    related: list[tuple[str, str]] = field(default_factory=list)


@dataclass(frozen=True, slots=True)
class Links:
    """What topics and nodes have to do with each other."""

    delays: Sequence[DelayFound]
    together: Sequence[tuple[str, str]]
    live: RosGraph  # of the running robot, if it was asked
    recorded: Collection[str]  # nodes that a recording names without their topics


def publishers_of(topics: Iterable[Topic], live: RosGraph) -> dict[str, frozenset[str]]:
    """Return the nodes that publish a topic: as the logs say, or else the running robot.

    One that neither names has a name that asks for it, but for those of ROS itself.
    """
    found = {}
    for topic in topics:
        named = frozenset(node for node in topic.publishers if not node.startswith(REPLAYED))
        named = named or live.publishers.get(f"/{topic.name}", frozenset())
        if not named and (topic.name == DIAGNOSTICS or not is_plumbing(f"/{topic.name}")):
            named = frozenset({UNNAMED + topic.name})
        found[topic.name] = named
    return found


def draft_model(
    name: str,
    source: str,
    topics: Mapping[str, Topic],
    publishers: Mapping[str, frozenset[str]],
    links: Links,
    declared: Declared,
) -> str:
    """Return the model as YAML.

    Raises:
        InputError: the logs show no node of the robot's own.
    """
    nodes = dict(publishers)
    listeners: dict[str, set[str]] = {}
    for delay, answering in _guessed(publishers, links):
        for heard in (delay.in_topic, *delay.more):
            listeners.setdefault("/" + heard, set()).update(answering)
    own = frozenset(node for found in publishers.values() for node in found)  # the recorder listens to all
    for topic in publishers:
        heard_by = links.live.subscribers.get(f"/{topic}", frozenset())
        resting = {node for node in own & heard_by if _rests(node, topic, topics, publishers)}
        listeners.setdefault(f"/{topic}", set()).update(resting)
    blamed = frozenset(declared.properties.values()) | nodes.get(DIAGNOSTICS, frozenset())
    if blamed:
        nodes[DIAGNOSTICS] = frozenset(node for node in blamed if not node.startswith(UNNAMED + DIAGNOSTICS))
    graph = RosGraph(
        {f"/{topic}": found for topic, found in nodes.items()},
        {topic: frozenset(found) for topic, found in listeners.items()},
        types={f"/{topic.name}": sorted(topic.types)[0].replace("/msg/", "/") for topic in topics.values()},
    )
    text = model_from_graph(graph, name, source)
    return text + "".join(f"{line}\n" for line in (*_questions(publishers, links), *_declared(declared)))


def _rests(
    node: str, given: str, topics: Mapping[str, Topic], publishers: Mapping[str, frozenset[str]]
) -> bool:
    """Return whether anything that a node publishes may rest on a topic: not on one that never came, nor on
    one without which all of it went on. So circles of a graph are cut in which nothing flowed.
    """
    if not topics[given].count:
        return False
    outputs = [topics[name] for name, nodes in publishers.items() if node in nodes and topics[name].count]
    return not outputs or any(rests(_ear(topics[given]), _ear(one)) is not False for one in outputs)


def _ear(topic: Topic) -> HeardTopic:
    return Ear(time_ns for log in sorted(topic.times) for time_ns in topic.of_log(log).tolist()).heard()


def declared_topics(model: str) -> frozenset[str]:
    """Return the topics that a drafted model speaks of, as its ok(…) atoms."""
    system = load_text(model)
    return frozenset(
        atom.args[0] for atom in system.cnf.atoms if atom.predicate == "ok" and len(atom.args) == 1
    )


def _guessed(
    publishers: Mapping[str, frozenset[str]], links: Links
) -> list[tuple[DelayFound, frozenset[str]]]:
    """Return what answers what by times, and the nodes of which nobody knows better what they listen to."""
    of_delays = [(delay, publishers[delay.out_topic] - links.live.nodes) for delay in links.delays]
    return [(delay, answering) for delay, answering in of_delays if answering]


def _questions(publishers: Mapping[str, frozenset[str]], links: Links) -> list[str]:
    lines = [
        "",
        "# Which device does each driver drive, and on which channel of a power board is it? No log says:",
        "# name them under `hardware:`, and in `drives:` of their nodes.",
    ]
    unnamed = sorted(t for t, nodes in publishers.items() if any(n.startswith(UNNAMED) for n in nodes))
    if unnamed:
        lines += [
            "#",
            "# Who publishes these topics? The recording does not say: each has a node of its own",
            *(f"#   {comment(topic)}: {comment(UNNAMED[1:] + topic)}" for topic in unnamed),
        ]
        if links.recorded:
            lines += ["# Nodes that it names, without their topics:"]
            lines += [f"#   {comment(node.removeprefix('/'))}" for node in sorted(links.recorded)]
    if links.together:
        lines += ["#", "# Sent within a moment of each other: are they of one node?"]
        lines += [f"#   {comment(first)}, {comment(second)}" for first, second in links.together]
    guessed = _guessed(publishers, links)
    if guessed:
        lines += ["#", "# Who listens to what? Seen from times alone; is it so?"]
        for one, _ in guessed:
            heard = ", ".join((one.in_topic, *one.more))
            lines.append(
                f"#   {comment(one.out_topic)} answers {comment(heard)} after {one.usual_s * 1000:.3g} ms "
                f"(intervals alike by {one.likeness:.2f})"
            )
    return lines


def _declared(declared: Declared) -> list[str]:
    lines: list[str] = []
    if declared.properties:
        lines += ["", "properties:", *(f"  {word(name)}: {{}}" for name in declared.properties)]
    if declared.values:
        lines += ["", "values:"]
        lines += [
            f"  {word(name)}: {{topic: {word(topic)}, field: {word(path)}}}"
            for name, (topic, path) in declared.values.items()
        ]
        lines += ["related:", *(f"  - [{word(a)}, {word(b)}]" for a, b in declared.related)]
    if declared.properties:
        lines += ["", "rules:"]
        for name, node in declared.properties.items():
            rule = f"not ab({word(node.removeprefix('/'))}) -> {holds('ok', name)}"
            lines.append(f"  - {_quoted(rule)}")
    return lines


def _quoted(text: str) -> str:
    return "'" + text.replace("'", "''") + "'"
