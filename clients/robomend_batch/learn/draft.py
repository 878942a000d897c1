"""What was learned, as part of what was heard (`Learned`): each number stands beside what it rests on."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from glob import escape

from robomend.model.from_graph import is_tool, seconds_told, slug, speaker, upwards, word
from robomend_batch.learn.delays import LEAST_WITHIN_S, DelayFound
from robomend_batch.learn.gathering import DIAGNOSTICS, TICK_NS
from robomend_batch.learn.matches import MatchFound
from robomend_batch.learn.ranges import AGREEING, RangeFound, StatusFound
from robomend_batch.learn.rates import RateFound
from robomend_batch.learn.tails import Bound
from robomend_client.counts import counted
from robomend_client.literals import Atom
from robomend_client.observers.base import SECOND
from robomend_client.observers.kinds import FIRST_S
from robomend_client.observers.rate import LEAST_SILENCE_S
from robomend_client.ros_graph import Learned, SteadyTopic

HELD_S = 2.0
"""What is held up for so long, at a start above all, and comes at once is no wrong rate: few logs show it."""

UNSEEN_START_S = 30.0
"""So long may the first message of a topic take where one log alone shows it; of many logs, their share."""

LONGEST_WITHIN_S = 10.0
"""An answer that may be later than this is not watched."""


def steady_topic(found: RateFound, first_s: float, logs: int) -> SteadyTopic:
    """Return the rate of a topic as it was learned; `first_s`: the latest first message of so many logs."""
    beside_pauses = "its pauses count as pause_s, so that half of its messages missing is noticed beside them"
    lowest_hz = found.rate_hz - float(upwards(found.tolerance_hz))
    why = [
        f"{found.messages:,} messages; windows of {found.window}: {seconds_told(found.spans.usual)} "
        f"(median), {seconds_told(found.spans.largest)} at most; as rare as asked: "
        f"{seconds_told(found.spans.value)}",
        f"the fastest had {found.fastest_hz.largest:.3g} Hz; "
        + (f"with a pause of silence_s: {lowest_hz:.3g} Hz" if found.pause_s is None else beside_pauses),
        f"gaps: median {seconds_told(found.gaps.usual)}, {_tail(found.gaps)}"
        + (f"; never below {LEAST_SILENCE_S:g} s" if found.gaps.value < LEAST_SILENCE_S else ""),
    ]
    begins_s = max(2 * first_s, UNSEEN_START_S / logs)
    if begins_s > FIRST_S:
        why.append(f"first message: after {seconds_told(first_s)} at most in {counted(logs, 'log')}")
    if found.only_silence:
        why.append("its pauses are so long that half of its messages may be missing without being noticed")
    return SteadyTopic(
        found.rate_hz,
        found.tolerance_hz,
        found.above_hz,
        found.window,
        found.window - 1,
        found.silence_s,
        found.pause_s,
        tuple(why),
        begins_s if begins_s > FIRST_S else None,
        HELD_S if found.silence_s < HELD_S else None,
    )


@dataclass
class LearnedSigns:
    """Observers beside those of rates, in the making, with what the model declares for them."""

    node_of: Mapping[str, str]  # topic of the model -> its node
    nodes: frozenset[str]  # more of which statuses may speak
    taken: set[str] = field(init=False)  # names
    observers: dict[str, dict[str, str]] = field(default_factory=dict)
    evidence: dict[str, list[str]] = field(default_factory=dict)
    blamed: dict[str, str] = field(default_factory=dict)
    values: dict[str, tuple[str, str]] = field(default_factory=dict)
    related: list[tuple[str, str]] = field(default_factory=list)
    left_out: list[tuple[str, str]] = field(default_factory=list)

    def __post_init__(self) -> None:
        self.nodes |= frozenset(self.node_of.values())
        self.taken = {*self.node_of, *(node.removeprefix("/") for node in self.node_of.values())}

    def learned(
        self, rates: Mapping[str, SteadyTopic | str], answers: Mapping[str, Mapping[str, str]]
    ) -> Learned:
        """Return it, with the rates of topics, and what answers what."""
        told = self.observers, self.evidence, self.blamed, self.values, self.related, self.left_out
        return Learned(rates, answers, *told)

    def delay(self, found: DelayFound, silence_s: float) -> None:
        """Add a topic that answers another, if a late answer would be noticed; what its silence lets pass is
        none.
        """
        within_s = max(found.within.value, LEAST_WITHIN_S, silence_s)
        if within_s > LONGEST_WITHIN_S:
            why = f"its answers to {found.in_topic} may be {seconds_told(within_s)} late: nobody would notice"
            self.left_out.append((found.out_topic, why))
            return
        name = self._named(f"{found.out_topic}_triggered", self.node_of[found.out_topic])
        self.observers[name] = {
            "kind": "multiple",
            "in_topic": word(found.in_topic),
            "out_topic": word(found.out_topic),
            "within_s": upwards(within_s),
            "interval_s": upwards(found.interval_s),
            "lifetime_s": upwards(max(10.0, 3 * within_s)),
        }
        self.evidence[name] = [
            f"{found.within.samples:,} answers, {seconds_told(found.usual_s)} after the newest message "
            f"(median); the oldest waited {_tail(found.within)}",
            f"intervals of both are alike by {found.likeness:.2f} (correlation of ranks)",
        ]
        if silence_s >= within_s:
            self.evidence[name].append("within_s is the silence that its answers may keep")

    def match(self, found: MatchFound) -> None:
        """Add two values that are alike."""
        pair = self._value(found.first), self._value(found.second)
        self.related.append(pair)
        name = str(Atom("matched", pair))
        self.observers[name] = {
            "kind": "binary_qualitative",
            "first": word(found.first),
            "second": word(found.second),
            "compare": found.compare,
            "slope": f"{found.slope:.4g}",
            "second_slope": f"{found.second_slope:.4g}",
            "threshold": str(found.threshold),
        }
        self.evidence[name] = [
            f"{found.ticks:,} ticks, correlation {found.correlation:.3f}; each moves in {found.moving:.0%} "
            f"of them; the count of mismatches went up to {found.longest}"
        ]

    def status(self, found: StatusFound, topic: str) -> None:
        """Add a status of a topic, and the limits of its numbers."""
        space = f"/{topic}".rpartition("/")[0]
        named = f"{space}/{slug(found.name.partition(':')[0])}"
        node = speaker(found.name, found.publishers, self.nodes, space) or named
        if is_tool(node):
            self.left_out.append((f"diagnostics of {found.name}", "it speaks of a tool"))
            return
        name = self._named(f"{space[1:]} {found.name}".strip(), node)
        entry = {"kind": "diagnostic", "status": f"[{_quoted(escape(found.name))}]"}
        entry["bad_from"] = found.bad_from
        if topic != DIAGNOSTICS:
            entry["source"] = word(topic)
        rules = []
        for one in found.ranges:
            if any(letter in one.key for letter in "<>=!"):
                continue
            for sign, edge, ending in ((1, one.high, "max"), (-1, one.low, "min")):
                if edge is not None:
                    atom = self._named(f"{name}_{one.key}_{ending}", node)
                    limit = outwards(sign * edge.value, sign)
                    rules.append(_quoted(f"{atom}: {one.key} {'<=' if sign > 0 else '>='} {limit}"))
        if rules:
            entry["rules"] = f"[{', '.join(rules)}]"
        self.observers[name] = entry | {
            "agreeing": str(AGREEING),
            "interval_s": upwards(found.interval_s),
            "lifetime_s": upwards(found.lifetime_s),
        }
        levels = ", ".join(f"{count:,} of level {level}" for level, count in found.levels.items())
        self.evidence[name] = [
            f"levels: {levels}",
            *(
                f"{one.key}: {one.least:g} to {one.largest:g} in {one.high.samples:,} readings"
                for one in found.ranges
            ),
            *(f"not judged: {left}" for left in found.left_out),
        ]

    def range(self, found: RangeFound, rate_hz: float) -> None:
        """Add a number of a topic."""
        name = self._named(f"{found.key}_range", self.node_of[found.key.split(":", 1)[0]])
        together = max(1, round(rate_hz * TICK_NS / SECOND))
        self.observers[name] = {
            "kind": "property",
            "source": word(found.key),
            **({} if found.low is None else {"low": outwards(-found.low.value, -1)}),
            "high": outwards(found.high.value, 1),
            **({"filter": "mean", "filter_window": str(together)} if together > 1 else {}),
            "agreeing": str(AGREEING),
            "interval_s": upwards(1 / rate_hz),
            "lifetime_s": upwards(max(5.0, 10 / rate_hz)),
        }
        self.evidence[name] = [
            f"{found.least:g} to {found.largest:g} in {found.high.samples:,} means of 0.2 s; a quarter of "
            "that range is left on either side at least"
        ]

    def _named(self, text: str, node: str) -> str:
        """Return a name of its own for a property, of which a node is to blame."""
        name = slug(text, self.taken)
        self.taken.add(name)
        self.blamed[name] = node.removeprefix("/")
        return name

    def _value(self, source: str) -> str:
        topic, path = source.split(":", 1)
        for name, known in self.values.items():
            if known == (topic, path):
                return name
        name = slug(f"{topic}_{path}", self.taken)
        self.taken.add(name)
        self.values[name] = (topic, path)
        return name


def outwards(value: float, sign: int) -> str:
    """Return a limit of four digits that is no tighter; `sign`: 1 of an upper one, -1 of a lower one."""
    text = f"{value:.4g}"
    if sign * float(text) < sign * value:
        text = f"{value + sign * abs(value) * 0.0005:.4g}"
    return f"{float(text):.10g}"


def _tail(found: Bound) -> str:
    return (
        f"99.9 % below {seconds_told(found.quantile)}, longest {seconds_told(found.largest)}; "
        f"as rare as asked: {seconds_told(found.value)}"
    )


def _quoted(text: str) -> str:
    return json.dumps(text, ensure_ascii=False)
