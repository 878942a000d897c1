"""The figures of a scenario, from its record alone. Pure; docs/demo.md defines them in words.

service_share_s is the wall time in which the robot was waiting for the service and not the service for the
robot. The robot is at work

    until an observation was made from which a diagnosis, and a plan, follow;
    during an action: from when the agent has it (the board: from when it is sent) until the last observation
      that shows its effect was made;
    while the service looks whether a plan helped, until the observation was made that says so.

Everything else, from the observation behind the first diagnosis until the repair is known to have worked, is
the service's: HTTP in both directions, OBS, diagnosis, choice, planning, dispatch, journal and other writes.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from math import ceil
from typing import Any

from robomend_client.events import Kind
from robomend_demo.record import Batch, Record, Round, StepRun

Interval = tuple[int, int]
NS = 1e9


@dataclass(frozen=True, slots=True)
class Figures:
    """Measured, in seconds and milliseconds; see docs/demo.md."""

    total_s: float
    detection_s: float
    service_share_s: float
    observation_to_diagnosis_ms: tuple[float, ...]
    diagnosis_to_plan_ms: float

    def json(self) -> dict[str, Any]:
        """Return the figures as demo.json has them."""
        latencies = self.observation_to_diagnosis_ms
        return {
            "total_s": round(self.total_s, 3),
            "detection_s": round(self.detection_s, 3),
            "service_share_s": round(self.service_share_s, 3),
            "observation_to_diagnosis_ms": {
                "p50": round(percentile(latencies, 50), 2),
                "p99": round(percentile(latencies, 99), 2),
                "max": round(max(latencies), 2),
                "count": len(latencies),
            },
            "diagnosis_to_plan_ms": round(self.diagnosis_to_plan_ms, 2),
        }


def figures(record: Record, *, from_plan: bool) -> Figures:
    """Return the figures of a scenario.

    Args:
        from_plan: count `total_s` from the first planned repair instead of from the scenario's beginning.
    """
    first = record.rounds[0]
    diagnosed_ns, observed_ns = _known(record, first)
    begin_ns = first.planned_arrived_ns if from_plan else record.zero_ns
    return Figures(
        total_s=(record.repaired_arrived_ns - begin_ns) / NS,
        detection_s=(diagnosed_ns - record.zero_ns) / NS,
        service_share_s=service_share_ns(record, observed_ns) / NS,
        observation_to_diagnosis_ms=tuple(latencies_ms(record)),
        diagnosis_to_plan_ms=(first.planned_arrived_ns - diagnosed_ns) / 1e6,
    )


def latencies_ms(record: Record) -> Iterable[float]:
    """Yield, for each new diagnosis, the time from accepting the observation to its arrival over HTTP."""
    accepted: dict[int, int] = {}
    for one in record.heard:
        data = one.event.data
        if one.event.kind is Kind.OBSERVATIONS:
            accepted[data["revision"]] = data["accepted_ns"]
        elif one.event.kind is Kind.DIAGNOSIS and accepted:
            covered = [revision for revision in accepted if revision <= data["revision"]]
            if covered:
                yield (one.arrived_ns - accepted[max(covered)]) / 1e6


def service_share_ns(record: Record, observed_ns: int) -> int:
    """Return the service's share of the time from the first decisive observation to the repair's end."""
    working = [busy for done in record.rounds for busy in _robot_at_work(record, done)]
    for done, following in zip(record.rounds, (*record.rounds[1:], None), strict=True):
        ended = max((run.ended_ns for run in done.steps if run.ended_ns is not None), default=None)
        if ended is None:
            continue
        if following is None:
            working.append((ended, _last_change_ns(record, record.repaired_ns)))
        elif done.looked_ns is not None:
            working.append((ended, done.looked_ns))
    end_ns = record.repaired_arrived_ns
    return end_ns - observed_ns - union_ns(working, observed_ns, end_ns)


def _robot_at_work(record: Record, done: Round) -> Iterable[Interval]:
    for run in done.steps:
        begun = run.taken_ns or run.sent_ns
        if begun is not None:
            yield begun, _shown_ns(record.batches, run, begun)


def _shown_ns(batches: Sequence[Batch], run: StepRun, begun_ns: int) -> int:
    """Return when the last of the observations was made that show a step's effect."""
    until = run.ended_ns or begun_ns
    shown = [begun_ns]
    for literal in run.seen:
        times = [batch.literals[literal] for batch in batches if literal in batch.literals]
        shown.extend(sorted(time for time in times if begun_ns <= time <= until)[:1])
    return until if run.state == "failed" else max(shown)


def _known(record: Record, first: Round) -> tuple[int, int]:
    """Return when what the first plan rests on was diagnosed (as a client saw it), and when it was observed.

    That is the first of the diagnoses that name whom the plan is against, up to the plan, or the batch with
    which every observer had been heard, whichever came later. The last diagnosis before the plan may have
    come while that was being made, and would make any planner look fast.
    """
    missing = set(record.unheard)
    heard, newest = (record.zero_ns, 0), (record.zero_ns, 0)  # when, and with which revision
    named: tuple[int, int] | None = None
    for one in record.heard:
        data, moment = one.event.data, one.arrived_ns
        if moment > first.planned_arrived_ns:
            break
        if one.event.kind is Kind.OBSERVATIONS and missing:
            missing -= {literal.removeprefix("not ") for literal in data["changed"]}
            if not missing:
                heard = moment, data["revision"]
        elif one.event.kind is Kind.DIAGNOSIS and one.event.time_ns <= first.planned_ns:
            newest = moment, data["revision"]
            named = (named or newest) if _names(data["result"], first.bad) else None
    arrived, revision = max(heard, named or newest)
    observed = [batch.observed_ns for batch in record.batches if batch.revision == revision]
    return arrived, observed[0] if observed else record.zero_ns


def _names(result: Mapping[str, Any] | None, bad: Sequence[str]) -> bool:
    return result is not None and any(set(one["bad"]) == set(bad) for one in result["diagnoses"])


def _last_change_ns(record: Record, before_ns: int) -> int:
    """Return when the observation was made that the last new diagnosis before a moment follows from."""
    revisions = [
        one.event.data["revision"]
        for one in record.heard
        if one.event.kind is Kind.DIAGNOSIS and one.event.time_ns <= before_ns
    ]
    observed = [
        batch.observed_ns for batch in record.batches if revisions and batch.revision == revisions[-1]
    ]
    return observed[0] if observed else before_ns


def union_ns(intervals: Iterable[Interval], begin_ns: int, end_ns: int) -> int:
    """Return how much of [begin, end] the intervals cover together."""
    covered, reached = 0, begin_ns
    for start, stop in sorted(intervals):
        start, stop = max(start, reached), min(stop, end_ns)
        if stop > start:
            covered += stop - start
            reached = stop
    return covered


def percentile(values: Sequence[float], percent: float) -> float:
    """Return the nearest-rank percentile."""
    ordered = sorted(values)
    return ordered[max(0, ceil(percent / 100 * len(ordered)) - 1)]
