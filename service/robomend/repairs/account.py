"""The record of a repair in words, for whoever reads it at 3 a.m.: one function, from the record alone.

    grounds   what a round's choice rests on, written when it begins: symptoms with their times, conflicts,
              the rivals that were weighed and did not win
    outcome   what is known of the symptoms when it ends, and since when
    account   all of it as lines

Nothing here looks at the robot as it is now: an account says the same whenever it is read.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from datetime import UTC, datetime
from typing import Any

from robomend.diagnosis.result import DiagnosisResult
from robomend.entry import Entry
from robomend.planning.choice import Choice
from robomend.repairs.states import StepState
from robomend_client.literals import Atom

Json = Mapping[str, Any]

MOST = 10
"""Symptoms, conflicts and rivals that a round keeps; the rest is counted."""


def grounds(result: DiagnosisResult, choice: Choice, entries: Iterable[Entry]) -> dict[str, Any]:
    """Return what a choice rests on, to be written with its round.

    Args:
        result: the diagnosis that was chosen from.
        entries: what is known of the robot; what does not hold are its symptoms.
    """
    bad = frozenset(choice.diagnosis.bad) if choice.diagnosis else frozenset()
    symptoms = sorted(
        (entry for entry in entries if not entry.positive),
        key=lambda entry: (entry.onset_ns or entry.since_ns or entry.time_ns, entry.literal),
    )
    conflicts = [one.text for one in result.conflicts if set(one.components) & bad]
    rivals = [one for one in choice.alternatives if frozenset(one.diagnosis.bad) != bad]
    chosen = next((one for one in choice.alternatives if frozenset(one.diagnosis.bad) == bad), None)
    return {
        "symptoms": [_seen(entry) for entry in symptoms[:MOST]],
        "symptoms_left_out": max(0, len(symptoms) - MOST),
        "conflicts": conflicts[:MOST],
        "weight": None if chosen is None else chosen.weight,
        "rivals": [
            {
                "bad": list(one.diagnosis.bad),
                "weight": one.weight,
                "helps": one.helps,
                "cost": one.plan.cost if one.plan.steps else None,
                "why": one.reason,
            }
            for one in rivals[:MOST]
        ],
    }


def outcome(round_: Json, entry_of: Mapping[Atom, Entry]) -> list[dict[str, Any]]:
    """Return what is known of a round's symptoms now; of one that nobody reports any more, nothing."""
    told = {symptom["literal"].removeprefix("not ") for symptom in round_.get("symptoms", ())}
    found = {str(atom): entry for atom, entry in entry_of.items()}
    return [_seen(found[atom]) for atom in sorted(told & found.keys())]


def account(repair: Json) -> list[str]:
    """Return a repair, as HTTP shows it, as lines: what was seen, why this, what was done, and then."""
    lines = [f"{_clock(repair['created_ns'])} repair {repair['id']} of {repair['robot']} begins"]
    for number, done in enumerate(repair["rounds"], start=1):
        lines += _round(number, done)
    if repair["waiting_for"]:
        lines.append(f"waiting for {', '.join(repair['waiting_for'])}")
    at = repair["finished_ns"] or repair["updated_ns"]
    lines.append(f"{_clock(at)} {repair['state']}: {repair['reason']}".rstrip(": "))
    return lines


def _round(number: int, done: Json) -> list[str]:
    lines = [f"round {number}: {', '.join(done['diagnosis']['bad'])} blamed{_weight(done.get('weight'))}"]
    lines += [f"  symptom {_observed(symptom)}" for symptom in done.get("symptoms", ())]
    if done.get("symptoms_left_out"):
        lines.append(f"  and {done['symptoms_left_out']} more symptoms")
    lines += [f"  conflict: {text}" for text in done.get("conflicts", ())]
    lines.append(f"  chosen: {done['why']}")
    lines += [f"  {not_chosen(rival, done)}" for rival in done.get("rivals", ())]
    for step in done["plan"]:
        lines.append(f"  {_step(step)}")
    lines += [f"  seen after it: {_observed(one)}" for one in done.get("after", ())]
    if done["ending"] is not None:
        helped = "it helped" if done.get("helped") else "it did not help"
        lines.append(f"  {helped}: {done.get('reason') or done['ending']}")
    return lines


def not_chosen(rival: Json, done: Json) -> str:
    """Return which rival of a round was not chosen, and why."""
    names = ", ".join(rival["bad"])
    why = rival["why"] if str(rival["why"]).startswith(names) else f"{names}: {rival['why']}"
    return f"not chosen{_weight(rival['weight'])}: {why}{_lost(rival, done)}"


def since(seen: Json) -> int | None:
    """Return since when what was seen is so, nanoseconds: what is bad since it turned bad."""
    bad = seen["literal"].startswith("not ")
    found: int | None = (seen["onset_ns"] if bad else None) or seen["since_ns"]
    return found


def _lost(rival: Json, done: Json) -> str:
    """Say why a rival lost, where its own words do not."""
    if rival["cost"] is None or not rival["helps"]:
        return ""
    weight = done.get("weight")
    if weight is not None and rival["weight"] < weight:
        return "; less probable"
    return f"; dearer, for {rival['cost']:g}" if rival["cost"] > sum(s["cost"] for s in done["plan"]) else ""


def _step(step: Json) -> str:
    if step.get("sent_ns") is None:
        return f"{step['text']}: {step.get('state', StepState.WAITING)}{_said(step)}"
    ended = f", ended {_clock(step['ended_ns'])}" if step.get("ended_ns") else ""
    seen = f"; seen: {', '.join(step['seen'])}" if step.get("seen") else ""
    missing = f"; not seen: {', '.join(step['missing'])}" if step.get("missing") else ""
    return (
        f"{step['text']}: sent {_clock(step['sent_ns'])}{ended}, {step['state']}{_said(step)}{seen}{missing}"
    )


def _said(step: Json) -> str:
    return f" ({step['message']})" if step.get("message") else ""


def _seen(entry: Entry) -> dict[str, Any]:
    return {"literal": str(entry.literal), "since_ns": entry.since_ns, "onset_ns": entry.onset_ns}


def _observed(seen: Json) -> str:
    began = since(seen)
    return f"{seen['literal']} since {_clock(began)}" if began else str(seen["literal"])


def _weight(weight: float | None) -> str:
    return "" if weight is None else f" (weight {weight:.2g})"


def _clock(time_ns: int) -> str:
    return datetime.fromtimestamp(time_ns / 1e9, UTC).strftime("%H:%M:%S.%f")[:-3]
