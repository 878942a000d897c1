"""From a diagnosis result to what to do next, and the answer as JSON: the planning half of the loop.

    result ──► leading diagnoses, and what they share ──► a plan for each (worker) ──► choice

The service, the stateless one-shots and the command line all go through here.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass
from typing import Any

from robomend.diagnosis.probes import ProbeResult
from robomend.diagnosis.result import Diagnosis, DiagnosisResult
from robomend.errors import ModelError
from robomend.model.components import ComponentModel
from robomend.model.system import System
from robomend.planning.choice import (
    Alternative,
    Attempt,
    Candidate,
    Choice,
    Look,
    Patience,
    choose,
    common_part,
    leading,
)
from robomend.planning.plan import Plan
from robomend_client.literals import Literal

DEFAULT_PATIENCE = Patience()


@dataclass(frozen=True)
class Situation:
    """Everything that choosing rests on: values only."""

    model: ComponentModel
    observed: tuple[Literal, ...]
    result: DiagnosisResult
    tried: tuple[Attempt, ...] = ()
    probes: ProbeResult | None = None  # only those that somebody can make now
    now_ns: int = 0
    patience: Patience = DEFAULT_PATIENCE

    @property
    def wanted(self) -> tuple[Diagnosis, ...]:
        """The diagnoses to plan for, the shared part last where there is one."""
        found = self.leading
        certain = self.result.certain  # the leading ones may share more than all do
        shared = tuple(name for name in common_part(found) if name in certain)
        return (*found, Diagnosis(shared)) if shared else found

    @property
    def leading(self) -> tuple[Diagnosis, ...]:
        """The most probable diagnoses, by what was tried: those worth a plan of their own."""
        found = leading(self.result.diagnoses, self.tried, now_ns=self.now_ns, patience=self.patience)
        return tuple(found)

    def decide(self, plans: Sequence[Plan]) -> Choice:
        """Return the choice, given a plan for each of `wanted`."""
        diagnoses = self.leading
        pairs = [Candidate(one, plan) for one, plan in zip(self.wanted, plans, strict=True)]
        candidates, shared = pairs[: len(diagnoses)], pairs[len(diagnoses) :]
        return choose(
            candidates,
            self.tried,
            looks(self.probes, candidates),
            common=shared[0] if shared else None,
            now_ns=self.now_ns,
            patience=self.patience,
        )


def parts_of(system: System) -> ComponentModel:
    """Return what can be repaired.

    Raises:
        ModelError: the model is no component model.
    """
    if system.parts is None:
        raise ModelError(
            f"a model in {system.format} format says nothing of what can be switched or restarted: planning "
            "needs a component model (robomend: 1)"
        )
    return system.parts


def looks(probes: ProbeResult | None, candidates: Sequence[Candidate]) -> list[Look]:
    """Return the probes as choosing sees them."""
    if probes is None:
        return []
    index = {bad: position for position, bad in enumerate(probes.diagnoses)}
    positions = [index.get(one.diagnosis.bad) for one in candidates]
    return [
        Look(
            probe.atom,
            probe.cost_s,
            tuple(
                True if position in probe.if_true else False if position in probe.if_false else None
                for position in positions
            ),
        )
        for probe in probes.probes
    ]


# --- as JSON --------------------------------------------------------------------------------------


def plan_answer(choice: Choice, components: Collection[str]) -> dict[str, Any]:
    """Return a choice as JSON values: what POST /plans, POST /robots/{id}/plans and
    `robomend plan --format json` answer.
    """
    return {
        "choice": _diagnosis(choice.diagnosis, components, _weight(choice)) if choice.diagnosis else None,
        "plan": plan_with_graph(choice.plan) if choice.plan else None,
        "probe": _look(choice.probe) if choice.probe else None,
        "alternatives": [_alternative(one, components) for one in choice.alternatives],
        "expected_cost": round(choice.expected_cost, 6),
        "reason": choice.reason,
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


def plan_with_graph(plan: Plan) -> dict[str, Any]:
    """Return a plan as JSON values: its steps, and the same as a graph."""
    return {
        **plan_json(plan),
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
