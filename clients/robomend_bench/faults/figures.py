"""The figures of a run: from scores to rows, each with its interval. Pure.

Shares have Wilson's intervals; shares of acts, means and quantiles are resampled over trials; counts a time
have Poisson's. docs/score.md defines what each row counts.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass

from robomend_bench.faults.field import world_of
from robomend_bench.faults.scoring import Score
from robomend_bench.faults.stretches import STRETCH_BY_NAME
from robomend_bench.intervals import bootstrap, poisson, quantile, wilson


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
