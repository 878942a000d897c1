"""A first model from what was heard of a robot: a value in, YAML with comments out. Nothing is looked up.

    node that publishes          → a node with its topics; without inputs it is probably a driver
    topic that it listens to     → an input of what it publishes: believed, unless the times contradict it
    topic that came steadily     → its rate; what is kept for later comers is `latched`, the rest is `silent`
    topics of ROS itself, of actions, of several publishers → left out, and listed at the end

So it serves ROS 1, ROS 2, recordings and graphs of which nothing was heard; whoever made the value knows
where it is from. What was heard for a minute has plain bounds (`steady`), which what an agent heard since may
make tighter (`tighter`); long recordings bring learned ones along (`Heard.learned`).
"""

from __future__ import annotations

import json
import re
from collections import Counter
from collections.abc import Collection, Iterable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from fnmatch import fnmatchcase
from glob import escape
from itertools import pairwise
from math import ceil
from typing import NamedTuple

from robomend.errors import InputError
from robomend.model.component_yaml import MAX_NAME
from robomend_client.counts import counted
from robomend_client.literals import PLAIN_NAME, holds
from robomend_client.ros_graph import Heard, HeardTopic, Learned, RosGraph, SteadyTopic, Table, UsualRate

TOOLS = (
    *("/rosout", "/robomend*", "/record_*", "/play_*", "/rostopic_*", "/rosservice_*", "/rqt_*", "/rqt"),
    *("/record", "/play", "/rostopic", "/rviz", "/rviz2", "/rviz_[0-9]*", "/rviz2_*", "/foxglove_bridge*"),
    *(
        "/_ros2cli*",
        "/launch_ros*",
        "/roslaunch*",
        "/*transform_listener_impl*",
        "/rosbag2_*",
        "/unknown_node",
    ),
    *("/*spawner*", "*/spawn_*", "*/map_saver*"),
)
"""Nodes that come and go with whoever looks at the robot, or end by design when they have done their work; in
ROS 2 also those that are of no node.
"""

TOOL_PACKAGES = re.compile(r"(?:rosbag|rviz|rqt|plotjuggler|foxglove_bridge)[^/]*/")
"""Of what a launch file starts, under whatever name."""

PLUMBING = (
    *("/rosout", "/rosout_agg", "/clock", "/statistics", "*/diagnostics", "*/diagnostics_agg"),
    *("/diagnostics_toplevel_state", "/parameter_events", "*/parameter_updates", "*/parameter_descriptions"),
    *("/ros_discovery_info", "/observations", "/diagnosis", "/board_measurments", "*/transition_event"),
    *("*/robot_description", "*/tf_static", "*/bond", "/events/*"),
)
"""Topics of ROS and of robomend, which say nothing about the robot's own work."""

OUR_STATUS = "robomend: "
"""Begins the names of the statuses in which an agent tells ROS of the diagnosis."""

ACTION = re.compile(r"(?:Action(?:Goal|Result|Feedback)|actionlib_msgs/(?:msg/)?\w+)\Z")
"""Types of topics that are published when somebody acts."""

COMMAND = re.compile(
    r"(?:Twist(?:Stamped)?|AckermannDrive(?:Stamped)?|JointTrajectory|JointJog|cmd\w*)\Z", re.I
)
STATE = re.compile(
    r"(?:Odometry|JointState|DynamicJointState|BatteryState|Imu|LaserScan|PointCloud2?|Image|CompressedImage"
    r"|CameraInfo|NavSatFix|MagneticField|Range|Temperature|WrenchStamped)\Z"
)
"""Types of what a robot is told to do, and of what its devices say: the one does not rest on the other."""

LOAD_NODELET = "/load_nodelet"
"""Ends the service of ROS 1 by which a node takes nodelets in."""

YAML_WORD = re.compile(r"[A-Za-z_][A-Za-z0-9_./-]*\Z")
RESERVED = frozenset(("true", "false", "yes", "no", "on", "off", "null", "y", "n"))

LEAST_MESSAGES = 5
LEAST_SPAN_S = 1.0
"""What came for less is one burst: no rate is told from it."""

QUIET_S, QUIET_INTERVALS = 3.0, 10
"""What did not come for so long at the end of the listening had stopped."""

LATE_S = 1.0
"""What begins later in a recording was seen to take its time, and may take twice of it."""

SLOWER, FASTER = 0.4, 0.6
"""Of the rate: how far it may stray."""

WINDOW_S, LEAST_WINDOW = 3.0, 10
VERDICT_S = 2.5
"""So much of a topic a first verdict rests on, and no less than an interval."""

SILENCE_S, SILENCE_INTERVALS, SILENCE_GAPS = 2.0, 10, 3
"""Reliable delivery keeps back what follows a lost message until that was sent again: a good second."""

LONGEST_SILENCE_S = 60.0
IRREGULAR = 100.0
"""Usual intervals that silence may last, and LONGEST_SILENCE_S: what bursts more is not watched."""

SEEN = 0.25
"""Beyond the slowest and the fastest that was seen of a healthy robot, as on a busy computer."""

LONG_GAP_S, LONG_GAP_INTERVALS, WENT_ON = 3.0, 10, 3
"""An output that went on, for so many messages, through such a pause of an input does not rest on it."""

LONGEST_CHAIN = 50
"""Topics, one resting on the other: so far their silences are put in order."""

MANY_INPUTS = 4
"""Of a node that listens to more, only what its times show is believed, if they show any."""

ALIKE, LEAST_PAIRS = 0.5, 30
"""Correlation of intervals from which on one topic is seen to follow another."""

MOST_OPEN = 5
"""Remarks that are said where there is no model to write them into."""

MOST_LOGS = 100
"""Nodes whose logs are watched: each line is looked at for each of them."""

STILL_S, STILL_INTERVALS = 4.0, 20
"""A value that has noise stands still when it is the same for so long."""

USUAL_S = 3600.0
"""From so much of a topic on that was well, its bounds may be tighter than a first minute says."""

ALIKE_WINDOWS = (0.8, 1.2)
"""Of the window: rates of others say nothing of it."""

LEAST_SILENCE_S, LEAST_INTERVALS = 0.35, 5
BEYOND = 0.1
WORTH = 0.2
"""It is asked for no less than a bound that is tighter by so much."""

TIGHTER = "of listening allow tighter bounds"

LISTENED = "It was made by listening for {} s"
DRIVES = "    # drives: []"
QUESTIONS = "# Questions that "
"""By them the questions of a model are found again (answers.py)."""

SIGNS = {
    "goals": "no goal is aborted",
    "lifecycle": "it stays active, once it was seen to become so",
    "rosout": "it logs no ERROR; it logged none",
    "changing": "its values have noise: they were never twice the same",
    "qos": "publisher and subscribers fit, as they did",
}
"""What is told by observers of these kinds."""

NAMED = {"rosout": "log", "changing": "values"}
"""How what these observe is called, where the kind's name would not say it: `planner_log`, `scan_values`."""


STATUS_LIFE_S, STATUS_GAPS = 5.0, 3

Entry = dict[str, str]
"""Key -> value, as YAML has them."""


@dataclass
class Entries:
    """Observers, and the evidence of each."""

    topics: dict[str, Entry] = field(default_factory=dict)
    observers: dict[str, Entry] = field(default_factory=dict)
    evidence: dict[str, list[str]] = field(default_factory=dict)  # by the entry's name
    left_out: list[tuple[str, str]] = field(default_factory=list)  # what is not observed, and why
    doubtful: dict[str, tuple[str, Entry, str]] = field(default_factory=dict)  # section, entry, why: comments

    @property
    def names(self) -> list[str]:
        """Of all entries."""
        return [*self.topics, *self.observers]

    def doubt(self, name: str, why: str) -> None:
        """Leave an entry in the file as a comment only."""
        section = "topics" if name in self.topics else "observers"
        entry = (self.topics if name in self.topics else self.observers).pop(name)
        self.doubtful[name] = section, entry, why

    def take(self, name: str, other: Entries) -> None:
        """Take an entry, with its evidence, as others have it."""
        for mine, theirs in ((self.topics, other.topics), (self.observers, other.observers)):
            if name in mine and name in theirs:
                mine[name] = theirs[name]
                self.evidence[name] = [*other.evidence[name], "learned from all of the logs"]


@dataclass(frozen=True)
class FirstModel:
    """What was made of what was heard: the model, and what else the robot's files say."""

    text: str
    nodes: tuple[str, ...]  # whose names are known; they are as the model has them from here on
    watched: Mapping[str, SteadyTopic] = field(default_factory=dict)  # topic -> its rate
    entries: Entries = field(default_factory=Entries)  # its observers
    asked: tuple[str, ...] = ()  # questions that listening did not answer
    offered: tuple[str, ...] = ()  # remedies that nodes offer, as commented lines of an agent's file


def first_model(heard: Heard, name: str) -> FirstModel:
    """Return a first model of the robot.

    Raises:
        InputError: no node that was heard is the robot's own.
    """
    return _Draft(heard, name).made()


def steady(heard: HeardTopic, ended_ns: int) -> SteadyTopic | str:
    """Return the rate of a topic by plain rules, or why it has none.

    Args:
        ended_ns: when the listening ended.
    """
    if heard.count < LEAST_MESSAGES:
        return counted(heard.count, "message") if heard.count else "silent"
    rate_hz, usual_s = heard.rate_hz, heard.usual_s
    quiet_s = (ended_ns - heard.last_ns) / 1e9
    if not rate_hz or not usual_s:
        return "its messages come several at once"
    if heard.span_s < LEAST_SPAN_S:
        return f"{counted(heard.count, 'message')} within {seconds_told(heard.span_s)}"
    if quiet_s > max(QUIET_S, QUIET_INTERVALS * usual_s, SILENCE_GAPS * heard.longest_s):
        return f"{counted(heard.count, 'message')}, and then silent for {quiet_s:.3g} s"
    silence_s = max(SILENCE_S, SILENCE_INTERVALS / rate_hz, SILENCE_GAPS * heard.longest_s)
    if silence_s > max(LONGEST_SILENCE_S, IRREGULAR * usual_s):
        return f"irregular: usually {usual_s:.3g} s apart, and up to {heard.longest_s:.3g} s"
    window = min(max(LEAST_WINDOW, ceil(WINDOW_S * rate_hz)), 10_000)
    pause_s = max(WINDOW_S / 4, 4 / rate_hz)
    slowest_hz, fastest_hz = _extremes(heard.stamps, window, pause_s) or (rate_hz, rate_hz)
    lowest_hz = min((1 - SLOWER) * rate_hz, (1 - SEEN) * slowest_hz)
    highest_hz = max((1 + FASTER) * max(rate_hz, 1 / usual_s), (1 + SEEN) * fastest_hz)
    why = (
        f"{counted(heard.count, 'message')} in {heard.span_s:.3g} s; intervals: median "
        f"{seconds_told(usual_s)}, longest {seconds_told(heard.longest_s)}; windows of {window}: "
        f"{slowest_hz:.3g} to {fastest_hz:.3g} Hz"
    )
    return SteadyTopic(
        rate_hz,
        rate_hz - lowest_hz,
        highest_hz - rate_hz,
        window,
        max(1, min(window - 1, int(VERDICT_S * rate_hz))),
        silence_s,
        pause_s if pause_s < silence_s else None,
        (why, *([f"began after {heard.wait_s:.3g} s at most"] if heard.wait_s > LATE_S else [])),
        2 * heard.wait_s if heard.wait_s > LATE_S else None,
    )


def tighter(steady: SteadyTopic, usual: UsualRate) -> SteadyTopic:
    """Return the bounds that a long time allows, no wider than they were; the same where it was too short."""
    alike = ALIKE_WINDOWS[0] * steady.window <= usual.window <= ALIKE_WINDOWS[1] * steady.window
    if usual.seconds < USUAL_S or not alike or not usual.slowest_hz:
        return steady
    rate_hz = steady.rate_hz
    silence_s = max(LEAST_SILENCE_S, LEAST_INTERVALS / rate_hz, SILENCE_GAPS * usual.longest_s)
    silence_s = min(steady.silence_s, silence_s)
    # Beyond what was ever seen by half of how far that strayed, and a tenth of the rate.
    lowest_hz = usual.slowest_hz - (rate_hz - usual.slowest_hz) / 2 - BEYOND * rate_hz
    highest_hz = usual.fastest_hz + (usual.fastest_hz - rate_hz) / 2 + BEYOND * rate_hz
    why = (
        f"in {_long(usual.seconds)} since: longest {seconds_told(usual.longest_s)}, "
        f"windows {usual.slowest_hz:.3g} to {usual.fastest_hz:.3g} Hz"
    )
    return replace(
        steady,
        tolerance_hz=min(steady.tolerance_hz, max(BEYOND * rate_hz, rate_hz - lowest_hz)),
        above_hz=min(steady.above_hz, max(BEYOND * rate_hz, highest_hz - rate_hz)),
        silence_s=silence_s,
        pause_s=steady.pause_s if steady.pause_s is not None and steady.pause_s < silence_s else None,
        why=(*steady.why, why),
    )


def tighter_question(first: FirstModel, usual: Mapping[str, UsualRate]) -> str:
    """Return what is asked of a person before bounds get tighter by what an agent heard; nothing: none do."""
    found = {
        topic: (steady, new)
        for topic, steady in first.watched.items()
        if topic in usual
        and (new := tighter(steady, usual[topic])) is not steady
        and (
            new.silence_s < (1 - WORTH) * steady.silence_s
            or new.tolerance_hz < (1 - WORTH) * steady.tolerance_hz
            or new.above_hz < (1 - WORTH) * steady.above_hz
        )
    }
    if not found:
        return ""
    topic, (old, new) = max(found.items(), key=lambda one: one[1][0].silence_s / one[1][1].silence_s)
    more = f", and of {len(found) - 1} more" if len(found) > 1 else ""
    said = f"{topic}: silence after {new.silence_s:.2g} s, now {old.silence_s:.2g} s"
    return f"{_long(max(one.seconds for one in usual.values()))} {TIGHTER} ({said}{more}): write them?"


def _long(seconds: float) -> str:
    return f"{seconds / 3600:.0f} h" if seconds >= 3600 else f"{seconds / 60:.0f} min"


def _extremes(stamps: tuple[int, ...], window: int, pause_s: float) -> tuple[float, float] | None:
    """Return the slowest and the fastest rate of windows of so many messages, in which longer intervals count
    as a pause; None: there is no such window.
    """
    counted_ns = [0]
    for early, late in pairwise(stamps):
        counted_ns.append(counted_ns[-1] + min(late - early, round(pause_s * 1e9)))
    spans = [late - early for early, late in zip(counted_ns, counted_ns[window - 1 :], strict=False)]
    if not spans:
        return None
    return (window - 1) * 1e9 / max(spans), (window - 1) * 1e9 / max(min(spans), max(spans) // 100, 1)


def rests(given: HeardTopic, output: HeardTopic) -> bool | None:
    """Return whether the times show that an output rests on an input, or that it does not; None: neither."""
    gap_ns = max(LONG_GAP_S, LONG_GAP_INTERVALS * given.usual_s) * 1e9
    margin_ns = given.usual_s * 1e9
    for early, late in pairwise(given.stamps):
        if late - early > gap_ns:
            on = sum(early + margin_ns < time_ns < late for time_ns in output.stamps)
            if on >= WENT_ON:
                return False
    pairs: list[tuple[int, int]] = []
    number = 0
    for time_ns in output.stamps:
        while number < len(given.stamps) and given.stamps[number] <= time_ns:
            number += 1
        if number and (not pairs or pairs[-1][0] != given.stamps[number - 1]):
            pairs.append((given.stamps[number - 1], time_ns))
    if len(pairs) <= LEAST_PAIRS or len(pairs) < 0.8 * len(output.stamps):
        return None
    before = [late[0] - early[0] for early, late in pairwise(pairs)]
    after = [late[1] - early[1] for early, late in pairwise(pairs)]
    return True if _correlation(before, after) >= ALIKE else None


def _correlation(first: list[int], second: list[int]) -> float:
    """Return Pearson's, 0 where one of them does not vary."""
    mean1, mean2 = sum(first) / len(first), sum(second) / len(second)
    both = sum((a - mean1) * (b - mean2) for a, b in zip(first, second, strict=True))
    square1, square2 = sum((a - mean1) ** 2 for a in first), sum((b - mean2) ** 2 for b in second)
    return both / (square1 * square2) ** 0.5 if square1 and square2 else 0.0


class _Draft:
    """One model in the making; names are as ROS has them until they are written."""

    def __init__(self, heard: Heard, name: str) -> None:
        self.heard = heard
        self.name = name
        self.listened = heard.seconds > 0
        self.learned = heard.learned or Learned()
        self.graph = _legal(heard.graph)
        gone = {node for node in heard.gone if not _is_any_of(node, TOOLS)}
        self.loaders = _loaders(self.graph) - gone
        launched = {name for name in heard.launched if _is_name(name)}
        tools = {name for name in launched if TOOL_PACKAGES.match(heard.launched[name]) or is_tool(name)}
        # What was looked for and is not there is no component: it would be missed from the first moment on.
        here = self.graph.nodes or launched
        self.missing = sorted(launched - here - tools)
        self.nodes = sorted(node for node in here - gone - tools - self.loaders if not is_tool(node))
        if not self.nodes:
            others = ", ".join(sorted({*self.graph.nodes, *launched})[:5])
            beside = f", only tools or what had ended: {others}" if others else ""
            open_ = "".join(f"; {remark}" for remark in heard.remarks[:MOST_OPEN])
            raise InputError(f"{heard.source}: there is no node of the robot's own{beside}{open_}")
        self.named = [node for node in self.nodes if node not in heard.unnamed]
        self.topics = _spoken(self.graph, gone)
        found = {topic: self._rate_of(topic) for topic in self.topics if self.listened}
        usual = {f"/{topic}": one for topic, one in heard.usual.items()}
        self.steady = {
            topic: tighter(one, usual[topic]) if topic in usual else one
            for topic, one in found.items()
            if isinstance(one, SteadyTopic)
        }
        self.why_not = {topic: one for topic, one in found.items() if isinstance(one, str)}
        self.asked: list[str] = []
        self.gone = gone
        self.rests_on = {topic: self._inputs(node, topic) for topic, node in self.topics.items()}
        self._wait_for_causes()
        self.meetings: dict[str, str] = {}  # topic -> what says that it reaches those who listen

    def made(self) -> FirstModel:
        heard = self.heard
        statuses, blamed = self._statuses()
        blamed |= self.learned.blamed
        signs = self._signs(blamed)
        lines = [f"# A first model of {comment(self.name)}, from {comment(heard.source)}."]
        if self.listened:
            lines += [
                f"# {LISTENED.format(f'{heard.seconds:.0f}')}: what a number rests on is beside it.",
                "# What listening does not tell is asked at the end. `robomend model check FILE` checks it.",
            ]
        else:
            then = "then `robomend model check FILE`, then `robomend compile FILE`."
            lines.append(f"# It is a proposal: go through it, {then}")
        lines += [
            "robomend: 1",
            f"name: {word(self.name)}",
            "",
            "# hardware:                   # your devices; `channel:` if a power board switches them",
            "#   lidar: {channel: 3}       # then say which node drives it: drives: [lidar]",
            *self._devices(),
            "",
            "nodes:",
            *self._nodes(),
            *self._rates(),
        ]
        if blamed:
            said = {name: comment(status) for name, status in statuses.items()}
            own = signs.keys() - self.meetings.values()
            said |= dict.fromkeys(self.learned.blamed, "its bounds are learned")
            said |= {name: SIGNS[keys["kind"]] for name, keys in signs.items() if name in own}
            managed = self._managed(signs, blamed)
            for manager, whole in managed.values():
                said[whole] = f"nobody reports it: {comment(manager)} takes all down when one of them fails"
            if said:
                lines += ["", "properties:                   # what nodes say of themselves"]
                lines += [f"  {word(name)}: {{}}    # {why}" for name, why in said.items()]
        else:
            managed = {}
        if self.learned.values:
            lines += ["", "values:                       # whose trends are alike"]
            for name, (topic, path) in self.learned.values.items():
                lines.append(f"  {word(name)}: {{topic: {word(topic)}, field: {word(path)}}}")
            lines += ["related:", *(f"  - [{word(a)}, {word(b)}]" for a, b in self.learned.related)]
        if blamed:
            lines += ["", "rules:", *(f"  - {_quoted(rule)}" for rule in _rules(blamed, managed))]
        offered = [one for one in offered_remedies(self.graph) if one.node in self.nodes]
        if offered:
            lines += [
                "",
                "# remedies:                   # what nodes offer against their own faults",
            ]
            lines += [one.model for one in offered]
        lines += self._left_out()
        self._ask()
        if self.asked and (self.listened or heard.launched):
            what = "listening does" if self.listened else "its sources do"
            lines += ["", f"{QUESTIONS}{what} not answer:"]
            lines += [f"#   {comment(question)}" for question in self.asked]
        return FirstModel(
            "\n".join(lines) + "\n",
            tuple(node.removeprefix("/") for node in self.named),
            {topic.removeprefix("/"): one for topic, one in self.steady.items()},
            self._entries(statuses, signs),
            tuple(self.asked),
            tuple(one.action for one in offered),
        )

    # --- what it speaks of -----------------------------------------------------------------------------

    def _rate_of(self, topic: str) -> SteadyTopic | str:
        if self.heard.learned is None:
            return steady(self._of(topic), self.heard.ended_ns)
        return self.learned.rates.get(topic, "silent")

    def _of(self, topic: str) -> HeardTopic:
        return self.heard.topics.get(topic, HeardTopic())

    def _kind(self, topic: str) -> str:
        return self.graph.types.get(topic, "").rpartition("/")[2]

    def _listens(self, node: str) -> list[str]:
        """Return the topics of others that a node listens to."""
        heard = (topic for topic, listeners in self.graph.subscribers.items() if node in listeners)
        return sorted(topic for topic in heard if self.topics.get(topic, node) != node)

    def _wait_for_causes(self) -> None:
        """Have no topic count as silent before what it rests on does: the cause is to be seen first."""
        for _ in range(LONGEST_CHAIN):
            changed = False
            for topic, found in self.steady.items():
                causes = [self.steady[one].silence_s for one in self.rests_on[topic] if one in self.steady]
                if max(causes, default=0.0) > found.silence_s:
                    self.steady[topic] = replace(found, silence_s=max(causes))
                    changed = True
            if not changed:
                return

    def _inputs(self, node: str, output: str) -> list[str]:
        """Return what an output rests on, of what its node listens to."""
        inputs = self._listens(node)
        if not self.listened:
            return inputs
        if output not in self.steady:
            return []  # nobody watches it
        flowed = [topic for topic in inputs if topic in self.steady]  # nothing rests on what did not flow
        answers = self.learned.answers.get(output, {})
        if STATE.search(self._kind(output)):
            flowed = [topic for topic in flowed if topic in answers or not COMMAND.search(self._kind(topic))]
        seen = {topic: topic in answers or rests(self._of(topic), self._of(output)) for topic in flowed}
        kept = [topic for topic in flowed if seen[topic] is not False]
        shown = [topic for topic in kept if seen[topic]]
        return shown if len(kept) > MANY_INPUTS and shown else kept

    # --- its text --------------------------------------------------------------------------------------

    def _nodes(self) -> Iterator[str]:
        for node in self.nodes:
            outputs = sorted(topic for topic, publisher in self.topics.items() if publisher == node)
            inputs = self._listens(node)
            if node not in self.graph.nodes:
                launched = comment(self.heard.launched[node])
                yield f"  {word(node)}: {{}}    # {launched}; what does it publish, and listen to?"
                continue
            if not outputs:
                why = "publishes nothing that the model speaks of"
                heard = f", listens to {', '.join(comment(topic) for topic in inputs)}" if inputs else ""
                yield f"  {word(node)}: {{}}    # {why}{heard}"
                continue
            rests_on = {topic: self.rests_on[topic] for topic in outputs}
            drives = not self.listened and not inputs
            if self.listened and not any(rests_on.values()):
                drives = any(topic in self.steady for topic in outputs)
            if node in self.heard.unnamed:
                self.asked += [f"which node publishes {topic.removeprefix('/')}?" for topic in outputs]
            elif drives and self.listened:
                self.asked.append(device_question(node.removeprefix("/")))
            if node in self.heard.unnamed:
                hint = "who publishes this was not recorded: put the node's name here"
            elif not inputs:
                hint = "listens to nothing: probably a driver; of which device?"
            elif not self.listened:
                hint = "all that it publishes rests on all that it listens to: strike out what does not"
            else:
                unused = [topic for topic in inputs if not any(topic in some for some in rests_on.values())]
                hint = "rests on what it listens to, as far as that came: believed, not seen"
                if unused:
                    hint += f"; not on {', '.join(comment(topic) for topic in unused)}"
            yield f"  {word(node)}:    # {hint}"
            if drives:
                yield DRIVES
            yield "    publishes:"
            for topic in outputs:
                answers = self.learned.answers.get(topic, {})
                seen = [one for one in rests_on[topic] if one in answers]
                self.asked += [arrow_question(topic.removeprefix("/"), one.removeprefix("/")) for one in seen]
                said = [self.graph.types.get(topic, ""), *(answers[one] for one in seen)]
                hint = comment("; ".join(filter(None, said)))
                needed = [*rests_on[topic], *(self.meetings.get(one, "") for one in rests_on[topic])]
                named = ", ".join(word(one) for one in needed if one)
                yield f"      {word(topic)}: [{named}]" + (f"    # {hint}" if hint else "")

    def _rates(self) -> list[str]:
        topics, rates = sorted(self.topics), self.graph.rates_hz
        if self.listened:
            lines = []
            for topic in topics:
                found = self.steady.get(topic)
                if found is not None:
                    said = f"{{rate_hz: {found.rate_hz:.3g}, tolerance_hz: {found.tolerance_hz:.2g}}}"
                    why = found.why[:1] if self.heard.learned else found.why  # the agent's file has all of it
                    lines.append(f"  {word(topic)}: {said}    # {comment('; '.join(why))}")
                elif self._of(topic).latched:
                    lines.append(f"  {word(topic)}: {{latched: true, silent: true}}    # {self._said(topic)}")
                else:
                    lines.append(f"  {word(topic)}: {{silent: true}}    # {self._said(topic)}")
            lines += [f"  {word(one)}: {{}}    # {SIGNS['qos']}" for one in self.meetings.values()]
            return ["", "topics:", *lines] if lines else []
        if rated := [topic for topic in topics if topic in rates]:
            lines = ["", "topics:                       # rates as they were there"]
            return lines + [f"  {word(topic)}: {_rate(rates[topic])}" for topic in rated]
        lines = ["", "# topics:                     # the rate of messages, and how far it may stray"]
        return lines + [f"#   {word(topic)}: {{rate_hz: 10, tolerance_hz: 1}}" for topic in topics[:3]]

    def _said(self, topic: str) -> str:
        """Return why nobody watches a topic."""
        one = self._of(topic)
        if one.latched:
            return "heard once, and kept for those who come later" if one.count else "its publisher keeps it"
        why = self.why_not[topic]
        return f"{'nothing came' if why == 'silent' else why} in {self.heard.seconds:.0f} s"

    def _devices(self) -> Iterator[str]:
        """Proposals: without power, and none of them counts before somebody says that it is one."""
        for name, device in sorted(self.heard.devices.items()):
            if _is_name(name):
                driven = f", by {comment(device.node)}" if device.node in self.nodes else ""
                yield f"#   {word(name)}: {{blame_hardware: true}}    # {comment(device.source)}{driven}"

    def _statuses(self) -> tuple[dict[str, str], dict[str, str]]:
        """Return properties with their statuses, and the same with the nodes to blame."""
        taken = {name.removeprefix("/") for name in (*self.nodes, *self.topics)}
        statuses, blamed = {}, {}
        for status, found in sorted(self.heard.statuses.items()):
            if status.startswith(OUR_STATUS):
                continue
            ours = [publisher for publisher in found.publishers if publisher in self.nodes]
            node = speaker(status, ours, self.nodes)
            if self.listened and not found.publishers and not found.topic.count:
                self.asked.append(f"the status {status!r} is expected and did not come: why?")
            elif node is None:
                self.asked.append(f"of which node does the status {status!r} speak?")
            elif found.levels != {0}:
                level = ("OK", "WARN", "ERROR", "STALE")[min(max(found.levels), 3)]
                self.asked.append(f"the status {status!r} said {level}: is that so by design?")
            else:
                name = slug(status, taken)
                taken.add(name)
                statuses[name], blamed[name] = status, node.removeprefix("/")
        return statuses, blamed

    def _entries(self, statuses: Mapping[str, str], signs: Mapping[str, Entry]) -> Entries:
        """Return the observers: of rates, of nodes, of what these say, and what was learned beside."""
        found = Entries()
        if not self.listened:
            return found
        for topic, one in self.steady.items():
            name = topic.removeprefix("/")
            found.topics[name], found.evidence[name] = rate_entry(one), list(one.why)
        if self.named and self.heard.origin:
            preset = "ros1" if "ros1" in self.heard.origin else "ros2"
            names = f"[{', '.join(map(word, self.named))}]"
            found.observers["nodes"] = {"kind": "node", **self._fed(), "preset": preset, "nodes": names}
        for name, status in statuses.items():
            came = self.heard.statuses[status].topic
            every_s = max(came.usual_s, 0.1)
            found.observers[name] = {
                "kind": "diagnostic",
                **self._fed(),
                "status": f"[{json.dumps(escape(status))}]",
                "bad_from": "error",
                "interval_s": f"{every_s:.3g}",
                "lifetime_s": f"{max(STATUS_LIFE_S, STATUS_GAPS * came.longest_s):.3g}",
            }
            found.evidence[name] = [f"OK in all of {came.count} statuses, {every_s:.2g} s apart (median)"]
        found.observers |= signs
        found.observers |= {name: dict(keys) for name, keys in self.learned.observers.items()}
        found.evidence |= {name: list(lines) for name, lines in self.learned.evidence.items()}
        found.left_out += self.learned.left_out
        return found

    def _fed(self) -> Entry:
        """Return who feeds an observer."""
        return {"from": next(iter(self.heard.origin))} if self.heard.origin else {}

    def _signs(self, blamed: dict[str, str]) -> dict[str, Entry]:
        """Return observers of what nodes show beside their topics; `blamed` gets the nodes of each."""
        if not self.listened or not self.heard.origin:
            return {}
        taken = {name.removeprefix("/") for name in (*self.nodes, *self.topics)} | blamed.keys()
        found: dict[str, Entry] = {}
        preset = {"preset": "ros1"} if "ros1" in self.heard.origin else {}

        def sign(kind: str, name: str, of: str, **keys: str | float) -> str:
            called = sign_of(name, kind, taken)
            taken.add(called)
            said = {key: word(one) if isinstance(one, str) else f"{one:g}" for key, one in keys.items()}
            found[called] = {"kind": kind, **self._fed(), **(preset if kind == "goals" else {}), **said}
            blamed[called] = of.removeprefix("/")
            return called

        for action, node in sorted(self.heard.actions.items()):
            if node in self.nodes:
                sign("goals", action, node, action=action.removeprefix("/"))
        for node in sorted(self.heard.lifecycle.keys() & set(self.nodes)):
            sign("lifecycle", node, node, node=node.removeprefix("/"))
        errors = self.heard.errors
        for node in self.named[:MOST_LOGS] if errors is not None else ():
            if node not in (errors or {}):
                sign("rosout", node, node, node=node.removeprefix("/"))
        for topic, path in sorted(self.heard.moving.items()):
            if topic in self.steady:
                still_s = max(STILL_S, STILL_INTERVALS / self.steady[topic].rate_hz)
                source = f"{topic.removeprefix('/')}:{path}"
                sign("changing", topic, self.topics[topic], source=source, still_s=round(still_s, 1))
        if "ros2" in self.heard.origin:
            broken = " ".join(self.heard.remarks)
            for topic in self.steady:
                if self.graph.subscribers.get(topic) and topic.removeprefix("/") not in broken:
                    named = sign("qos", topic, self.topics[topic], topic=topic.removeprefix("/"))
                    if any(topic in inputs for inputs in self.rests_on.values()):
                        self.meetings[topic] = named
        return found

    def _managed(self, signs: Mapping[str, Entry], blamed: Mapping[str, str]) -> dict[str, tuple[str, str]]:
        """Return, of states of lifecycles, who manages that node and others, and the property of them all.

        A lifecycle manager takes down all that it manages when one of them fails: one fault explains all.
        """
        manager: dict[str, str] = {}
        for state in (name for name, keys in signs.items() if keys["kind"] == "lifecycle"):
            node = f"/{blamed[state]}"
            callers = self.graph.clients.get(f"{node}/change_state", frozenset()) & {*self.nodes} - {node}
            if len(callers) == 1:
                [manager[state]] = callers
        shared = [node for node, count in Counter(manager.values()).items() if count > 1]
        taken = {name.removeprefix("/") for name in (*self.nodes, *self.topics)} | blamed.keys()
        called = {node: slug(f"managed_by_{node}", taken) for node in shared}
        return {state: (node, called[node]) for state, node in manager.items() if node in called}

    def _left_out(self) -> list[str]:
        """Return comments on what the model does not speak of."""
        shared, asked, silent = [], [], []
        for topic in sorted(self.graph.publishers.keys() | self.graph.subscribers.keys()):
            ours = [node for node in self.graph.publishers.get(topic, ()) if not _is_any_of(node, TOOLS)]
            if topic in self.topics or is_plumbing(topic):
                continue
            if ACTION.search(self.graph.types.get(topic, "")):
                asked.append(comment(topic))
            elif len(ours) > 1:
                shared.append(f"{comment(topic)} ({', '.join(comment(node) for node in sorted(ours))})")
            elif not ours:
                silent.append(comment(topic))
        ended = [comment(node) for node in sorted(self.gone)]
        loaders = [comment(node) for node in sorted(self.loaders)]
        lines = []
        for what, found in (
            ("Topics of several publishers: the silence of one does not show", shared),
            ("Topics of actions: there are messages when somebody acts", asked),
            ("Topics that no node of the robot publishes: tools do, or nobody", silent),
            ("Nodes that ended, or did not run although they are listed", ended),
            ("Nodes that only keep nodelets loaded: their manager does the work, and ends them", loaders),
        ):
            if found:
                lines += ["", f"# {what}:", *(f"#   {line}" for line in found)]
        return lines

    def _ask(self) -> None:
        """What may have been broken while it was listened is asked."""
        for node in self.missing:
            said = self.heard.launched[node]
            self.asked.append(f"{node.removeprefix('/')} ({said}) is launched and was not there: why?")
        for topic, why in sorted(self.why_not.items()):
            named = topic.removeprefix("/")
            if self._of(topic).latched:
                continue
            if STATE.search(self._kind(topic)) and why == "silent":
                self.asked.append(f"{named} was silent all the time: is that so by design?")
            elif why != "silent" and self._of(topic).count >= LEAST_MESSAGES:
                self.asked.append(f"{named}: {why}: is that so by design?")
        for node, count in sorted((self.heard.errors or {}).items()):
            if node in self.nodes:
                self.asked.append(f"{node.removeprefix('/')} logged {counted(count, 'error')}: was it well?")
        self.asked += self.heard.remarks


def rate_entry(steady: SteadyTopic) -> Entry:
    """Return what the observer of a rate is told; a rounded bound is no tighter."""
    given = {
        "tolerance_hz": steady.tolerance_hz,
        "tolerance_above_hz": steady.above_hz,
        "window": steady.window,
        "settle": steady.settle,
        "silence_s": steady.silence_s,
        "pause_s": steady.pause_s,
        "first_s": steady.first_s,
        "held_s": steady.held_s,
    }
    bounds = {
        key: upwards(value) if isinstance(value, float) else str(value)
        for key, value in given.items()
        if value is not None
    }
    return {"rate_hz": f"{steady.rate_hz:.4g}", **bounds}


def observers_lines(entries: Entries) -> Iterator[str]:
    """Yield the sections of observers, each of these below what its numbers rest on."""
    for section, found in (("topics", entries.topics), ("observers", entries.observers)):
        if found:
            reported = "                       # reported as ok(topic), or not, by the rate of the messages"
            yield f"{section}:{reported if section == 'topics' else ''}"
        for name, entry in found.items():
            yield from (f"  # {comment(line)}" for line in entries.evidence.get(name, ()))
            yield f"  {entry_line(name, entry)}"
    if entries.doubtful:
        yield "# Doubtful, and so not observed. Who knows that one is right takes its mark away:"
    for name, (section, entry, why) in entries.doubtful.items():
        for line in (f"{section}: {why}", *entries.evidence.get(name, ())):
            yield f"#   {comment(line)}"
        yield f"#   {entry_line(name, entry)}"
    if entries.left_out:
        yield "# Not observed:"
    for what, why in entries.left_out:
        yield f"#   {comment(what)}: {comment(why)}"


def entry_line(name: str, entry: Entry) -> str:
    """Return an observer as a line of YAML."""
    return f"{word(name)}: {{{', '.join(f'{key}: {value}' for key, value in entry.items())}}}"


def _loaders(graph: RosGraph) -> set[str]:
    """Return the nodes of ROS 1 that have another one load a nodelet, and end when that one does."""
    found: set[str] = set()
    for service, managers in graph.services.items():
        if service.endswith(LOAD_NODELET):
            bond = f"{service.removesuffix(LOAD_NODELET)}/bond"
            found |= graph.publishers.get(bond, frozenset()) - managers
    return found


def _rules(blamed: Mapping[str, str], managed: Mapping[str, tuple[str, str]]) -> Iterator[str]:
    """Yield the rules: what is said of nodes, and what those have in common that somebody manages."""
    for name, node in blamed.items():
        together = f" and {holds('ok', managed[name][1])}" if name in managed else ""
        yield f"not ab({word(node)}){together} -> {holds('ok', name)}"
    for manager, whole in dict.fromkeys(managed.values()):
        states = [state for state, of in managed.items() if of == (manager, whole)]
        nodes = (manager, *(blamed[state] for state in states))
        yield " and ".join(f"not ab({word(node)})" for node in nodes) + f" -> {holds('ok', whole)}"
        for state in states:
            yield f"{holds('ok', state)} -> {holds('ok', whole)}"


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
        clients=table(graph.clients),
    )


def _is_name(name: str) -> bool:
    return name.isprintable() and bool(name.strip("/")) and len(name) <= MAX_NAME


def spoken_topics(graph: RosGraph) -> dict[str, str]:
    """Return the topics that a model of this graph speaks of, each with its one publisher."""
    return _spoken(_legal(graph), frozenset())


def _spoken(graph: RosGraph, gone: Collection[str]) -> dict[str, str]:
    found = {}
    for topic, publishers in sorted(graph.publishers.items()):
        ours = [node for node in publishers if node not in gone and not _is_any_of(node, TOOLS)]
        if len(ours) == 1 and not _is_aside(topic, graph):
            found[topic] = ours[0]
    return found


def speaker(status: str, publishers: Collection[str], nodes: Collection[str], space: str = "") -> str | None:
    """Return the node that a status speaks of: what its name begins with, as diagnostic_updater has it, in
    the namespace of its topic or its publisher if several are called so; else its publisher.
    """
    named = status.partition(":")[0].strip().strip("/*")
    [only] = publishers if len(publishers) == 1 else [None]
    alike = {node for node in nodes if node.strip("/") == named}
    alike = alike or {node for node in nodes if node.rpartition("/")[2] == named}
    if space:
        alike = {node for node in alike if node.startswith(f"{space}/")} or alike
    if len(alike) > 1 and only is not None:
        alike = {node for node in alike if node.rpartition("/")[0] == only.rpartition("/")[0]}
    return alike.pop() if len(alike) == 1 else only


def device_question(node: str) -> str:
    """Return what is asked of a node that rests on no other."""
    return f"which device does {node} drive, if any?"


def arrow_question(topic: str, given: str) -> str:
    """Return what is asked of an arrow that is seen from times alone, or that something contradicts."""
    return f"does {topic} rest on {given}?"


def is_tool(node: str) -> bool:
    """Whether a node comes and goes with whoever looks at the robot."""
    return _is_any_of(node, TOOLS)


def is_plumbing(topic: str) -> bool:
    """Whether a topic is one of ROS itself, or ours."""
    return _is_any_of(topic, PLUMBING)


def _is_aside(topic: str, graph: RosGraph) -> bool:
    return is_plumbing(topic) or bool(ACTION.search(graph.types.get(topic, "")))


def _is_any_of(name: str, patterns: Iterable[str]) -> bool:
    return any(fnmatchcase(name, pattern) for pattern in patterns)


def _rate(rate_hz: float) -> str:
    return f"{{rate_hz: {rate_hz:.3g}, tolerance_hz: {rate_hz / 10:.2g}}}"


def seconds_told(seconds: float) -> str:
    """Return a time for people."""
    return f"{seconds * 1000:.3g} ms" if seconds < 0.9995 else f"{seconds:.3g} s"


# --- names as YAML and comments have them -----------------------------------------------------------------


def word(name: str) -> str:
    """Return a name as YAML and sentences have it, without the leading slash."""
    name = name.removeprefix("/")
    plain = YAML_WORD.match(name) and PLAIN_NAME.match(name) and name.lower() not in RESERVED
    return name if plain else json.dumps(name, ensure_ascii=False)


def upwards(value: float) -> str:
    """Return a positive number of three digits, not below it: a rounded bound is no tighter."""
    text = f"{value:.3g}"
    if float(text) < value:
        text = f"{value * 1.005:.3g}"
    return f"{float(text):g}"


def comment(text: str) -> str:
    """Return a text in which nothing ends the comment."""
    return "".join(letter if letter.isprintable() else "?" for letter in text.removeprefix("/"))


def sign_of(name: str, kind: str, taken: Iterable[str] = ()) -> str:
    """Return how what a node or a topic shows by an observer of a kind is called, e.g. `scan_qos`."""
    return slug(f"{name}_{NAMED.get(kind, kind)}", taken)


def slug(text: str, taken: Iterable[str] = ()) -> str:
    """Return a plain name for a text, one that is not taken."""
    base = re.sub(r"[^A-Za-z0-9]+", "_", text).strip("_") or "value"
    base = base if base[0].isalpha() else f"v{base}"
    found, number = base, 2
    while found in taken:
        found, number = f"{base}{number}", number + 1
    return found


def _quoted(text: str) -> str:
    return "'" + text.replace("'", "''") + "'"


# --- remedies that a graph of ROS 2 offers by its services, as commented lines: nothing is active by itself


COSTMAP = re.compile(r"/clear_(?:entirely_)?(?:\w+_)?costmap\Z")
CLEARS = "nav2_msgs/srv/ClearEntireCostmap"


class OfferedRemedy(NamedTuple):
    """One remedy: the node that it mends, and its lines of a model and of an agent's file."""

    node: str  # its full name
    model: str
    action: str


def offered_remedies(graph: RosGraph) -> tuple[OfferedRemedy, ...]:
    """Return what a robot with ROS 2 offers against its own faults, by names that are usual.

    A component is called as its node is, without the slash. Agents of robomend offer none.
    """
    return tuple(_found(graph))


def _found(graph: RosGraph) -> Iterator[OfferedRemedy]:
    for service, nodes in sorted(graph.services.items()):
        for node in sorted(nodes):
            name = node.strip("/")
            act = re.sub(r"\W", "_", name)
            if service == f"{node}/change_state" and f"{node}/get_state" in graph.services:
                how = f"{{kind: lifecycle, nodes: {{{name}: {node}}}, transition: restart}}"
                yield _remedy(node, f"bring_up_{act}", how)
            elif COSTMAP.search(service):
                short = re.sub(r"\W", "_", service.strip("/"))
                how = f"{{kind: ros2_service, services: {{{name}: {service}}}, type: {CLEARS}}}"
                yield _remedy(node, short, how)


def _remedy(node: str, act: str, how: str) -> OfferedRemedy:
    name = node.strip("/")
    return OfferedRemedy(node, f"#  {act}: {{mends: {name}}}", f"#  {act}: {how}")
