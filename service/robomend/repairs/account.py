"""The record of a repair in words, for whoever reads it at 3 a.m.: one function, from the record alone.

    grounds   what a round's choice rests on, written when it begins: symptoms with their times, conflicts,
              the rivals that were weighed and did not win
    outcome   what is known of the symptoms when it ends, and what else does not hold then, and since when
    account   all of it as lines

Nothing here looks at the robot as it is now: an account says the same whenever it is read.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping
from datetime import UTC, datetime
from typing import Any

from robomend.diagnosis.result import DiagnosisResult
from robomend.entry import Entry
from robomend.model.vocabulary import ACTIVE, TRENDS
from robomend.planning.choice import Choice
from robomend.planning.plan import in_prose, step_title
from robomend.repairs.execution_values import Ending
from robomend.repairs.headline import began, observed, seen, surely
from robomend.repairs.states import StepState
from robomend_client.counts import counted
from robomend_client.literals import Atom, Literal

Json = Mapping[str, Any]

MOST = 10
"""Symptoms, conflicts and rivals that a round keeps; the rest is counted."""


def _symptom(entry: Entry, blamed_for: Collection[Literal] = ()) -> bool:
    """Whether it does not hold and should. That a variant is not active is no symptom, nor that a value that
    rises does not fall, unless something is blamed for it.
    """
    known = entry.atom.predicate not in (ACTIVE, *TRENDS) or entry.literal in blamed_for
    return not entry.positive and known


def grounds(result: DiagnosisResult, choice: Choice, entries: Iterable[Entry]) -> dict[str, Any]:
    """Return what a choice rests on, to be written with its round.

    Args:
        result: the diagnosis that was chosen from.
        entries: what is known of the robot; what does not hold are its symptoms.
    """
    bad = frozenset(blamed(result, choice))
    blamed_for = {literal for one in result.conflicts for literal in one.observations}
    symptoms = sorted((one for one in entries if _symptom(one, blamed_for)), key=began)
    rests = [(one.components, tuple(map(str, one.observations))) for one in result.conflicts]
    conflicts = [one.text for one in result.conflicts if set(one.components) & bad]
    rivals = [one for one in choice.alternatives if frozenset(one.diagnosis.bad) != bad]
    chosen = next((one for one in choice.alternatives if frozenset(one.diagnosis.bad) == bad), None)
    return {
        "symptoms": [seen(entry, rests) for entry in symptoms[:MOST]],
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


def blamed(result: DiagnosisResult, choice: Choice) -> tuple[str, ...]:
    """Return what is blamed by the diagnosis that was chosen, or the leading one where nothing mends any."""
    found = choice.diagnosis or next(iter(result.diagnoses), None)
    return () if found is None else tuple(found.bad)


def outcome(round_: Json, entry_of: Mapping[Atom, Entry]) -> list[dict[str, Any]]:
    """Return what is known of a round's symptoms now, and what else does not hold; of a symptom that nobody
    reports any more, nothing.
    """
    told = {symptom["literal"].removeprefix("not ") for symptom in round_.get("symptoms", ())}
    found = {str(atom): entry for atom, entry in entry_of.items()}
    new = sorted(atom for atom, entry in found.items() if _symptom(entry) and atom not in told)
    return [_seen(found[atom]) for atom in (*sorted(told & found.keys()), *new[:MOST])]


def account(repair: Json) -> list[str]:
    """Return a repair, as HTTP shows it, as lines: what was seen, why this, what was done, and then."""
    lines = [f"{_clock(repair['created_ns'])} repair {repair['id']} of {repair['robot']} begins"]
    if again := repair.get("again"):
        times = counted(again["times"], "time")
        lines.append(f"it takes up {again['of']}, which {again['why']}: by itself, {times} since then")
    waits = repair.get("waits", ())
    for number, done in enumerate(repair["rounds"], start=1):
        lines += (_waited(wait) for wait in waits if wait["round"] == number)
        lines += _round(number, done)
    lines += (_waited(wait) for wait in waits if wait["round"] > len(repair["rounds"]))
    if vain := repair.get("unmended"):
        lines.append(
            f"{_clock(vain['began_ns'])} {', '.join(vain['diagnosis']['bad'])} blamed, and not mended"
        )
        lines += _grounds(vain)
    lines += [one["text"] for one in repair.get("doubts", ())]
    if repair["waiting_for"]:
        lines.append(f"waiting for {in_prose(', '.join(repair['waiting_for']))}")
    at = repair["finished_ns"] or repair["updated_ns"]
    lines.append(f"{_clock(at)} {repair['state']}: {in_prose(repair['reason'])}".rstrip(": "))
    if repair.get("retry_ns"):
        lines.append(f"tried again by itself at {_clock(repair['retry_ns'])}, unless it is well by then")
    return lines


def _round(number: int, done: Json) -> list[str]:
    at = f"{_clock(done['began_ns'])} " if done.get("began_ns") else ""
    lines = [f"{at}round {number}: {', '.join(done['diagnosis']['bad'])} blamed{_belief(done.get('weight'))}"]
    lines += _grounds(done)
    for step in done["plan"]:
        lines.append(f"  {_step(step, ended=done['ending'] is not None)}")
    lines += [f"  seen after it: {_observed(one)}{_anew(one, done)}" for one in done.get("after", ())]
    if done["ending"] is not None:
        lines.append(f"  {how_it_ended(done)}")
    return lines


def _grounds(done: Json) -> list[str]:
    lines = [f"  symptom {_observed(symptom)}" for symptom in done.get("symptoms", ())]
    if done.get("symptoms_left_out"):
        lines.append(f"  and {counted(done['symptoms_left_out'], 'more symptom')}")
    lines += [f"  conflict: {text}" for text in done.get("conflicts", ())]
    if done.get("why"):
        lines.append(f"  chosen: {in_prose(done['why'])}")
    return [*lines, *(f"  {not_chosen(rival, done)}" for rival in done.get("rivals", ()))]


def not_chosen(rival: Json, done: Json) -> str:
    """Return which rival of a round was not chosen, and why."""
    names = ", ".join(rival["bad"])
    why = rival["why"] if str(rival["why"]).startswith(names) else f"{names}: {rival['why']}"
    return f"not chosen: {in_prose(why)}{_lost(rival, done)}"


def since(seen: Json) -> int | None:
    """Return since when what was seen is so, nanoseconds: what goes on being so rests on younger evidence."""
    found: int | None = seen["onset_ns"] or seen["since_ns"]
    return found


def how_it_ended(done: Json, *, brief: bool = False) -> str:
    """Return how a round ended, in words; whether it helped and whether all of it was done are two things.

    Args:
        brief: without a reason that a step of the plan has said already.
    """
    said = {step.get("message") for step in done["plan"]}
    if brief and not done.get("helped") and done.get("reason") in said:
        return "it did not help"
    why, bad = in_prose(done.get("reason") or done["ending"]), " and ".join(done["diagnosis"]["bad"])
    if done.get("by_itself"):
        return f"well again, and credited to nobody: {in_prose(done['by_itself'])}"
    if done.get("undid"):
        fails = ", ".join(f"not {one}" for one in done["undid"])
        return in_prose(f"it did not help: {bad} is well again, and since it: {fails}")
    if not done.get("helped"):
        untouched = done["plan"] and all(step.get("state") == StepState.WAITING for step in done["plan"])
        return f"{'nothing of it was done' if untouched else 'it did not help'}: {why}"
    if done["ending"] == Ending.DONE:
        return f"it helped: {why}"
    return f"it helped, as nothing blames {bad} any more, and was not done to its end: {why}"


def waited(wait: Json) -> str:
    """Say what was waited for before a round, and for how long."""
    lasted = f", for {(wait['until_ns'] - wait['from_ns']) / 1e9:.1f} s" if wait.get("until_ns") else ""
    return in_prose(f"waiting {wait['why']}: {', '.join(wait['names'])}{lasted}")


def _waited(wait: Json) -> str:
    return f"{_clock(wait['from_ns'])} {waited(wait)}"


def _lost(rival: Json, done: Json) -> str:
    """Say why a rival lost, where its own words do not."""
    if rival["cost"] is None or not rival["helps"]:
        return ""
    weight, cost = done.get("weight"), sum(step["cost"] for step in done["plan"])
    lost = ["a less probable cause"] if weight is not None and rival["weight"] < weight else []
    lost += [f"dearer than {cost:g}"] if rival["cost"] > cost else []
    if lost:  # it may help more probably all the same: it mends more than its own cause
        return f"; {', and '.join(lost)}"
    return "; as good" if rival["cost"] == cost and rival["weight"] == weight else ""


def _step(step: Json, *, ended: bool) -> str:
    title = step_title(step)
    if step.get("sent_ns") is None:
        state = step.get("state", StepState.WAITING)
        return f"{title}: {'not begun' if ended and state == StepState.WAITING else state}{_said(step)}"
    until = f", ended {_clock(step['ended_ns'])}" if step.get("ended_ns") else ""
    seen = f"; seen: {in_prose(', '.join(step['seen']))}" if step.get("seen") else ""
    missing = f"; not seen: {in_prose(', '.join(step['missing']))}" if step.get("missing") else ""
    # A step whose action answered and whose effect was not seen has failed; it is not its action that did.
    state = "effect missing" if missing else step["state"]
    sent = f"sent {_times(step)}{_clock(step['sent_ns'])}"
    return f"{title}: {sent}{until}, {state}{_said(step)}{seen}{missing}"


def _times(step: Json) -> str:
    """Say how often a step was sent, if more than once: each retry has an id of its own, `repair:step.1`."""
    _, _, retry = str(step.get("id") or "").rpartition(":")[2].partition(".")
    return f"{int(retry) + 1} times, the last " if retry else ""


def _said(step: Json) -> str:
    if step.get("missing"):
        return " (its action answered 'done')"  # what was not seen of it follows
    if step.get("result") and step.get("state") == StepState.DONE:  # what counts is what was seen of it
        return f" (although its action answered {step['result']}: {in_prose(step['message'])})"
    return f" ({in_prose(step['message'])})" if step.get("message") else ""


def _seen(entry: Entry) -> dict[str, Any]:
    seen = {"literal": str(entry.literal), "since_ns": entry.since_ns, "onset_ns": entry.onset_ns}
    return seen if entry.reading is None else {**seen, "reading": entry.measured()}


def _observed(seen: Json) -> str:
    began = since(seen)
    return f"{observed(seen)} since {_clock(began)}" if began else observed(seen)


def _anew(seen: Json, done: Json) -> str:
    """Say of what was so before the round, too, since when it was seen to be so after it."""
    began, fresh = done.get("began_ns"), seen["since_ns"]
    if not began or not fresh or seen["literal"].startswith("not ") or not (since(seen) or 0) < began < fresh:
        return ""
    return f", and anew since {_clock(fresh)}"


def _belief(weight: float | None) -> str:
    return "" if weight is None or not (words := surely(weight)) else f" ({words})"


def _clock(time_ns: int) -> str:
    return datetime.fromtimestamp(time_ns / 1e9, UTC).strftime("%H:%M:%S.%f")[:-3]
