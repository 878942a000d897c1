"""How probably a plan cures what it is for, where the diagnosis is right; and which of two ways comes first.

    plan ──► acts that should make a blamed component good ──► the kind of each ──► CURES

A power cycle brings back a device that hangs, and none that is broken; a spare stands in for either. To try
first the way with probability p and cost c, and the other if it was in vain, costs less in the mean where
p / c is larger: the order of robomend.planning.choice, here among the ways to cure one diagnosis.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Iterator, Mapping
from dataclasses import dataclass
from enum import StrEnum
from types import MappingProxyType

from robomend.model.components import Component, ComponentModel
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

RESTART, CYCLE = "restart", "power_cycle"
"""What `helps` of a model calls our own acts."""

PRIOR_WEIGHT = 4
"""What is given, or usual, counts as much as so many outcomes."""

LEAST_OUTCOMES = 3
"""Of an act of which nothing is given: fewer say nothing."""

RELIABLE = 0.995


@dataclass(frozen=True, slots=True)
class SuccessRate:
    """How probably an act cures a component that is what is wrong: Beta, its mean.

    What came of it on other robots of the model is what one begins with on this one.
    """

    act: str
    component: str
    prior: float
    given: bool  # in the model, for this component
    helped: int = 0
    of: int = 0
    fleet_helped: int = 0
    fleet_of: int = 0

    @property
    def mean(self) -> float:
        """The probability, by what is given and what came of it."""
        begun = (PRIOR_WEIGHT * self.prior + self.fleet_helped) / (PRIOR_WEIGHT + self.fleet_of)
        return (PRIOR_WEIGHT * begun + self.helped) / (PRIOR_WEIGHT + self.of)

    def __str__(self) -> str:
        said = [f"{self.prior:.0%} {'given' if self.given else 'usual'}"]
        said += [f"{self.fleet_helped} of {self.fleet_of} helped in the fleet"] if self.fleet_of else []
        said += [f"{self.helped} of {self.of} helped"] if self.of else []
        return f"{self.act} of {self.component} {self.mean:.0%} ({', '.join(said)})"


Rates = Mapping[tuple[str, str], SuccessRate]
"""(act, component) -> its rate; what is not in it counts as is usual (CURES)."""

NO_RATES: Rates = MappingProxyType({})


@dataclass(frozen=True, slots=True)
class ActOutcome:
    """What came of acts on one component alone."""

    component: str
    acts: frozenset[str]  # restart, power_cycle, or an act's name
    helped: bool
    mode: str = ""
    fleet: bool = False  # on another robot of the model


def rates(
    model: ComponentModel, modes: Mapping[str, str], outcomes: Iterable[ActOutcome]
) -> dict[tuple[str, str], SuccessRate]:
    """Return what the model gives, and what was learned.

    Args:
        modes: the fault mode of a component, where it is known; one that says what another one says is not.
        outcomes: of earlier repairs; what came back by itself is not among them.
    """
    found: dict[tuple[str, str], SuccessRate] = {}
    modes = {name: _told_apart(model.parts[name], mode) for name, mode in modes.items()}
    for name, part in model.parts.items():
        for act, by_mode in part.helps.items():
            mode = modes.get(name, "")
            prior = by_mode.get(mode, by_mode.get(""))
            if prior is None:  # which mode it is is not known: each counts alike
                prior = sum(by_mode.values()) / len(by_mode)
            found[act, name] = SuccessRate(act, name, prior, given=True)
    counts: dict[tuple[str, str], list[int]] = {}  # helped and all of them, here and in the fleet
    for one in outcomes:
        known_as = model.parts.get(one.component)
        mode = one.mode if known_as is None else _told_apart(known_as, one.mode)
        if len(one.acts) == 1 and mode == modes.get(one.component, ""):
            for act in one.acts:
                tally = counts.setdefault((act, one.component), [0, 0, 0, 0])
                tally[2 * one.fleet] += one.helped
                tally[2 * one.fleet + 1] += 1
    for key, (helped, of, fleet_helped, fleet_of) in counts.items():
        known = found.get(key)
        if known is not None:
            found[key] = SuccessRate(*key, known.prior, True, helped, of, fleet_helped, fleet_of)
        elif LEAST_OUTCOMES <= of + fleet_of > helped + fleet_helped and key[1] in model.parts:
            prior = CURES[Cure.POWER_CYCLE if key[0] == CYCLE else Cure.OTHER]
            found[key] = SuccessRate(*key, prior, False, helped, of, fleet_helped, fleet_of)
    return found


def _told_apart(part: Component, mode: str) -> str:
    """Return a component's fault mode, or nothing if another one says the same: nothing tells which it is."""
    said = part.modes.get(mode)
    alike = said is not None and any(said == other for name, other in part.modes.items() if name != mode)
    return "" if alike else mode


def curing(plan: Plan, bad: Collection[str]) -> dict[str, tuple[str, str]]:
    """Return, for each of these, the kind of act by which the plan should cure it, and the act as text."""
    by_cycle = {name: text for text, names in _power_cycles(plan) for name in names}
    found: dict[str, tuple[str, str]] = {}
    for step in plan.steps:
        for effect in step.effects:
            if effect.positive and effect.atom.predicate == "good" and effect.atom.args[0] in bad:
                kind = RESTART if step.name == "start_node" else step.name
                found[effect.atom.args[0]] = (kind, str(step))
    return {
        name: (CYCLE, by_cycle[name])
        if name in by_cycle and found[name][1] == by_cycle[name]
        else found[name]
        for name in found
    }


Avoided = tuple[tuple[str, str], ...]
"""Ground actions as text that must not be used, each with the reason."""


def cured(
    plan: Plan,
    bad: Collection[str],
    works: Collection[str] = (),
    carried: Collection[str] = (),
    known: Rates = NO_RATES,
) -> float:
    """Return the probability that the plan cures these, if they are what is wrong and it repairs them.

    Args:
        works: those of them of which something is seen to work.
        carried: what is cycled with what the plan cycles.
        known: the rates of acts, where they are given or learned.
    """
    probability = CURES[Cure.OTHER]
    rated = rates_in(plan, bad, known)
    for rate in rated:
        probability *= rate.mean
    rest = frozenset(bad).difference(rate.component for rate in rated)
    cycles = [names.intersection(rest) for _, names in _power_cycles(plan)]
    if not any(cycles):
        cycles = [frozenset(carried).intersection(rest)]
    for names in filter(None, cycles):
        hangs = not names.issubset(works)
        probability *= CURES[Cure.POWER_CYCLE if hangs else Cure.CYCLE_OF_WORKING]
    return probability


def rates_in(plan: Plan, bad: Collection[str], known: Rates) -> list[SuccessRate]:
    """Return the rates of the acts by which a plan should cure these."""
    if not known:
        return []
    acts = curing(plan, bad)
    return [known[kind, name] for name, (kind, _) in sorted(acts.items()) if (kind, name) in known]


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


WAYS = 3
"""Other ways that are looked for."""


def best_way(
    plan: Plan, bad: Collection[str], other: Callable[[Avoided], Plan], known: Rates = NO_RATES
) -> Plan:
    """Return the plan, or another way to cure the same that is likelier to help for what it costs.

    Args:
        other: plans for the same without these acts.
        known: the rates of acts, where they are given or learned.
    """
    best, last = plan, plan
    tried: Avoided = ()
    for _ in range(WAYS if known else 0):
        doubtful = {rate.component for rate in rates_in(last, bad, known) if rate.mean < RELIABLE}
        acts = {text for name, (_, text) in curing(last, bad).items() if name in doubtful}
        if not acts:
            break
        tried = (*tried, *((text, "another way is looked for") for text in sorted(acts)))
        last = other(tried)
        if not last.steps or last.outcome is Outcome.GAVE_UP or len(last.unreachable) > len(plan.unreachable):
            break
        if cured(last, bad, known=known) * best.cost > cured(best, bad, known=known) * last.cost:
            best = last
    if tried:
        return best
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
