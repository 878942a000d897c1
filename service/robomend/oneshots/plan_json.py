"""A choice and its plan as JSON: the same from `robomend plan`, POST /plans and POST /robots/{id}/plans."""

from __future__ import annotations

from collections.abc import Collection
from typing import Any

from robomend.diagnosis.result import Diagnosis
from robomend.planning.choice import Alternative, Choice, Look
from robomend.planning.plan import Plan


def choice_json(choice: Choice, components: Collection[str]) -> dict[str, Any]:
    """Return what to do first, with its plan, and what else could be done."""
    return {
        "choice": _diagnosis(choice.diagnosis, components, _weight(choice)) if choice.diagnosis else None,
        "plan": plan_json(choice.plan) if choice.plan else None,
        "probe": _look(choice.probe) if choice.probe else None,
        "alternatives": [_alternative(one, components) for one in choice.alternatives],
        "expected_cost": round(choice.expected_cost, 6),
        "reason": choice.reason,
    }


def plan_json(plan: Plan) -> dict[str, Any]:
    """Return a plan: its steps in a valid serial order, each with what must be done before it; and as a
    graph.
    """
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
        "graph": {
            "nodes": [str(step) for step in plan.steps],
            "edges": [[before, step.index] for step in plan.steps for before in step.after],
            "layers": [list(layer) for layer in layers(plan)],
        },
    }


def layers(plan: Plan) -> list[tuple[int, ...]]:
    """Return the steps by the earliest moment at which they can start when every action takes one moment."""
    depth: list[int] = []
    for step in plan.steps:
        depth.append(1 + max((depth[before] for before in step.after), default=-1))
    return [
        tuple(step.index for step in plan.steps if depth[step.index] == level)
        for level in range(max(depth, default=-1) + 1)
    ]


def _weight(choice: Choice) -> float | None:
    return next((one.weight for one in choice.alternatives if one.diagnosis == choice.diagnosis), None)


def _diagnosis(diagnosis: Diagnosis, components: Collection[str], weight: float | None) -> dict[str, Any]:
    bad = frozenset(diagnosis.bad)
    return {
        "bad": list(diagnosis.bad),
        "good": [name for name in components if name not in bad],
        "probability": diagnosis.probability,
        "weight": None if weight is None else round(weight, 6),
    }


def _alternative(one: Alternative, components: Collection[str]) -> dict[str, Any]:
    return {
        **_diagnosis(one.diagnosis, components, one.weight),
        "outcome": str(one.plan.outcome),
        "actions": [str(step) for step in one.plan.steps],
        "cost": one.plan.cost,
        "helps": round(one.helps, 6),
        "failures": one.failures,
        "unreachable": list(one.plan.unreachable),
        "reason": one.reason,
    }


def _look(look: Look) -> dict[str, Any]:
    return {"observe": str(look.atom), "cost": look.cost}
