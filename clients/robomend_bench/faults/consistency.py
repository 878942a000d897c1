"""Whether what a repair says of itself is what happened: its words beside its record and what was observed.

A reason is put together while a repair runs, from what each part of it knows then; the record and the
history are what a person finds the next morning. Where the two say different things, one of them is wrong,
and nobody believes either. Here each repair that has ended is looked at.
"""

from __future__ import annotations

import re
from collections.abc import Collection, Iterable, Iterator, Mapping
from typing import Any

from robomend.repairs.conclusions import ALL_WELL, NAMED
from robomend.repairs.execution_values import Ending
from robomend.repairs.states import RepairState, StepState

Json = Mapping[str, Any]

FINISHED = frozenset({StepState.DONE, StepState.ALREADY})


def contradictions(repair: Json, observed: Collection[str] = ()) -> list[str]:
    """Return where a repair that has ended contradicts itself, in words; nothing if nowhere.

    Args:
        repair: as HTTP shows it, with its steps.
        observed: the literals that OBS held when it ended, as text, as far as they are known.
    """
    return [*_of_the_end(repair, observed), *_of_the_rounds(repair)]


def _of_the_end(repair: Json, observed: Collection[str]) -> Iterator[str]:
    state, reason = RepairState(repair["state"]), str(repair["reason"])
    failing = sorted(one for one in observed if one.startswith("not "))
    if not reason:
        yield f"{state} for no reason"
    if state is RepairState.REPAIRED:
        if any(one not in reason for one in failing[:NAMED]):
            yield f"repaired, but OBS has {', '.join(failing)}, of which the reason says nothing"
        if any(step["state"] == StepState.RUNNING for step in _steps(repair)):
            yield "repaired, and a step is under way"
    elif ALL_WELL in reason:
        yield f"{state}, and {ALL_WELL}"
    left = re.findall(r"; left (?:off|stopped): ([\w, ./-]+)", reason)
    for name in {name for names in left for name in names.split(", ")} - set(repair["left_off"]):
        yield f"{name} is left off in the reason and not in the record"
    for text, times in re.findall(r"([\w-]+\([^()]*\)): it was done (\d+) times", reason):
        sent = sum(_times(step) for step in _steps(repair) if step["text"] == text)
        if sent < int(times):
            yield f"{text} was done {times} times in the reason and {sent} times in the record"
    for text, names in re.findall(r"([\w-]+\([^()]*\)) answered 'done', but (.+?) (?:was|were) not", reason):
        if not any(step["text"] == text and _lacks(step, names) for step in _steps(repair)):
            yield f"the record has no {text} of which {names} was not seen"


def _of_the_rounds(repair: Json) -> Iterator[str]:
    for number, one in enumerate(repair["rounds"], start=1):
        where, steps = f"round {number}", one["plan"]
        undone = [step["text"] for step in steps if step["state"] not in FINISHED]
        lacking = [step["text"] for step in steps if step.get("missing")]
        if one["ending"] is None:
            yield f"{where} has no end"
        if one["ending"] == Ending.DONE and (undone or lacking):
            yield f"{where} is done, but not {', '.join([*undone, *lacking])}"
        if one["ending"] == Ending.EFFECT_MISSING and not lacking:
            yield f"{where} ended as an effect was missing, and none is"
        if one["ending"] == Ending.ACTION_FAILED and not any(
            step["state"] == StepState.FAILED and step["result"] != 0 for step in steps
        ):
            yield f"{where} ended as an action failed, and none did"
        for step in steps:
            yield from (f"{where}: {why}" for why in _of_a_step(step))
    last = repair["rounds"][-1] if repair["rounds"] else None
    if last is not None and repair["state"] == RepairState.REPAIRED and last["ending"] == Ending.HALTED:
        yield "repaired, though its last round was halted"


def _of_a_step(step: Json) -> Iterator[str]:
    text, missing = step["text"], set(step.get("missing", ()))
    if both := sorted(missing.intersection(step.get("seen", ()))):
        yield f"{text}: {', '.join(both)} was seen and was missing"
    if step["state"] == StepState.DONE and step["result"] != 0 and not step.get("seen"):
        yield f"{text} is done, though its action ended with {step['result']} and nothing was seen of it"
    sent_ns, ended_ns = step.get("sent_ns"), step.get("ended_ns")
    if sent_ns and ended_ns and ended_ns < sent_ns:
        yield f"{text} ended before it was sent"


def _lacks(step: Json, names: str) -> bool:
    missing = set(step.get("missing", ()))
    told = set(re.findall(r"(?:not )?\w+\([^()]*\)", names))
    return bool(told) and told <= missing


def _steps(repair: Json) -> Iterable[Json]:
    return (step for one in repair["rounds"] for step in one["plan"])


def _times(step: Json) -> int:
    if step.get("sent_ns") is None:
        return 0
    return 1 + int(str(step.get("id") or "").partition(":")[2].partition(".")[2] or 0)
