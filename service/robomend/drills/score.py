"""The score of drills against what was promised of each fault; pure, over the JSON of plan and drills.

An outcome has the words of a promise: the fault was `told` (the only diagnosis before the first act), one
`among` several, `missed` (another was blamed) or `unseen`. A drill that comes out worse than its promise
names what to look at: an observer that did not say what the rules predict, or rules that did not predict
what was observed.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from statistics import median
from typing import Any

from robomend.drills.record import DrillState
from robomend.planning.faults import fault_name
from robomend_client.counts import counted

Json = Mapping[str, Any]

FORMAT = 1
OUTCOMES = ("unseen", "missed", "among", "told")
"""From the worst to the best."""


def name_of(row: Json) -> str:
    """Return the name of a row's fault; reports of older versions know no topics."""
    return fault_name(row["fault"], row["component"], row.get("topic"))


def keeps(component: str | None, promise: str, outcome: str) -> bool:
    """Return whether an outcome is no worse than promised: nobody is blamed where nobody is at fault."""
    if component is None:
        return outcome == promise
    return OUTCOMES.index(outcome) >= OUTCOMES.index(promise)


def outcome_of(component: str | None, seen: Json) -> str:
    """Return what a drill came to, in the words of a promise."""
    if seen["detected_s"] is None or not seen["diagnoses"]:
        return "unseen"
    if seen["diagnoses"] == [[component]]:
        return "told"
    return "among" if [component] in seen["diagnoses"] else "missed"


def scored(planned: Json, drill: Json | None, why_not: str = "") -> dict[str, Any]:
    """Return the row of one fault: its promise, and what its drill came to.

    Args:
        planned: the fault as the plan has it.
        drill: as the service tells of it, ended; None: it was not carried out.
        why_not: the reason then.
    """
    row: dict[str, Any] = {
        "fault": planned["kind"],
        "component": planned["component"],
        "topic": planned.get("topic"),
        "promise": planned["promise"],
        "shows": list(planned["shows"]),
        "drill": None if drill is None else drill["id"],
        "state": None if drill is None else drill["state"],
        "undone": True if drill is None else drill["undone"],
        "why_not": why_not if drill is None else drill["cut_short"] or "",
        "outcome": None,
        "kept": None,
        "look_at": [],
    }
    if drill is None:
        return row
    seen = drill["seen"]
    if drill["state"] in {DrillState.REFUSED, DrillState.FAILED}:
        row["why_not"] = row["why_not"] or drill["reason"]
    if seen is None or drill["cut_short"]:
        return row
    outcome = outcome_of(planned["component"], seen)
    kept = keeps(planned["component"], planned["promise"], outcome)
    return {
        **row,
        "outcome": outcome,
        "kept": kept,
        "diagnoses": seen["diagnoses"],
        "detected_s": seen["detected_s"],
        "repaired": seen["repaired_s"] is not None,
        "repaired_s": seen["repaired_s"],
        "repair": seen["repair"],
        "repair_state": seen["repair_state"],
        "repair_reason": seen["repair_reason"],
        "acts": seen["acts"],
        "needless": seen["needless"],
        "look_at": [] if kept else list(_to_look_at(planned, seen)),
    }


def _to_look_at(planned: Json, seen: Json) -> Iterable[str]:
    """Yield what made a drill worse than its promise, as far as it can be named."""
    showed, acted_s = seen["showed"], seen["acted_s"]
    before = {text for text, at_s in showed.items() if acted_s is None or at_s <= acted_s}
    named = False
    for text in planned["shows"]:
        who = planned.get("observers", {}).get(_atom(text))
        observer = f"the observer of {_atom(text)}" + (f" ({who})" if who else "")
        if text not in showed:
            named = True
            yield f"{observer}: `{text}` was to be seen, and was not"
        elif text not in before:
            named = True
            yield (
                f"{observer}: it said `{text}` after {showed[text]:g} s, when the repair "
                f"had begun to act ({acted_s:g} s); a longer `hold_s` would have waited for it"
            )
    for text in sorted(before - set(planned["shows"])):
        named = True
        yield f"the rules about {_atom(text)}: `{text}` was seen, and none predicts it of this fault"
    if not named:
        yield (
            "the rules: all that they predict was seen, and nothing else; "
            "`robomend model check --isolability` says what to watch in addition"
        )


def _atom(literal: str) -> str:
    return literal.removeprefix("not ")


def totals(rows: Sequence[Json]) -> dict[str, Any]:
    """Return the figures of all rows; times are medians, of what was detected or repaired."""
    done = [row for row in rows if row["outcome"] is not None]
    promised = [row for row in done if row["promise"] == "told"]
    detected = [row["detected_s"] for row in done if row["detected_s"] is not None]
    repaired = [row["repaired_s"] for row in done if row["repaired_s"] is not None]
    return {
        "faults": len(rows),
        "watched": len(done),
        "detected": sum(row["outcome"] != "unseen" for row in done),
        "told": sum(row["outcome"] == "told" for row in done),
        "promised_told": len(promised),
        "promised_and_told": sum(row["outcome"] == "told" for row in promised),
        "repaired": len(repaired),
        "acts": sum(len(row["acts"]) for row in done),
        "needless": sum(len(row["needless"]) for row in done),
        "detected_s": round(median(detected), 3) if detected else None,
        "repaired_s": round(median(repaired), 3) if repaired else None,
        "worse": sum(row["kept"] is False for row in done),
        "not_undone": sum(not row["undone"] for row in rows),
        "not_well": sum(row["state"] == DrillState.FAILED for row in rows),
    }


def report(robot: str, rows: Sequence[Json], complete: bool) -> dict[str, Any]:
    """Return what `robomend drill --format json` prints."""
    return {
        "robomend_drill": FORMAT,
        "robot": robot,
        "faults": list(rows),
        "totals": totals(rows),
        "complete": complete,
    }


def passed(told: Json) -> bool:
    """Return whether every drill was watched to its end, kept its promise, and is undone."""
    sums = told["totals"]
    return sums["watched"] == sums["faults"] and not (sums["worse"] or sums["not_undone"] or sums["not_well"])


def compared(now: Json, last: Json) -> dict[str, list[str]]:
    """Return what is worse, better and slower than in an earlier report, and what only one of them has.

    Raises:
        ValueError: the earlier one is no such report.
    """
    if last.get("robomend_drill") != FORMAT or not isinstance(last.get("faults"), list):
        raise ValueError("it is no report of `robomend drill --format json`")
    before = {name_of(row): row for row in last["faults"]}
    after = {name_of(row): row for row in now["faults"]}
    found: dict[str, list[str]] = {"worse": [], "better": [], "slower": [], "only_now": [], "only_then": []}
    for name, row in after.items():
        if name not in before:
            found["only_now"].append(name)
            continue
        for what, text in _changes(before[name], row):
            found[what].append(f"{name}: {text}")
    found["only_then"] = sorted(before.keys() - after.keys())
    return found


def _changes(then: Json, now: Json) -> Iterable[tuple[str, str]]:
    """Yield (worse, better or slower; in words) for one fault."""
    if then["outcome"] is None or now["outcome"] is None:
        if then["outcome"] is not None:
            yield "worse", f"was {then['outcome']}, and is not watched to its end: {now['why_not']}"
        return
    if then["outcome"] != now["outcome"]:
        better = keeps(now["component"], then["outcome"], now["outcome"])
        yield "better" if better else "worse", f"was {then['outcome']}, is {now['outcome']}"
    if then["repaired"] != now["repaired"]:
        yield (
            "better" if now["repaired"] else "worse",
            "is repaired now" if now["repaired"] else f"was repaired, and is not: {now['repair_reason']}",
        )
    more = len(now["needless"]) - len(then["needless"])
    if more:
        yield (
            "worse" if more > 0 else "better",
            f"{counted(abs(more), 'needless act')} {'more' if more > 0 else 'fewer'}",
        )
    for what in ("detected_s", "repaired_s"):
        if then[what] is not None and now[what] is not None and now[what] > 2 * then[what] + 1.0:
            yield "slower", f"{what.removesuffix('_s')} after {now[what]:g} s, {then[what]:g} s before"
