"""The drafted observers, as YAML in which each number stands beside what it rests on."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from glob import escape

from robomend.model.from_graph import word
from robomend_batch.learn.delays import LEAST_WITHIN_S, DelayFound
from robomend_batch.learn.gathering import DIAGNOSTICS, TICK_NS
from robomend_batch.learn.matches import MatchFound
from robomend_batch.learn.ranges import AGREEING, RangeFound, StatusFound
from robomend_batch.learn.rates import RateFound
from robomend_batch.learn.tails import Bound
from robomend_batch.learn.words import comment, outwards, upwards
from robomend_client.observers.base import SECOND
from robomend_client.observers.rate import LEAST_SILENCE_S

HELD_S = 2.0
"""What is held up for so long, at a start above all, and comes at once is no wrong rate: few logs show it."""

LONGEST_WITHIN_S = 10.0
"""An answer that may be later than this is not watched."""

Entry = dict[str, str]
"""Key -> value, as YAML has them."""


@dataclass
class Entries:
    """The observers, and the evidence of each."""

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
                self.evidence[name] = [*other.evidence[name], "what was held back was learned from as well"]


def rate_entry(entries: Entries, found: RateFound, first_s: float) -> None:
    """Add the observer of a topic's rate; `first_s`: the latest first message of a log."""
    entry = {
        "rate_hz": f"{found.rate_hz:.4g}",
        "tolerance_hz": upwards(found.tolerance_hz),
        "tolerance_above_hz": upwards(found.above_hz),
        "window": str(found.window),
        "settle": str(found.window - 1),
        "silence_s": upwards(found.silence_s),
    }
    if found.pause_s is not None:
        entry["pause_s"] = upwards(found.pause_s)
    if found.silence_s < HELD_S:
        entry["held_s"] = f"{HELD_S:g}"
    if first_s > 1:
        entry["first_s"] = upwards(2 * first_s)
    entries.topics[found.topic] = entry
    lowest_hz = found.rate_hz - float(entry["tolerance_hz"])
    lines = [
        f"{found.messages:,} messages; windows of {found.window}: {_s(found.spans.usual)} (median), "
        f"{_s(found.spans.largest)} at most; as rare as asked: {_s(found.spans.value)}",
        f"the fastest had {found.fastest_hz.largest:.3g} Hz; "
        + (
            f"with a pause of silence_s: {lowest_hz:.3g} Hz"
            if found.pause_s is None
            else "its pauses count as pause_s, so that half of its messages missing is noticed beside them"
        ),
        f"gaps: median {_s(found.gaps.usual)}, {_tail(found.gaps)}"
        + (f"; never below {LEAST_SILENCE_S:g} s" if found.gaps.value < LEAST_SILENCE_S else ""),
    ]
    if first_s > 1:
        lines.append(f"a log's first message came after {_s(first_s)} at most")
    if found.only_silence:
        lines.append("its pauses are so long that half of its messages may be missing without being noticed")
    entries.evidence[found.topic] = lines


def delay_entry(entries: Entries, found: DelayFound, name: str, silence_s: float) -> None:
    """Add the observer of a topic that answers another, if a late answer would be noticed; what its silence
    lets pass is none.
    """
    within_s = max(found.within.value, LEAST_WITHIN_S, silence_s)
    if within_s > LONGEST_WITHIN_S:
        why = f"its answers to {found.in_topic} may be {_s(within_s)} late: nobody would notice"
        entries.left_out.append((name, why))
        return
    entries.observers[name] = {
        "kind": "multiple",
        "in_topic": word(found.in_topic),
        "out_topic": word(found.out_topic),
        "within_s": upwards(within_s),
        "interval_s": upwards(found.interval_s),
        "lifetime_s": upwards(max(10.0, 3 * within_s)),
    }
    entries.evidence[name] = [
        f"{found.within.samples:,} answers, {_s(found.usual_s)} after the newest message (median); "
        f"the oldest waited {_tail(found.within)}",
        f"intervals of both are alike by {found.likeness:.2f} (correlation of ranks)",
    ]
    if silence_s >= within_s:
        entries.evidence[name].append("within_s is the silence that its answers may keep")


def match_entry(entries: Entries, found: MatchFound, name: str) -> None:
    """Add the observer of two values that are alike."""
    entries.observers[name] = {
        "kind": "binary_qualitative",
        "first": word(found.first),
        "second": word(found.second),
        "compare": found.compare,
        "slope": f"{found.slope:.4g}",
        "second_slope": f"{found.second_slope:.4g}",
        "threshold": str(found.threshold),
    }
    entries.evidence[name] = [
        f"{found.ticks:,} ticks, correlation {found.correlation:.3f}; each moves in {found.moving:.0%} "
        f"of them; the count of mismatches went up to {found.longest}"
    ]


def status_entry(
    entries: Entries,
    found: StatusFound,
    name: str,
    limits: Mapping[str, tuple[str, int, RangeFound]],
    topic: str,
) -> None:
    """Add the observer of a status of a topic; `limits`: atom -> rule's key, 1 for an upper limit, range."""
    entry = {"kind": "diagnostic", "status": f"[{_quoted(escape(found.name))}]", "bad_from": found.bad_from}
    if topic != DIAGNOSTICS:
        entry["source"] = word(topic)
    rules = []
    for atom, (key, sign, one) in limits.items():
        edge = one.high if sign > 0 else one.low
        assert edge is not None
        limit = outwards(sign * edge.value, sign)
        rules.append(_quoted(f"{atom}: {key} {'<=' if sign > 0 else '>='} {limit}"))
    if rules:
        entry["rules"] = f"[{', '.join(rules)}]"
    entry |= {
        "agreeing": str(AGREEING),
        "interval_s": upwards(found.interval_s),
        "lifetime_s": upwards(found.lifetime_s),
    }
    entries.observers[name] = entry
    levels = ", ".join(f"{count:,} of level {level}" for level, count in found.levels.items())
    lines = [f"levels: {levels}"]
    lines += [
        f"{one.key}: {one.least:g} to {one.largest:g} in {one.high.samples:,} readings"
        for one in found.ranges
    ]
    lines += [f"not judged: {left}" for left in found.left_out]
    entries.evidence[name] = lines


def value_entry(entries: Entries, found: RangeFound, name: str, rate_hz: float) -> None:
    """Add the observer of a number of a topic."""
    together = max(1, round(rate_hz * TICK_NS / SECOND))
    entries.observers[name] = {
        "kind": "property",
        "source": word(found.key),
        **({} if found.low is None else {"low": outwards(-found.low.value, -1)}),
        "high": outwards(found.high.value, 1),
        **({"filter": "mean", "filter_window": str(together)} if together > 1 else {}),
        "agreeing": str(AGREEING),
        "interval_s": upwards(1 / rate_hz),
        "lifetime_s": upwards(max(5.0, 10 / rate_hz)),
    }
    entries.evidence[name] = [
        f"{found.least:g} to {found.largest:g} in {found.high.samples:,} means of 0.2 s; a quarter of that "
        "range is left on either side at least"
    ]


def observers_text(entries: Entries, head: list[str], trial: Mapping[str, str]) -> str:
    """Return the file; `trial`: what came of each entry over what was held back."""
    lines = [f"# {comment(line)}".rstrip() for line in head]
    for section, found in (("topics", entries.topics), ("observers", entries.observers)):
        if not found:
            continue
        lines += ["", f"{section}:"]
        for name, entry in found.items():
            lines += [
                f"  # {comment(line)}" for line in (*entries.evidence[name], trial.get(name, "")) if line
            ]
            lines.append(f"  {_line(name, entry)}")
    if not entries.names:
        lines += ["", "observers: {}"]
    if entries.doubtful:
        lines += ["", "# Doubtful, and so not observed. Who knows that one is right takes its mark away:"]
    for name, (section, entry, why) in entries.doubtful.items():
        lines += [f"#   {comment(line)}" for line in (f"{section}: {why}", *entries.evidence[name])]
        lines.append(f"#   {_line(name, entry)}")
    if entries.left_out:
        lines += [
            "",
            "# Not observed:",
            *(f"#   {comment(what)}: {comment(why)}" for what, why in entries.left_out),
        ]
    return "\n".join(lines) + "\n"


def _line(name: str, entry: Entry) -> str:
    return f"{word(name)}: {{{', '.join(f'{key}: {value}' for key, value in entry.items())}}}"


def _tail(found: Bound) -> str:
    return (
        f"99.9 % below {_s(found.quantile)}, longest {_s(found.largest)}; as rare as asked: {_s(found.value)}"
    )


def _s(seconds: float) -> str:
    return f"{seconds * 1000:.3g} ms" if seconds < 1 else f"{seconds:.3g} s"


def _quoted(text: str) -> str:
    return '"' + text.replace("\\", "\\\\").replace('"', '\\"') + '"'
