"""A plan that repairs only a part of what is bad: whether that can help anybody. Pure.

    its diagnosis, and what its acts break ──► less what it makes good ──► left bad
                                                                            │
                     a minimal diagnosis of OBS lies within that? ── yes ──► all that is observed stays
                                                                             explained: it helps nothing

A driver that cannot be restarted any more explains its silence by itself. To reset the bus of its device, and
to restart the drivers beside it, would cost acts, and nobody would see a difference. A plan that brings back
what is off or stopped helps that far. A driver that nobody can ever restart may find its device again by
itself, whatever the domain says: that is seen after the plan.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from robomend.diagnosis.result import Diagnosis
from robomend.model.components import KINDS, ComponentModel
from robomend.planning.plan import Plan
from robomend.planning.tried import repaired_by

LOST = frozenset(predicate for kind in KINDS for predicate in kind.lost)


def left_bad(plan: Plan, diagnosis: Diagnosis, model: ComponentModel) -> frozenset[str]:
    """Return what is bad after the plan, of its diagnosis and of what its acts break."""
    broken = {
        effect.atom.args[0]
        for step in plan.steps
        for effect in step.effects
        if effect.atom.predicate == "good" and not effect.positive and len(effect.atom.args) == 1
    }
    fixed = {name for name, node in model.nodes.items() if not node.restartable}
    # What is off or stopped, and left alone, is bad as well, though the diagnosis need not blame it.
    before = {fact.args[0] for fact in plan.initial if fact.predicate == "bad"}
    return frozenset((broken - fixed) | before | set(diagnosis.bad)) - repaired_by(plan)


def brings_back(plan: Plan) -> bool:
    """Return whether something is good after the plan that was off or stopped, and was not meant to be."""
    lost = {fact.args[0] for fact in plan.initial if fact.predicate in LOST and len(fact.args) == 1}
    return not (lost - set(plan.excluded)).isdisjoint(repaired_by(plan))


def explains_all(
    plan: Plan, diagnosis: Diagnosis, minimal: Sequence[Diagnosis], model: ComponentModel
) -> tuple[str, ...]:
    """Return what a plan leaves bad and what explains all that is observed; nothing where it may help.

    Args:
        diagnosis: what the plan is for.
        minimal: the minimal diagnoses of OBS.
    """
    if not plan.steps or brings_back(plan):
        return ()
    left = left_bad(plan, diagnosis, model)
    return next((one.bad for one in minimal if one.bad and left.issuperset(one.bad)), ())


def helpful(plan: Plan, diagnosis: Diagnosis, minimal: Sequence[Diagnosis], model: ComponentModel) -> Plan:
    """Return the plan, or one without steps that says why it can help nothing."""
    names = explains_all(plan, diagnosis, minimal, model)
    if not names:
        return plan
    why = (
        f"{', '.join(diagnosis.bad)}: its plan would leave {' and '.join(names)} broken, which explains all "
        "that is observed, and so help nothing"
    )
    return replace(plan, steps=(), cost=0.0, unreachable=(why, *plan.unreachable))
