"""What a scenario left behind, read once: the service's events, and when each observation was made. Pure.

Three clocks, all of this computer: an observation carries the time at which its observer made it, an event
the time at which its transaction began, and `arrived_ns` is when the demo had it, after the transaction was
on disk and the event had come over HTTP.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from robomend_client.events import Event, Kind

FINAL = frozenset({"repaired", "unconfirmed", "escalated", "cancelled", "failed"})


@dataclass(frozen=True, slots=True)
class Heard:
    """An event, and when it came."""

    event: Event
    arrived_ns: int


@dataclass(frozen=True, slots=True)
class Batch:
    """An accepted batch of observations; each literal with the time at which it was observed."""

    revision: int
    literals: Mapping[str, int]

    @property
    def observed_ns(self) -> int:
        """When its last literal was observed."""
        return max(self.literals.values(), default=0)

    @classmethod
    def of(cls, line: Mapping[str, Any]) -> Batch:
        """Return the batch of a line of GET …/history."""
        data = line["data"]
        return cls(data["revision"], {one["literal"]: one["time_ns"] for one in data["observations"]})


@dataclass(frozen=True, slots=True)
class StepRun:
    """One step of a plan, as it went."""

    text: str
    state: str
    sent_ns: int | None
    taken_ns: int | None  # an agent said that it has begun; None for the board's actions
    ended_ns: int | None
    seen: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class Round:
    """A diagnosis and the plan for it, as they were carried out."""

    planned_ns: int
    planned_arrived_ns: int
    bad: tuple[str, ...]
    good: tuple[str, ...]
    plan: tuple[str, ...]
    steps: tuple[StepRun, ...]
    looked_ns: int | None  # the end of looking whether it helped


@dataclass(frozen=True, slots=True)
class Record:
    """A scenario from `zero_ns` until its last repair was done."""

    name: str
    zero_ns: int
    heard: tuple[Heard, ...]
    batches: tuple[Batch, ...]
    rounds: tuple[Round, ...]
    repaired_ns: int
    repaired_arrived_ns: int
    unheard: frozenset[str]  # at `zero_ns`: atoms that observers report and had not yet said anything of
    account: tuple[str, ...] = ()  # the service's own, of its repairs


def record(
    name: str,
    zero_ns: int,
    heard: Sequence[Heard],
    history: Iterable[Mapping[str, Any]],
    unheard: Iterable[str],
    account: Iterable[str] = (),
) -> Record:
    """Return the record of what was heard since `zero_ns`; `history` are lines of GET …/history."""
    since = tuple(one for one in heard if one.event.time_ns >= zero_ns)
    batches = sorted((Batch.of(line) for line in history), key=lambda batch: batch.revision)
    ends = [one for one in since if one.event.kind is Kind.REPAIR and one.event.data["state"] == "repaired"]
    return Record(
        name=name,
        zero_ns=zero_ns,
        heard=since,
        batches=tuple(batch for batch in batches if batch.observed_ns >= zero_ns),
        rounds=tuple(_rounds(since)),
        repaired_ns=ends[-1].event.time_ns,
        repaired_arrived_ns=ends[-1].arrived_ns,
        unheard=frozenset(unheard),
        account=tuple(account),
    )


def _rounds(heard: Sequence[Heard]) -> Iterable[Round]:
    """Yield the rounds of all repairs, in order."""
    taken = {
        one.event.data["id"]: one.event.time_ns
        for one in reversed(heard)  # the first one counts
        if one.event.kind is Kind.ACTION
        and "repair" not in one.event.data
        and one.event.data["state"] == "running"
    }
    repairs = {one.event.data["id"]: one for one in heard if one.event.kind is Kind.REPAIR}
    for repair in repairs:
        told = [one for one in heard if one.event.kind is Kind.REPAIR and one.event.data["id"] == repair]
        runs = _runs([one.event for one in heard if one.event.data.get("repair") == repair], taken)
        for number, final in enumerate(told[-1].event.data["rounds"], start=1):
            of_round = [one for one in told if one.event.data["round"] == number]
            looked = [one.event.time_ns for one in of_round if one.event.data["rounds"][number - 1]["ending"]]
            yield Round(
                planned_ns=of_round[0].event.time_ns,
                planned_arrived_ns=of_round[0].arrived_ns,
                bad=tuple(final["diagnosis"]["bad"]),
                good=tuple(final["diagnosis"]["good"]),
                plan=tuple(step["text"] for step in final["plan"]),
                steps=tuple(runs[step["index"]] for step in final["plan"] if step["index"] in runs),
                looked_ns=looked[0] if looked else None,
            )


def _runs(events: Sequence[Event], taken: Mapping[str, int]) -> dict[int, StepRun]:
    """Return each step that was touched, from the last event that tells of it."""
    last = {event.data["index"]: event.data for event in events}
    return {
        index: StepRun(
            text=data["text"],
            state=data["state"],
            sent_ns=data["sent_ns"],
            taken_ns=taken.get(data["id"]) if data["id"] else None,
            ended_ns=data["ended_ns"],
            seen=tuple(data["seen"]),
        )
        for index, data in last.items()
    }
