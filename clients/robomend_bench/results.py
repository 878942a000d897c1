"""Measurements as values: samples, their JSON, and what tables and plots say of them."""

from __future__ import annotations

import json
import math
import os
import platform
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass
from datetime import UTC, datetime
from importlib.metadata import version
from pathlib import Path
from statistics import fmean, median
from typing import Any
from typing import Literal as OneOf

from robomend.errors import InputError
from robomend_bench.intervals import Interval, bootstrap

FORMAT = 1

KILLED = "killed"
"""The note of a question whose contender had to be killed: its time is then wall time, whatever the clock."""

BOOTSTRAP_FROM = 5
"""Questions; of fewer an interval says nothing."""

Status = OneOf["ok", "timeout", "refused", "error"]
LIBRARIES = ("robomend", "python-sat", "clingo")


@dataclass(frozen=True, slots=True)
class Sample:
    """One question, asked once more of one contender."""

    group: str
    size: int
    question: str
    contender: str
    repeat: int
    status: Status
    seconds: float
    result: tuple[int | None, ...] | None = None
    shown: int | None = None
    note: str = ""
    cost: float | None = None  # of a plan, see robomend_bench.tables
    bound: float = 1.0


@dataclass(frozen=True, slots=True)
class Built:
    """What one contender needed for one group, all questions together."""

    group: str
    contender: str
    build_s: float | None
    base_mib: float
    peak_mib: float


@dataclass(frozen=True)
class Run:
    """One run of one suite: everything that went in and came out."""

    suite: str
    mode: str
    command: str
    seed: int
    contenders: tuple[str, ...]  # the first is what ratios refer to
    machine: Mapping[str, Any]
    started: str
    clock: str = "wall"
    version: str = "1"  # of the suite
    timeout_s: float = 10.0
    samples: tuple[Sample, ...] = ()
    built: tuple[Built, ...] = ()
    disagreements: tuple[str, ...] = ()

    @property
    def groups(self) -> tuple[str, ...]:
        """In the order of the run."""
        return tuple(dict.fromkeys(sample.group for sample in self.samples))

    def best(self, contender: str, group: str | None = None) -> dict[str, float]:
        """Return question -> its fastest time of all repeats; solved questions only.

        The fastest, because on a shared machine whatever is added to it is somebody else's.
        """
        found: dict[str, float] = {}
        for sample in self.samples:
            if sample.contender == contender and sample.status == "ok" and group in (None, sample.group):
                key = f"{sample.group}/{sample.question}"
                found[key] = min(sample.seconds, found.get(key, math.inf))
        return found


@dataclass(frozen=True, slots=True)
class Line:
    """A row of the table: one contender on one group."""

    group: str
    size: int
    contender: str
    asked: int
    solved: int
    median_s: float | None
    most_s: float | None  # the 90th percentile
    worst_s: float | None
    par2_s: float | None  # mean over questions; what was not solved counts as twice the time-out
    ratio: float | None  # median over questions of this time / that of the first contender
    ratio_between: Interval | None  # 95%, by bootstrap over questions
    shown: str  # how many diagnoses: median and range
    peak_mib: float
    note: str


def summarise(run: Run) -> list[Line]:
    """Return the table of a run."""
    peaks = {(built.group, built.contender): built.peak_mib for built in run.built}
    lines = []
    for group in run.groups:
        first = run.best(run.contenders[0], group)
        for contender in run.contenders:
            mine = [s for s in run.samples if s.group == group and s.contender == contender]
            if not mine:
                continue
            times = run.best(contender, group)
            ratios = [times[key] / first[key] for key in times.keys() & first.keys() if first[key] > 0]
            notes = dict.fromkeys(s.note for s in mine if s.note not in ("", KILLED))
            lines.append(
                Line(
                    group=group,
                    size=mine[0].size,
                    contender=contender,
                    asked=len({s.question for s in mine}),
                    solved=len(times),
                    median_s=median(times.values()) if times else None,
                    most_s=percentile(times.values(), 0.9),
                    worst_s=max(times.values(), default=None),
                    par2_s=par2(run, [s.question for s in mine], times, group),
                    ratio=median(ratios) if ratios else None,
                    ratio_between=bootstrap(ratios, median) if len(ratios) >= BOOTSTRAP_FROM else None,
                    shown=_range([s.shown for s in mine if s.status == "ok" and s.shown is not None]),
                    peak_mib=peaks.get((group, contender), 0.0),
                    note="; ".join(notes),
                )
            )
    return lines


def par2(run: Run, questions: Iterable[str], times: Mapping[str, float], group: str) -> float:
    """Return the penalised mean of SAT competitions: an unsolved question counts as twice the time-out."""
    asked = set(questions)
    return fmean(times.get(f"{group}/{question}", 2 * run.timeout_s) for question in asked)


def percentile(values: Iterable[float], share: float) -> float | None:
    """Return the smallest value that at least this share of them does not exceed; None of none."""
    ordered = sorted(values)
    return ordered[max(0, math.ceil(share * len(ordered)) - 1)] if ordered else None


@dataclass(frozen=True, slots=True)
class Duel:
    """The first contender against the fastest of the others on one group."""

    group: str
    against: str  # whose median is least, over all questions
    ratio: float  # median over questions of its time / that of the first
    most_ratio: float  # of the 90th percentiles
    lost: int  # questions on which some other one was faster, or alone had an answer
    asked: int
    lost_by_s: float  # at most


def duels(run: Run) -> list[Duel]:
    """Return how the first contender stands against the others; what nobody solved does not count.

    What a contender did not solve counts as taking for ever, so that its median tells of all questions.
    """
    found = []
    for group in run.groups:
        first = run.best(run.contenders[0], group)
        others = {name: run.best(name, group) for name in run.contenders[1:]}
        asked = first.keys() | {key for times in others.values() for key in times}
        if not asked or not any(others.values()):
            continue

        def over_all(times: Mapping[str, float], asked: Iterable[str] = asked) -> list[float]:
            return [times.get(key, math.inf) for key in asked]

        against = min(others, key=lambda name: (median(over_all(others[name])), -len(others[name])))
        rival = others[against]
        ratios = [rival.get(key, math.inf) / first[key] for key in asked & first.keys() if first[key] > 0]
        mine, theirs = percentile(over_all(first), 0.9), percentile(over_all(rival), 0.9)
        behind = [
            first.get(key, math.inf) - min(times.get(key, math.inf) for times in others.values())
            for key in asked
        ]
        found.append(
            Duel(
                group=group,
                against=against,
                ratio=median(ratios) if ratios else 0.0,
                most_ratio=theirs / mine if mine and theirs and mine < math.inf else 0.0,
                lost=sum(by > 0 for by in behind),
                asked=len(asked),
                lost_by_s=max(0.0, *behind),
            )
        )
    return found


def ratio_at_least(run: Run, contender: str, group: str) -> tuple[int, float] | None:
    """Return what the ratio to the first contender is at least, with the questions that were not finished.

    The plain ratio leaves them out, the hardest ones, and so flatters whoever did not finish. Here each
    counts with the time that was spent on it in vain, which is a lower bound, and so is the median then.

    Returns:
        How many questions such bounds stand for, and the median; None where there are none.
    """
    first, times = run.best(run.contenders[0], group), run.best(contender, group)
    in_vain: dict[str, float] = {}
    for sample in run.samples:
        key = f"{sample.group}/{sample.question}"
        ours = sample.group == group and sample.contender == contender
        # one that was killed told no CPU time
        measured = run.clock == "wall" or sample.note != KILLED
        if ours and sample.status == "timeout" and measured and key in first and key not in times:
            in_vain[key] = max(sample.seconds, in_vain.get(key, 0.0))
    if not in_vain:
        return None
    spent = {**times, **in_vain}
    return len(in_vain), median(spent[key] / first[key] for key in spent.keys() & first.keys())


def _range(values: Sequence[int]) -> str:
    if not values:
        return ""
    low, high = min(values), max(values)
    return f"{low}" if low == high else f"{median(values):g} ({low}-{high})"


def slope(run: Run, contender: str) -> float | None:
    """Return the exponent of growth: the slope of log(median time) over log(size), by least squares."""
    points = [
        (math.log(line.size), math.log(line.median_s))
        for line in summarise(run)
        if line.contender == contender and line.median_s and line.size
    ]
    if len({x for x, _ in points}) < 2:  # a slope needs two sizes
        return None
    mean_x = sum(x for x, _ in points) / len(points)
    mean_y = sum(y for _, y in points) / len(points)
    spread = sum((x - mean_x) ** 2 for x, _ in points)
    return sum((x - mean_x) * (y - mean_y) for x, y in points) / spread


def disagreements(samples: Iterable[Sample]) -> tuple[str, ...]:
    """Return where two contenders gave different complete answers: one of them is wrong."""
    answers: dict[tuple[str, str], dict[tuple[int | None, ...], list[str]]] = {}
    for sample in samples:
        if sample.status == "ok" and sample.result is not None:
            by_result = answers.setdefault((sample.group, sample.question), {})
            by_result.setdefault(sample.result, []).append(sample.contender)
    return tuple(
        f"{group}/{question}: "
        + ", ".join(f"{result} by {'/'.join(dict.fromkeys(who))}" for result, who in by_result.items())
        for (group, question), by_result in answers.items()
        if len(by_result) > 1
    )


def this_machine() -> dict[str, Any]:
    """Return what a reader needs to judge the figures."""
    cpu = platform.processor() or platform.machine()
    try:
        for line in Path("/proc/cpuinfo").read_text().splitlines():
            if line.startswith("model name"):
                cpu = line.partition(":")[2].strip()
                break
    except OSError:
        pass  # not Linux: the architecture must do
    return {
        "cpu": cpu,
        "cores": os.cpu_count(),
        "load": round(os.getloadavg()[0], 2),
        "system": f"{platform.system()} {platform.release()}",
        "python": platform.python_version(),
        "versions": {name: version(name) for name in LIBRARIES},
    }


def now() -> str:
    """Return the time of day, UTC."""
    return datetime.now(UTC).isoformat(timespec="seconds")


def as_json(run: Run) -> str:
    """Return a run as JSON, for `load`."""
    return json.dumps({"robomend_bench": FORMAT, **asdict(run)}, indent=1)


def save(run: Run, path: Path) -> None:
    """Write a run as JSON."""
    path.write_text(as_json(run) + "\n")


def load(path: Path) -> Run:
    """Read a run.

    Raises:
        InputError: the file is not one that `save` wrote.
    """
    try:
        tree = json.loads(path.read_text())
        if tree.pop("robomend_bench") != FORMAT:
            raise InputError(f"{path}: written by another version of robomend-bench; run the suite again")
        tree["samples"] = tuple(
            Sample(**{**sample, "result": None if sample["result"] is None else tuple(sample["result"])})
            for sample in tree["samples"]
        )
        tree["built"] = tuple(Built(**built) for built in tree["built"])
        for name in ("contenders", "disagreements"):
            tree[name] = tuple(tree[name])
        return Run(**tree)
    except (OSError, ValueError, KeyError, TypeError, AttributeError) as error:
        raise InputError(f"{path}: not a result of robomend-bench ({error})") from error
