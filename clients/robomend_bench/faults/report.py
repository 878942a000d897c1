"""The report of a run: Markdown for people, JSON for programs. What went wrong comes with its command.

Its figures are rows made of scores, each with an interval. Shares have Wilson's intervals; shares of acts,
means and quantiles are resampled over trials; counts a time have Poisson's. docs/score.md defines what
each row counts.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from robomend_bench.faults.field import BY_NAME, world_of
from robomend_bench.faults.scoring import Score
from robomend_bench.faults.stretches import STRETCH_BY_NAME, STRETCHES
from robomend_bench.faults.times import Part
from robomend_bench.intervals import bootstrap, poisson, quantile, wilson
from robomend_client.counts import first_few


@dataclass(frozen=True, slots=True)
class Figure:
    """One row: what, its value as people read it, and the interval."""

    name: str
    what: str
    value: float | None  # None: nothing to count
    count: int  # of what it is over
    low: float
    high: float
    unit: str  # share, mean, s, per hour, count

    def text(self) -> str:
        """Return value, interval and count in words."""
        if self.value is None or math.isnan(self.value):
            return "–"
        if self.unit == "share":
            share, low, high = 100 * self.value, 100 * self.low, 100 * self.high
            return f"{share:.1f}% ({low:.1f}–{high:.1f}) of {self.count}"
        if self.unit == "s":
            return f"{self.value:.2f} s ({self.low:.2f}–{self.high:.2f})"
        if self.unit == "per hour":
            return f"{self.value:.1f} an hour ({self.low:.1f}–{self.high:.1f})"
        return f"{self.value:.2f} ({self.low:.2f}–{self.high:.2f}) over {self.count}"


def of_faults(scores: Sequence[Score]) -> list[Figure]:
    """Return the figures of trials with faults."""
    told = [s for s in scores if s.told_apart]
    onset = [s for s in scores if s.told_by_onset]
    mended = [s for s in scores if s.repairable]
    hopeless = [s for s in scores if s.repairable is False]
    field = [s for s in scores if world_of(s.cls) == "field"]
    return [
        _share("detected", "detected", scores, lambda s: s.detected),
        _share("cause_first", "cause first, where it can be told apart", told, lambda s: s.cause_first),
        _share(
            "cause_first_onset",
            "the same, where who fell silent first counts",
            onset,
            lambda s: s.cause_first,
        ),
        _share("repaired", "repaired, of the repairable", mended, lambda s: s.repaired),
        _share(
            "escalated",
            "escalated with the true cause named, of the others",
            hopeless,
            lambda s: s.escalated and s.cause_named,
        ),
        _share("false_repaired", "called repaired that were not", scores, lambda s: bool(s.false_repaired)),
        _share(
            "contradicted", "repairs' words against their records", scores, lambda s: bool(s.contradicted)
        ),
        _share("right", "ended right", scores, lambda s: s.right),
        _ratio("wrong_acts", "wrong acts, of all acts", scores),
        _share("trials_wrong", "trials with a wrong act", scores, lambda s: bool(s.wrong)),
        _mean("extra_acts", "acts beyond the best policy, of what ended right", scores, lambda s: s.extra),
        _mean("repeated", "acts done more than three times, a trial", scores, lambda s: s.repeated),
        _share(
            "credited", "with an act said to have helped that did nothing", field, lambda s: bool(s.credited)
        ),
        _share("called_healthy", "called healthy that were not", field, lambda s: bool(s.called_healthy)),
        _share("left_stopped", "with healthy nodes left stopped", field, lambda s: bool(s.left_stopped)),
        *_times("beyond", "detection → repaired beyond what the robot needs", field, lambda s: s.beyond_s),
        *_times("detection", "fault → detection", scores, lambda s: s.detection_s),
        *_times("first_act", "fault → first act", scores, lambda s: s.first_act_s),
        *_times("waited", "all told → first act", scores, lambda s: s.waited_s),
        *_times("repaired", "detection → repaired", scores, lambda s: s.repaired_s),
        *_times("mended", "fault → repaired", scores, _mended_s),
        *_times("confirmed", "health told → repaired", scores, lambda s: s.confirmed_s),
        _mean("errors", "DXC: classification errors", scores, lambda s: s.errors),
        _mean("utility", "DXC: system repair utility", scores, lambda s: s.utility),
        _mean("points", "points", scores, lambda s: s.points),
    ]


def of_stretches(scores: Sequence[Score]) -> list[Figure]:
    """Return the figures of stretches without faults."""
    hours = sum(s.seconds for s in scores) / 3600
    return [
        _rate("alarms", "false alarms", sum(s.alarms for s in scores), hours),
        _share("stretches_alarm", "stretches with a false alarm", scores, lambda s: s.alarms > 0),
        _share("stretches_act", "stretches with a needless act", scores, lambda s: s.acts > 0),
        _share(
            "called_healthy",
            "called healthy while nobody could know",
            [s for s in scores if STRETCH_BY_NAME[s.cls].world == "field"],
            lambda s: bool(s.called_healthy),
        ),
        _mean("acts", "needless acts, a stretch", scores, lambda s: s.acts),
        _mean("points", "points", scores, lambda s: s.points),
    ]


def _mended_s(score: Score) -> float | None:
    """Return fault → repaired: who waits before he calls it detected gains nothing by it."""
    if score.detection_s is None or score.repaired_s is None:
        return None
    return score.detection_s + score.repaired_s


def _share(name: str, what: str, scores: Sequence[Score], holds: Callable[[Score], bool | None]) -> Figure:
    asked = [bool(answer) for s in scores if (answer := holds(s)) is not None]
    low, high = wilson(sum(asked), len(asked))
    return Figure(name, what, sum(asked) / len(asked) if asked else None, len(asked), low, high, "share")


def _ratio(name: str, what: str, scores: Sequence[Score]) -> Figure:
    def ratio(some: Sequence[Score]) -> float:
        acts = sum(s.acts for s in some)
        return sum(len(s.wrong) for s in some) / acts if acts else 0.0

    acts = sum(s.acts for s in scores)
    low, high = bootstrap(scores, ratio)
    return Figure(name, what, ratio(scores) if acts else None, acts, low, high, "share")


def _mean(
    name: str, what: str, scores: Sequence[Score], value: Callable[[Score], float | int | None]
) -> Figure:
    values = [float(found) for s in scores if (found := value(s)) is not None]
    low, high = bootstrap(values, _average)
    return Figure(name, what, _average(values) if values else None, len(values), low, high, "mean")


def _times(
    name: str, what: str, scores: Sequence[Score], value: Callable[[Score], float | None]
) -> Iterable[Figure]:
    values = [found for s in scores if (found := value(s)) is not None]
    for share, word in ((0.5, "median"), (0.9, "90th percentile")):

        def figure(some: Sequence[float], share: float = share) -> float:
            return quantile(some, share)

        low, high = bootstrap(values, figure)
        found = figure(values) if values else None
        yield Figure(f"{name}_p{share:.0%}"[:-1], f"{what}, {word}", found, len(values), low, high, "s")


def _rate(name: str, what: str, count: int, hours: float) -> Figure:
    if not hours:
        return Figure(name, what, None, 0, 0.0, 0.0, "per hour")
    low, high = poisson(count)
    return Figure(name, what, count / hours, count, low / hours, high / hours, "per hour")


def _average(values: Sequence[float]) -> float:
    return sum(values) / len(values)


LISTED = 200
"""Trials that a list names at most; JSON has them all."""

NAMED = 4
"""Acts that a list names of each trial."""


@dataclass
class Report:
    """What a run came to."""

    command: str
    observers: str
    agent: str
    load: int
    jobs: int
    scores: list[Score]  # of the trials that count
    late: list[tuple[str, float]]  # left out: trial, and how late the bench was
    errors: list[tuple[str, str]]  # no measurement: trial and why
    ticks: list[float] = field(default_factory=list)
    seconds: float = 0.0
    not_begun: int = 0  # trials for which no time was left
    topics_hz: float | None = None  # the rate of every topic; None: each its own
    again: Callable[[str], str] = lambda trial: trial  # the command that plays one trial again

    def group(self, name: str) -> list[Score]:
        """Return the scores of a group: faults, apart, healthy."""
        return [score for score in self.scores if score.group == name]

    @property
    def points(self) -> float | None:
        """Return calm and speed in one number: the mean of the faults' and of the stretches' points."""
        groups = [self.group("faults"), self.group("healthy")]
        if not all(groups):
            return None
        return sum(sum(s.points for s in group) / len(group) for group in groups) / 2

    # --- for people

    def markdown(self) -> str:
        """Return the report as Markdown."""
        return "\n".join(self._lines()) + "\n"

    def _lines(self) -> Iterator[str]:
        yield f"`{self.command}`"
        yield ""
        yield self._circumstances()
        faults, healthy = self.group("faults"), self.group("healthy")
        if faults:
            yield from ("", f"### Faults ({len(faults)} trials)", "", *_table(of_faults(faults)))
            yield from ("", *_by("class", faults, _class_of, list(BY_NAME)))
            yield from ("", *_by("robot", faults, _robot_of, sorted({_robot_of(s) for s in faults})))
            yield from _where_time_goes(faults)
        if healthy:
            yield from ("", f"### Nothing is broken ({len(healthy)} stretches)", "")
            yield from _table(of_stretches(healthy))
            yield from ("", *_by_stretch(healthy))
        if apart := self.group("apart"):
            yield from ("", f"### An observer is at fault ({len(apart)} trials, counted apart)", "")
            yield from _by("class", apart, _class_of, list(BY_NAME))
        if self.points is not None:
            yield from ("", f"Points, faults and stretches alike: **{self.points:.3f}** of 1.")
        yield from self._listed("Called repaired that were not", lambda s: s.false_repaired)
        yield from self._listed("Called healthy that were not", lambda s: s.called_healthy)
        yield from self._listed("Said to have helped, and did nothing", lambda s: s.credited)
        yield from self._listed("Healthy nodes left stopped", lambda s: s.left_stopped)
        yield from self._listed("Words against the record", lambda s: s.contradicted)
        yield from self._listed("Wrong acts", lambda s: s.wrong if s.group != "healthy" else [])
        yield from self._listed("Needless acts", lambda s: s.wrong if s.group == "healthy" else [])
        yield from self._ended_wrong()
        if self.errors:
            yield from ("", "### Errors: no measurement", "")
            yield from (f"- `{self.again(trial)}`: {why[:500]}" for trial, why in self.errors)
        if self.late:
            yield from (
                "",
                "### Left out, as the bench itself was late, or the service was kept from the processor",
                "",
            )
            yield from (f"- `{self.again(trial)}`: {late_s:.2f} s" for trial, late_s in self.late)

    def _circumstances(self) -> str:
        ticks = (
            f"; the bench's ticks were late by {1e3 * quantile(self.ticks, 0.99):.0f} ms (99th percentile) "
            f"and {1e3 * max(self.ticks):.0f} ms at most"
            if self.ticks
            else ""
        )
        every_topic = "" if self.topics_hz is None else f", every topic at {self.topics_hz:g} Hz"
        not_begun = f", {self.not_begun} not begun" if self.not_begun else ""
        return (
            f"{self.agent}, {self.observers} observers{every_topic}, {self.jobs} robots side by side, "
            f"{self.load} busy loops beside, {self.seconds / 60:.0f} minutes; {len(self.scores)} trials, "
            f"{len(self.late)} left out as the bench was late, {len(self.errors)} errors{not_begun}{ticks}."
        )

    def _listed(self, title: str, of: Callable[[Score], list[str]]) -> Iterator[str]:
        found = [score for score in self.scores if of(score)]
        if found:
            yield from ("", f"### {title} ({len(found)} trials)", "")
            yield from (f"- `{self.again(s.trial)}`: {first_few(of(s), NAMED, '; ')}" for s in found[:LISTED])

    def _ended_wrong(self) -> Iterator[str]:
        found = [s for s in self.group("faults") if not (s.right or s.false_repaired or s.called_healthy)]
        if found:
            yield from ("", f"### Neither repaired nor escalated with its cause ({len(found)} trials)", "")
            for s in found[:LISTED]:
                why = "not detected" if not s.detected else "escalated" if s.escalated else "not escalated"
                yield f"- `{self.again(s.trial)}`: {'' if s.repairable else 'beyond repair, '}{why}"

    # --- for programs

    def as_json(self) -> dict[str, Any]:
        """Return the report as JSON values."""
        return {
            "suite": "faults",
            "command": self.command,
            "agent": self.agent,
            "observers": self.observers,
            "topics_hz": self.topics_hz,
            "load": self.load,
            "jobs": self.jobs,
            "seconds": round(self.seconds, 1),
            "tick_late_p99_s": round(quantile(self.ticks, 0.99), 4) if self.ticks else None,
            "figures": {
                "faults": _figures_json(of_faults(self.group("faults"))),
                "healthy": _figures_json(of_stretches(self.group("healthy"))),
                "points": self.points,
            },
            "not_begun": self.not_begun,
            "errors": [{"trial": trial, "why": why} for trial, why in self.errors],
            "late": [{"trial": trial, "late_s": late_s} for trial, late_s in self.late],
            "scores": [score.as_json() for score in self.scores],
        }


def _class_of(score: Score) -> str:
    return score.cls


def _robot_of(score: Score) -> str:
    return score.trial.partition("/")[0]


def _figures_json(figures: Sequence[Figure]) -> dict[str, Any]:
    return {
        figure.name: {"value": figure.value, "low": figure.low, "high": figure.high, "count": figure.count}
        for figure in figures
        if figure.value is not None
    }


def _table(figures: Sequence[Figure]) -> Iterator[str]:
    yield from ("| what | figure (95% interval) |", "| --- | --- |")
    yield from (f"| {figure.what} | {figure.text()} |" for figure in figures if figure.value is not None)


def _by(
    word: str, scores: Sequence[Score], key: Callable[[Score], str], names: Sequence[str]
) -> Iterator[str]:
    yield (
        f"| {word} | trials | detected | cause first | repaired | escalated, named | false repaired "
        "| wrong acts | acts | extra, mean | detection → repaired, median |"
    )
    yield "| --- |" + " ---: |" * 10
    for name in names:
        some = [score for score in scores if key(score) == name]
        if not some:
            continue
        told = [s for s in some if s.told_apart]
        mended = [s for s in some if s.repairable]
        hopeless = [s for s in some if s.repairable is False]
        extra = [s.extra for s in some if s.extra is not None]
        times = [s.repaired_s for s in some if s.repaired_s is not None]
        cells = [
            name,
            str(len(some)),
            _of(sum(bool(s.detected) for s in some), sum(s.detected is not None for s in some)),
            _of(sum(bool(s.cause_first) for s in told), len(told)),
            _of(sum(bool(s.repaired) for s in mended), len(mended)),
            _of(sum(bool(s.escalated and s.cause_named) for s in hopeless), len(hopeless)),
            str(sum(bool(s.false_repaired) for s in some)),
            str(sum(len(s.wrong) for s in some)),
            str(sum(s.acts for s in some)),
            f"{sum(extra) / len(extra):.2f}" if extra else "–",
            f"{quantile(times, 0.5):.1f} s" if times else "–",
        ]
        yield f"| {' | '.join(cells)} |"


def beside_table(rows: Mapping[str, Sequence[Score]]) -> Iterator[str]:
    """Yield one line for each that had the same faults; where both mended one, each is beside the first."""
    yield (
        "| | repaired | escalated, named | called repaired that were not | wrong acts | power cuts "
        "| detection → repaired, median / 90th percentile | less what it decides "
        f"| where {next(iter(rows))} repaired it too | {next(iter(rows))} there |"
    )
    yield "| --- |" + " ---: |" * 9
    first = {s.trial: s.repaired_s for s in next(iter(rows.values())) if s.repaired_s is not None}
    for name, scores in rows.items():
        mended = [s for s in scores if s.repairable]
        hopeless = [s for s in scores if s.repairable is False]
        acts = sum(s.acts for s in scores)
        timed = [s for s in scores if s.repaired_s is not None and s.detection_s is not None]
        repaired_s = [s.repaired_s or 0.0 for s in timed]
        less_s = [(s.repaired_s or 0.0) - s.parts.get(str(Part.DECIDES), 0.0) for s in timed]
        both = [s for s in timed if s.trial in first]
        both_s, first_s = [s.repaired_s or 0.0 for s in both], [first[s.trial] for s in both]
        cells = [
            name,
            _of(sum(bool(s.repaired) for s in mended), len(mended)),
            _of(sum(bool(s.escalated and s.cause_named) for s in hopeless), len(hopeless)),
            str(sum(bool(s.false_repaired) for s in scores)),
            f"{_percent(sum(len(s.wrong) for s in scores), acts)} of {acts}",
            str(sum(s.cuts for s in scores)),
            *(_two(times) for times in (repaired_s, less_s, both_s, first_s)),
        ]
        yield f"| {' | '.join(cells)} |"


def beside_json(rows: Mapping[str, Sequence[Score]]) -> dict[str, Any]:
    """Return the figures of each that had the same faults."""
    return {name: _figures_json(of_faults(scores)) for name, scores in rows.items() if scores}


def _percent(some: int, count: int) -> str:
    return f"{100 * some / count:.1f}%" if count else "–"


def _two(times_s: Sequence[float]) -> str:
    if not times_s:
        return "–"
    return f"{quantile(times_s, 0.5):.1f} / {quantile(times_s, 0.9):.1f} s"


def _where_time_goes(scores: Sequence[Score]) -> Iterator[str]:
    """Yield a table of what the seconds from detection to repaired went into, where some trial has them."""
    timed = [score for score in scores if score.parts]
    if not timed:
        return
    yield from ("", "Where the seconds from detection to repaired went, mean of the trials:", "")
    yield f"| class | trials | {' | '.join(Part)} | sum |"
    yield "| --- |" + " ---: |" * (len(Part) + 2)
    for name in (*BY_NAME, "all"):
        some = [score for score in timed if name in (score.cls, "all")]
        if some:
            means = [sum(score.parts.get(part, 0.0) for score in some) / len(some) for part in Part]
            cells = [name, str(len(some)), *(f"{mean:.2f}" for mean in (*means, sum(means)))]
            yield f"| {' | '.join(cells)} |"


def _by_stretch(scores: Sequence[Score]) -> Iterator[str]:
    yield "| stretch | count | minutes | with a false alarm | false alarms | with an act | needless acts |"
    yield "| --- |" + " ---: |" * 6
    for stretch in STRETCHES:
        some = [score for score in scores if score.cls == stretch.name]
        if some:
            cells = [
                stretch.name,
                str(len(some)),
                f"{sum(s.seconds for s in some) / 60:.1f}",
                str(sum(s.alarms > 0 for s in some)),
                str(sum(s.alarms for s in some)),
                str(sum(s.acts > 0 for s in some)),
                str(sum(s.acts for s in some)),
            ]
            yield f"| {' | '.join(cells)} |"


def _of(some: int, count: int) -> str:
    return f"{some} of {count}" if count else "–"
