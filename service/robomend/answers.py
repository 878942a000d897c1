"""Results and plans as JSON values, the same over HTTP, in events and from the commands."""

from __future__ import annotations

from typing import Any

from robomend.diagnosis.explanations import explain_diagnosis, what_was_learned
from robomend.diagnosis.result import DiagnosisResult
from robomend.repair.plan import Plan


def result_json(result: DiagnosisResult) -> dict[str, Any]:
    """Return an engine's answer; `elapsed_s` is the diagnosis alone."""
    return {
        "diagnoses": [
            {
                "bad": list(diagnosis.bad),
                "good": list(result.good(diagnosis)),
                "probability": diagnosis.probability,
                "modes": dict(diagnosis.modes),
                "text": explain_diagnosis(diagnosis, result.conflicts),
            }
            for diagnosis in result.diagnoses
        ],
        "complete": result.complete,
        "stopped_by": result.stopped_by,
        "conflicts": [
            {
                "components": list(conflict.components),
                "observations": [str(literal) for literal in conflict.observations],
                "rules": list(conflict.rules),
                "text": conflict.text,
            }
            for conflict in result.conflicts
        ],
        "elapsed_s": result.elapsed_s,
        "unused": [str(literal) for literal in result.unused],
        "count": result.count,
        "cleared": dict(result.cleared),
        "learned": what_was_learned(result.conflicts, result.learned),
    }


def plan_json(plan: Plan) -> dict[str, Any]:
    """Return a plan: its steps in a valid serial order, each with what must be done before it."""
    return {
        "outcome": str(plan.outcome),
        "steps": [
            {
                "index": step.index,
                "name": step.name,
                "parameters": list(step.parameters),
                "cost": step.cost,
                "after": list(step.after),
                "preconditions": [str(literal) for literal in step.preconditions],
                "effects": [str(literal) for literal in step.effects],
                "text": str(step),
            }
            for step in plan.steps
        ],
        "cost": plan.cost,
        "planner": plan.planner,
        "assumed": [str(literal) for literal in plan.assumed],
        "unreachable": list(plan.unreachable),
        "excluded": list(plan.excluded),
        "elapsed_s": plan.elapsed_s,
        "pddl": None if plan.pddl is None else {"domain": plan.pddl[0], "problem": plan.pddl[1]},
    }
