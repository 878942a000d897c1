"""A repair and its steps as JSON: what is written of them, and what HTTP and events show."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import asdict
from typing import Any

from robomend.entry import Entry
from robomend.model.components import ComponentModel
from robomend.planning.plan import Plan, Step, power_note
from robomend.repairs.execution_values import StepReport
from robomend.repairs.headline import of_repair
from robomend.repairs.states import StepState
from robomend.store.records import StepRecord, StoredRepair
from robomend.timestamps import rfc3339


def step_number(action_id: str) -> int:
    """Return the step of an action id: 2 for `r-1:2` and for its retry `r-1:2.1`."""
    return int(action_id.rpartition(":")[2].partition(".")[0])


def plan_json(
    plan: Plan, first: int, model: ComponentModel | None, entries: Iterable[Entry]
) -> list[dict[str, Any]]:
    """Return the steps of a plan, numbered within their repair."""
    cuts = {step.parameters[0] for step in plan.steps if step.name == "shutdown" and step.parameters}
    steps = [_step_json(step, first) for step in plan.steps]
    if model is None or not cuts:
        return steps
    off = {e.atom.args[0] for e in entries if e.atom.predicate == "on" and e.atom.args and not e.positive}
    for step in steps:
        if step["name"] == "shutdown" and (cut := step["parameters"][0]) in model.hardware:
            step["note"] = power_note(model, cut, cuts - {cut}, off)
    return steps


def _step_json(step: Step, first: int) -> dict[str, Any]:
    return {
        "index": first + step.index,
        "name": step.name,
        "parameters": list(step.parameters),
        "after": [first + before for before in step.after],
        "cost": step.cost,
        "text": str(step),
    }


def report_json(report: StepReport, number: int) -> dict[str, Any]:
    """Return how far a step came."""
    return {
        "id": report.action_id,
        "index": number,
        "name": report.step.name,
        "parameters": list(report.step.parameters),
        "text": str(report.step),
        "state": str(report.state),
        "result": None if report.result is None else report.result.code,
        "message": report.reason or (report.result.message if report.result else ""),
        "seen": [str(literal) for literal in report.seen],
        "missing": [str(literal) for literal in report.missing],
        "feedback": None if report.feedback is None else asdict(report.feedback),
        "sent_ns": report.sent_ns,
        "ended_ns": report.ended_ns,
    }


def change_json(change: StoredRepair, steps: Sequence[StepRecord] = ()) -> dict[str, Any]:
    """Return a change of configuration as HTTP and events show it."""
    data = dict(change.data)
    reports = {record.step: record.data for record in steps}
    waiting = {"state": StepState.WAITING, "result": None, "message": "", "feedback": None}
    changed_ns = data.get("changed_ns")
    return {
        "id": change.id,
        "robot": change.robot,
        "state": change.state,
        "changes": [
            {
                **one,
                "held": one.get("held"),
                "back": None if one["back_ns"] is None else rfc3339(one["back_ns"]),
                "text": _in_words(one, changed_ns),
            }
            for one in data.get("changes", ())
        ],
        "plan": [{**waiting, **step, **reports.get(step["index"], {})} for step in data.get("plan", ())],
        "cost": data.get("cost"),
        "reason": data.get("reason", ""),
        "by": data.get("by"),
        "notify": data.get("notify", False),
        "changed_ns": changed_ns,
        "changed": None if changed_ns is None else rfc3339(changed_ns),
        "created_ns": change.created_ns,
        "created": rfc3339(change.created_ns),
        "updated_ns": change.updated_ns,
        "updated": rfc3339(change.updated_ns),
        "finished_ns": None if change.open else change.updated_ns,
        "finished": None if change.open else rfc3339(change.updated_ns),
    }


def _in_words(change: dict[str, Any], changed_ns: int | None) -> str:
    said = f"{change['function']}: {change['from']} → {change['to']}"
    if changed_ns is not None:
        said += f" at {rfc3339(changed_ns)[11:19]}"
    said += f", as {change['reason']}" if change["reason"] else ""
    if change["back_ns"] is not None:
        return f"{said}; back at {rfc3339(change['back_ns'])[11:19]}"
    return f"{said}; {change['held']}" if change.get("held") else said


def repair_json(repair: StoredRepair, steps: Sequence[StepRecord] = ()) -> dict[str, Any]:
    """Return a repair as HTTP and events show it; the steps of its present plan carry how far they came."""
    data = dict(repair.data)
    reports = {record.step: record.data for record in steps}
    waiting = {"state": StepState.WAITING, "result": None, "message": "", "feedback": None}
    plan = [{**waiting, **step, **reports.get(step["index"], {})} for step in data.get("plan", ())]
    rounds = [
        {**one, "plan": [{**waiting, **step, **reports.get(step["index"], {})} for step in one["plan"]]}
        for one in data.get("rounds", ())
    ]
    shown = {
        "id": repair.id,
        "robot": repair.robot,
        "state": repair.state,
        "policy": data.get("policy"),
        "drill": data.get("drill"),
        "again": data.get("again"),
        "retry_ns": data.get("retry_ns"),
        "retry": None if data.get("retry_ns") is None else rfc3339(data["retry_ns"]),
        "round": data.get("round", 0),
        "diagnosis": data.get("diagnosis"),
        "plan": plan,
        "rounds": rounds,
        "unmended": data.get("unmended"),
        "cost": data.get("cost"),
        "assumed": data.get("assumed", []),
        "unreachable": data.get("unreachable", []),
        "doubts": data.get("doubts", []),
        "left_off": sorted(data.get("left_off") or ()),
        "waiting_for": data.get("waiting_for", []),
        "waits": data.get("waits", []),
        "probe": data.get("probe"),
        "reason": data.get("reason", ""),
        "optional": data.get("optional", False),
        "by": data.get("by"),
        "created_ns": repair.created_ns,
        "updated_ns": repair.updated_ns,
        "finished_ns": None if repair.open else repair.updated_ns,
        "created": rfc3339(repair.created_ns),
        "updated": rfc3339(repair.updated_ns),
        "finished": None if repair.open else rfc3339(repair.updated_ns),
    }
    return {**shown, "headline": of_repair(shown).text(repair.updated_ns)}
