"""How probably a plan cures what it is for, where the diagnosis is right; and which of two ways comes first.

    plan ──► acts that should make a blamed component good ──► the kind of each ──► CURES

A power cycle brings back a device that hangs, and none that is broken; a spare stands in for either. To try
first the way with probability p and cost c, and the other if it was in vain, costs less in the mean where
p / c is larger: the order of robomend.planning.choice, here among the ways to cure one diagnosis.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator, Mapping
from enum import StrEnum

from robomend.model.components import ComponentModel
from robomend.planning.plan import Outcome, Plan
from robomend.planning.policy import DARK


class Cure(StrEnum):
    """What is done to make a component good."""

    POWER_CYCLE = "power cycle"  # of a device that has power
    CYCLE_OF_WORKING = "power cycle of what works in part"  # of a device of which something is seen ok
    OTHER = "other"  # it is switched on, restarted, replaced, or whatever a user's action does


CURES: Mapping[Cure, float] = {
    Cure.POWER_CYCLE: 0.5,
    Cure.CYCLE_OF_WORKING: 0.1,
    Cure.OTHER: 1.0,
}
"""P(it helps | its diagnosis is right), by default.

Whether a device that has power and says nothing hangs or is broken, nobody has told robomend: 0.5 prefers
neither. What hangs is silent: a device that goes on with a part of what it does may have failed in the rest,
and seldom because it hangs. The rest counts as its domain says. Whoever knows his robot better says so in his
actions' costs: a spare comes after the power cycle where it costs more than twice as much.
"""

Avoided = tuple[tuple[str, str], ...]
"""Ground actions as text that must not be used, each with the reason."""


def cured(
    plan: Plan, bad: Collection[str], works: Collection[str] = (), carried: Collection[str] = ()
) -> float:
    """Return the probability that the plan cures these, if they are what is wrong and it repairs them.

    Args:
        works: those of them of which something is seen to work.
        carried: what is cycled with what the plan cycles.
    """
    cycles = [names.intersection(bad) for _, names in _power_cycles(plan)]
    if not any(cycles):
        cycles = [frozenset(carried).intersection(bad)]
    probability = CURES[Cure.OTHER]
    for names in filter(None, cycles):
        hangs = not names.issubset(works)
        probability *= CURES[Cure.POWER_CYCLE if hangs else Cure.CYCLE_OF_WORKING]
    return probability


def cycled(plan: Plan) -> frozenset[str]:
    """Return the components that the plan cures by a power cycle, if at all."""
    return frozenset[str]().union(*(names for _, names in _power_cycles(plan)))


def carried(plan: Plan, model: ComponentModel) -> frozenset[str]:
    """Return what loses its power with a device that the plan cycles and has it again, as its own relay stays
    where it is: it is cycled, too.
    """
    names = cycled(plan)
    own = power_cuts(plan) | {fact.args[0] for fact in plan.initial if fact.predicate == "off"}
    fed = (name for name in model.hardware if not names.isdisjoint(model.feeders(name)))
    return frozenset(name for name in fed if name not in own and name not in names)


def power_cuts(plan: Plan) -> frozenset[str]:
    """Return the devices that the plan takes power from."""
    return frozenset(
        effect.atom.args[0]
        for step in plan.steps
        for effect in step.effects
        if effect.positive and effect.atom.predicate == "off" and effect.atom.args
    )


def best_way(plan: Plan, bad: Collection[str], other: Callable[[Avoided], Plan]) -> Plan:
    """Return the plan, or another way to cure the same that is likelier to help for what it costs.

    Args:
        other: plans for the same without these acts.
    """
    why = "another way is looked for"
    cycles = tuple((text, why) for text, names in _power_cycles(plan) if not names.isdisjoint(bad))
    if not cycles:
        return plan
    way = other(cycles)
    if not way.steps or way.outcome is Outcome.GAVE_UP or len(way.unreachable) > len(plan.unreachable):
        return plan
    return way if cured(way, bad) * plan.cost > cured(plan, bad) * way.cost else plan


def once(plan: Plan, devices: Collection[str]) -> frozenset[str]:
    """Return the acts, as text, that a repair does once for these devices: the same again cures no better.

    A process that is started may come up well the next time; a device that comes back dead is dead. Of a
    power cycle it is the cut, so that what is off may be switched on at any time; else what should cure it.
    """
    cycled = frozenset[str]().union(*(names for _, names in _power_cycles(plan) if names & set(devices)))
    found: set[str] = set()
    for step in plan.steps:
        added = {(e.atom.predicate, e.atom.args[0]) for e in step.effects if e.positive and e.atom.args}
        cut = any(predicate in DARK and name in cycled for predicate, name in added)
        cure = any(("good", name) in added and ("on", name) not in added for name in devices)
        if cut or cure:
            found.add(str(step))
    return frozenset(found)


def _power_cycles(plan: Plan) -> Iterator[tuple[str, frozenset[str]]]:
    """Yield the acts, as text, that give back power that the plan took, and what each should make good."""
    dark: set[str] = set()
    for step in plan.steps:
        added = [effect.atom for effect in step.effects if effect.positive and effect.atom.args]
        if any(atom.predicate == "on" and atom.args[0] in dark for atom in added):
            yield str(step), frozenset(atom.args[0] for atom in added if atom.predicate == "good")
        dark.update(atom.args[0] for atom in added if atom.predicate in DARK)
