"""Which variants a robot's functions are to work by, and when to change: pure, times are passed in.

    conditions over OBS, what is good ──► admissible variants ──► the most preferred
                                                                          │ dwell, bounds
                                          a plan of their acts ◄── changes that are due

A variant is admissible if its `when` holds in OBS, nothing that it needs is broken or left off, and the
functions that it needs work as it needs them. Functions do not need each other in circles, so that each gets
its most preferred variant in turn, and that choice is the only one there is.

    broken      every diagnosis blames something that the variant needs: it is left
    suspected   some diagnosis does, and not all that it publishes is seen to come: it is not changed to, and
                not left either
    unknown     nobody reports what its condition speaks of: it is not changed to, and not left either

To what is worse is changed at once, as what was active does not do any more; to what is better once that was
admissible for the function's `dwell_s`. What flaps ends with the safer variant: a change for the better is
not made if, with the change back, it would be more than `changes_per_hour`, nor to a variant that had to be
left soon after for MOST_UNDONE times within the hour. Where it was a fault for which it had to be left, its
condition did not flap: each time the dwell before the next change to it is twice as long.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise
from typing import NamedTuple

from robomend.model.components import ComponentModel, Criticality, Function, Variant
from robomend.model.formulas import Formula, leaves
from robomend.model.functions import Measured, Threshold, all_of, holds, in_order, needs_of
from robomend.model.vocabulary import ACTIVE
from robomend.planning.domain.loading import load_domain
from robomend.planning.domain.values import Domain
from robomend.planning.grounding import Grounder
from robomend.planning.influence import published
from robomend.planning.plan import Plan, Step
from robomend.planning.planning import PlanOptions, plan_problem
from robomend.planning.policy import HOUR_NS
from robomend.planning.prediction import OBSERVED_FACTS
from robomend.planning.problem import repair_problem
from robomend.planning.static_facts import Work
from robomend_client.counts import counted
from robomend_client.literals import Atom, Literal

ACT_COST = 1.0
"""Of an act that no domain gives a cost: most only ask for a mode."""

SOON_NS = 10 * 10**9
"""A change for the better that is undone within so long, or four times the dwell, was one too many."""

MOST_UNDONE = 2

RETRY_NS = 60 * 10**9
"""A variant whose acts failed is tried again after so long, then after twice as long, and so on …"""

MOST_RETRY_NS = HOUR_NS


# --- what is known, and what follows from it for each variant


@dataclass(frozen=True, slots=True)
class KnownState:
    """What configurations rest on."""

    value: Callable[[Atom], bool | None]  # whether OBS holds it; None: unknown
    measured: Measured
    diagnoses: Sequence[Collection[str]] = ()  # what each blames; of a healthy robot nothing
    left_off: Collection[str] = ()  # what a repair switched off or stopped and has not brought back


class Standing(NamedTuple):
    """How a variant stands."""

    admissible: bool | None  # None: unknown
    suspected: bool = False  # some diagnosis blames what it needs
    aside: bool = False  # its acts failed and are not tried again yet, or may not be done now
    why: str = ""  # why it is not admissible, not known to be, or not changed to

    @property
    def broken(self) -> bool:
        """Whether every diagnosis blames something that it needs."""
        return self.suspected and self.admissible is False

    @property
    def fine(self) -> bool:
        """Whether it may be changed to."""
        return self.admissible is True and not self.suspected and not self.aside


@dataclass(frozen=True, slots=True)
class FunctionState:
    """How a function stands."""

    function: Function
    reported: tuple[str, ...]  # the variants that are reported active
    standings: Mapping[str, Standing]  # in order of preference
    goal: str | None  # the variant that it is to work by; None: none is left
    target: str | None  # what it works by once what is to be changed now is; None: not known
    held: str = ""  # why a better variant is not changed to now
    waits: tuple[str, str] | None = None  # a better variant that is admissible and not changed to, and why

    @property
    def active(self) -> str | None:
        """The variant by which it works; None: nobody says so, or several are said to be."""
        return self.reported[0] if len(self.reported) == 1 else None

    @property
    def works(self) -> bool:
        """Whether it works by a variant that is known to be admissible."""
        return self.active is not None and self.standings[self.active].admissible is True

    @property
    def lost(self) -> bool:
        """Whether it has no variant left, as something is broken."""
        return self.goal is None and any(one.broken for one in self.standings.values())

    @property
    def unknown(self) -> str:
        """Why it is not known by which variant it works, or nothing."""
        if not self.reported:
            return f"nobody reports which variant of {self.function.name} is active"
        if len(self.reported) > 1:
            return f"several variants of {self.function.name} are reported active: {', '.join(self.reported)}"
        return ""


def _standing(
    variant: Variant,
    formula: Formula | None,
    shift: int,
    known: KnownState,
    before: Mapping[str, FunctionState],
    model: ComponentModel,
    aside: str,
) -> Standing:
    """Return how a variant stands, where the functions that it needs stand like `before`."""
    needs = needs_of(variant, model)
    components = all_of(variant, model)
    blamed = [components.intersection(bad) for bad in known.diagnoses]
    suspected = any(blamed) and not _seen_to_work(variant, known, model)
    if blamed and all(blamed):
        names = sorted(frozenset().union(*blamed))
        return Standing(False, True, why=f"{', '.join(names)} {'is' if len(names) == 1 else 'are'} blamed")
    off = sorted(components.intersection(known.left_off))
    if off:
        return Standing(False, why=f"{', '.join(off)} {'is' if len(off) == 1 else 'are'} left off")
    for need in needs:
        if need.function is not None:
            other = before[need.function]
            if other.goal is None:
                return Standing(False, why=f"{need.function} has no variant left")
            if need.variant is not None and need.variant != other.target:
                how = other.target or "an unknown variant"
                return Standing(False, why=f"{need.function} works by {how}, not by {need.variant}")
    if formula is not None:
        truth = holds(formula, known.value, known.measured, shift)
        if truth is not True:
            return Standing(truth, suspected, why=unmet(formula, known, shift))
    if aside:
        return Standing(True, suspected, aside=True, why=aside)
    if suspected:
        names = sorted(frozenset().union(*blamed))
        return Standing(True, True, why=f"{', '.join(names)} may be broken")
    return Standing(True)


def _seen_to_work(variant: Variant, known: KnownState, model: ComponentModel) -> bool:
    """Whether all that its components publish comes: what they rest on is good enough."""
    topics = published(model, variant.needs)
    return bool(topics) and all(known.value(Atom("ok", (topic,))) for topic in topics)


def unmet(formula: Formula, known: KnownState, shift: int = 0) -> str:
    """Return what of a condition does not hold, with what was measured."""
    said: dict[str, None] = {}
    for leaf in leaves(formula):
        compared = Threshold.of_atom(leaf.literal.atom)
        atom = leaf.literal.atom
        if compared is not None:
            number = known.measured(compared.of)
            name = compared.of.args[-1] if compared.of.args else compared.of.predicate
            if number is None:
                said[f"nobody reports {name}"] = None
            elif not compared.holds(number, shift):
                way = "fell to" if compared.sign in {">=", ">"} else "rose to"
                said[f"{name} {way} {number:.4g}, {compared}"] = None
        elif (value := known.value(atom)) is None:
            said[f"nobody reports {atom}"] = None
        elif value != leaf.literal.positive:
            said[f"{Literal(atom, value)} is observed"] = None
    return ", ".join(said) or "its condition does not hold"


def met(formula: Formula | None, known: KnownState) -> str:
    """Return by what a condition holds, with what was measured."""
    said: dict[str, None] = {}
    for leaf in () if formula is None else leaves(formula):
        compared = Threshold.of_atom(leaf.literal.atom)
        if compared is not None:
            number = known.measured(compared.of)
            if number is not None and compared.holds(number):
                name = compared.of.args[-1] if compared.of.args else compared.of.predicate
                way = "rose to" if compared.sign in {">=", ">"} else "fell to"
                said[f"{name} {way} {number:.4g}, {compared}"] = None
        elif known.value(leaf.literal.atom) == leaf.literal.positive:
            said[f"{leaf.literal} is observed"] = None
    return ", ".join(said)


def held_back(variant: str, why: str, measured: str = "", left_s: float | None = None) -> str:
    """Return why a better variant that is admissible is not changed to, for `left_s` seconds or for now."""
    again = f"{variant} is admissible again{measured and f', as {measured}'}"
    return f"{again}, and not changed to{'' if left_s is None else f' for {left_s:.0f} s'}: {why}"


def does_without(
    model: ComponentModel, states: Mapping[str, FunctionState], diagnoses: Iterable[Collection[str]]
) -> bool:
    """Return whether a robot does without all that its diagnoses blame: each function works by a variant that
    needs nothing of it, or is seen to work, and what is blamed is needed by others only. What is optional may
    be lost, and what is not known is no fault: a condition that nobody reports; a function of which nobody
    says by which variant it works may work by any of them.
    """
    blamed = frozenset[str]().union(*diagnoses)
    if not blamed:
        return False

    def needed(variants: Iterable[Variant]) -> frozenset[str]:
        return frozenset[str]().union(*(all_of(variant, model) for variant in variants))

    spared = needed(one for state in states.values() for one in state.function.variants.values())
    optional = {name for name, part in model.parts.items() if part.criticality is Criticality.OPTIONAL}
    if not blamed <= spared | optional:
        return False
    for state in states.values():
        function = state.function
        if function.criticality is Criticality.OPTIONAL:
            continue
        by = state.reported or tuple(function.variants)
        if all(state.standings[one].admissible is False for one in by):
            return False
        doubtful = (one for one in by if not state.standings[one].fine)
        if blamed.intersection(needed(function.variants[one] for one in doubtful)):
            return False
    return True


# --- when to change


class VariantChange(NamedTuple):
    """A change that is to be made now."""

    function: str
    source: str
    target: str
    reason: str
    better: bool  # the target is preferred to the source
    fault: bool = False  # something is blamed that the source needs, or a function that it needs


class Made(NamedTuple):
    """A change that was made."""

    time_ns: int
    function: str
    source: str
    target: str
    fault: bool = False  # something that the source needs was blamed


class Decision(NamedTuple):
    """What to do about a robot's functions now."""

    states: Mapping[str, FunctionState]
    changes: tuple[VariantChange, ...]
    again_ns: int | None  # when to decide anew, whatever is observed until then


@dataclass
class Keeper:
    """Of one robot: since when variants are admissible, which failed, and what was changed lately."""

    made: list[Made] = field(default_factory=list)
    _since: dict[tuple[str, str], int] = field(default_factory=dict)
    _suspected: dict[tuple[str, str], bool] = field(default_factory=dict)  # as it last was not admissible
    _failed: dict[tuple[str, str], tuple[int, int, str]] = field(default_factory=dict)

    def failed(self, function: str, variant: str, why: str, now_ns: int, least_ns: int = RETRY_NS) -> None:
        """Note that a variant was not reached; another one is tried meanwhile."""
        _, times, _ = self._failed.get((function, variant), (0, 0, ""))
        wait_ns = min(least_ns * 2**times, MOST_RETRY_NS)
        self._failed[function, variant] = (now_ns + wait_ns, times + 1, why)

    def failed_by(self, function: str, variant: str) -> str:
        """Return why a variant was not reached the last time that it was tried, or nothing."""
        return self._failed.get((function, variant), (0, 0, ""))[2]

    def changed(self, made: Made) -> None:
        """Note a change that was made."""
        self.made = [one for one in self.made if made.time_ns - one.time_ns < HOUR_NS]
        self.made.append(made)
        self._failed.pop((made.function, made.target), None)

    def reconsider(self) -> None:
        """Somebody changed the robot's configuration: what failed may work now."""
        self._failed.clear()

    def decide(
        self,
        model: ComponentModel,
        conditions: Mapping[tuple[str, str], Formula],
        known: KnownState,
        now_ns: int,
        barred: Callable[[Function, str], str] = lambda function, variant: "",
    ) -> Decision:
        """Return how each function stands, and what is to be changed now.

        Args:
            barred: why a variant's acts may not be done now, or nothing: another one is taken meanwhile.
        """
        states: dict[str, FunctionState] = {}
        changes: list[VariantChange] = []
        again: list[int] = []
        for function in in_order(model):
            name = function.name
            reported = tuple(
                variant for variant in function.variants if known.value(Atom(ACTIVE, (name, variant)))
            )
            active = reported[0] if len(reported) == 1 else None
            standings: dict[str, Standing] = {}
            before_active = active is not None
            for variant in function.variants.values():
                if variant.name == active:
                    before_active = False
                # What is active is kept a bit longer; for what is better a bit more is asked.
                shift = -1 if variant.name == active else 1 if before_active else 0
                until_ns, _, why = self._failed.get((name, variant.name), (0, 0, ""))
                aside = ""
                if variant.name != active and not (aside := barred(function, variant.name)):
                    aside = why if now_ns < until_ns else ""
                    again += [until_ns] if aside else []
                standings[variant.name] = _standing(
                    variant, conditions.get((name, variant.name)), shift, known, states, model, aside
                )
            state = FunctionState(function, reported, standings, _goal(standings, active), active)
            for variant_name, standing in standings.items():
                if standing.fine or (standing.aside and not standing.suspected):
                    self._since.setdefault((name, variant_name), now_ns)
                    if variant_name == active:
                        self._suspected.pop((name, variant_name), None)
                else:
                    self._since.pop((name, variant_name), None)
                    self._suspected[name, variant_name] = standing.suspected
            state, wake_ns = self._target(state, now_ns, conditions, known)
            target = state.target
            if wake_ns is not None:
                again.append(wake_ns)
            if active is not None and target is not None and target != active:
                order = list(function.variants)
                better = order.index(target) < order.index(active)
                reason = standings[active].why
                was_suspected = self._suspected.get((name, target))
                if better and was_suspected is None:
                    reason = f"{target} is admissible"
                elif better and was_suspected:
                    reason = f"nothing that {target} needs is blamed any more"
                elif better:
                    reason = met(conditions.get((name, target)), known) or f"{target} is admissible again"
                rests = {need.function for need in needs_of(function.variants[active], model)}
                fault = standings[active].broken or any(c.fault and c.function in rests for c in changes)
                fault = fault or any(one.lost and one.function.name in rests for one in states.values())
                changes.append(VariantChange(name, active, target, reason, better, fault))
            states[name] = state
        return Decision(states, tuple(changes), min(again, default=None))

    def _target(
        self,
        state: FunctionState,
        now_ns: int,
        conditions: Mapping[tuple[str, str], Formula],
        known: KnownState,
    ) -> tuple[FunctionState, int | None]:
        """Return the state with the variant to work by now and why a better one is not, and when to look
        again.
        """
        active, function = state.active, state.function
        if active is None:
            return replace(state, target=None, held=state.unknown), None
        order = list(function.variants)
        above, below = order[: order.index(active)], order[order.index(active) + 1 :]
        standings = state.standings
        leaves_it = standings[active].admissible is False
        wake_ns = None
        dwell_ns = round(function.dwell_s * 1e9)
        for better in above:
            if (function.name, better) not in self._since:
                continue
            ready_ns = self._since[function.name, better] + dwell_ns
            why, until_ns = standings[better].why, None
            if again := sum(one.fault for one in self._undone(function, better, now_ns)):
                ready_ns += _soon_ns(function) // 4 * 2**again - dwell_ns
                why = f"what it needs was broken again soon, {counted(again, 'time')} within the hour"
            if now_ns < ready_ns:
                wake_ns = ready_ns if wake_ns is None else min(wake_ns, ready_ns)
                if again and not state.waits:
                    held = held_back(better, why, left_s=(ready_ns - now_ns) / 1e9)
                    state = replace(state, held=held, waits=(better, why))
                continue
            measured = ""
            if standings[better].aside:
                measured = met(conditions.get((function.name, better)), known)
            else:
                why, until_ns = self._bounded(function, better, now_ns)
                if not why or (leaves_it and not any(standings[one].fine for one in below)):
                    return replace(state, target=better), wake_ns
            if not state.waits:
                state = replace(state, held=held_back(better, why, measured), waits=(better, why))
            if until_ns is not None:
                wake_ns = until_ns if wake_ns is None else min(wake_ns, until_ns)
        if not leaves_it:
            return replace(state, target=active), wake_ns
        fine = [one for one in (*below, *above) if standings[one].fine]
        doubtful = [one for one in order if standings[one].admissible and not standings[one].aside]
        for target in (*fine, *doubtful):
            return replace(state, target=target), wake_ns
        due = next((one for one in (*below, *above) if standings[one].aside), None)
        held = f"no variant of {function.name} is admissible"
        if due is not None:
            held = f"{due} is due, as {standings[active].why}; {standings[due].why}"
        return replace(state, target=active, held=held), wake_ns

    def _bounded(self, function: Function, target: str, now_ns: int) -> tuple[str, int]:
        """Return why no change for the better is made to a variant now, and until when; or nothing."""
        made = self._lately(function, now_ns)
        if made and len(made) + 2 > function.changes_per_hour:
            why = f"{len(made)} changes within the hour, and at most {function.changes_per_hour} are made"
            return why, made[0].time_ns + HOUR_NS
        undone = [one for one in self._undone(function, target, now_ns) if not one.fault]
        if len(undone) >= MOST_UNDONE:
            why = f"a change for the better had to be undone soon, {len(undone)} times within the hour"
            return why, undone[0].time_ns + HOUR_NS
        return "", 0

    def _lately(self, function: Function, now_ns: int) -> list[Made]:
        """Return the changes of a function within the hour, between variants that the model has still."""
        return [
            one
            for one in self.made
            if one.function == function.name
            and now_ns - one.time_ns < HOUR_NS
            and {one.source, one.target} <= function.variants.keys()
        ]

    def _undone(self, function: Function, target: str, now_ns: int) -> list[Made]:
        """Return the changes within the hour by which a change for the better was undone soon.

        One that was undone counts against its target and against what was passed over on the way back, as
        that would not have lasted either.
        """
        order = list(function.variants)
        return [
            after
            for before, after in pairwise(self._lately(function, now_ns))
            if order.index(before.target) < order.index(before.source)
            and order.index(before.target) <= order.index(target) < order.index(after.target)
            and after.time_ns - before.time_ns < _soon_ns(function)
        ]


def _soon_ns(function: Function) -> int:
    return max(SOON_NS, round(4e9 * function.dwell_s))


def _goal(standings: Mapping[str, Standing], active: str | None) -> str | None:
    """Return the most preferred variant that may be changed to, or kept; None: none is left."""
    for variant, standing in standings.items():
        if standing.fine or (variant == active and standing.admissible is not False):
            return variant
    return next((v for v, standing in standings.items() if standing.admissible and not standing.aside), None)


# --- the plan of a change


def variants_pddl(
    model: ComponentModel,
    states: Mapping[str, FunctionState],
    changes: Iterable[VariantChange],
    name: str,
    costs: Callable[[str], float],
) -> str:
    """Return what a repair domain needs to make changes: for each variant a fact of its own, what it needs,
    and for each that is to be reached one action without variables.
    """
    numbers = _numbers(model)
    predicates, facts, actions = [], [], []
    for (function, variant), number in numbers.items():
        predicates.append(f"(active-{number}) (needed-{number} ?c - component)")
        if states[function].active == variant:
            facts.append(f"(active-{number})")
        needs = needs_of(model.functions[function].variants[variant], model)
        facts += [
            f"(needed-{number} {_word(need.component)})" for need in needs if need.component is not None
        ]
    for change in changes:
        variant_of = model.functions[change.function].variants[change.target]
        number = numbers[change.function, change.target]
        asked = [f"(forall (?c - component) (imply (needed-{number} ?c) (good ?c)))"]
        for need in needs_of(variant_of, model):
            if need.function is not None:
                wanted = states[need.function].target
                asked += [f"(active-{numbers[need.function, wanted]})"] if wanted is not None else []
        cost = sum(costs(act) for act, _ in variant_of.do)
        gone = " ".join(
            f"(not (active-{other}))"
            for (function, _), other in numbers.items()
            if function == change.function and other != number
        )
        actions.append(
            f"(:action change-to-{number} :parameters () :precondition (and {' '.join(asked)})\n"
            f"    :effect (and (active-{number}) {gone} (increase (total-cost) {cost:g})))"
        )
    return "\n  ".join(
        (
            f"(define (domain {name})",
            f"(:predicates {' '.join(predicates)})",
            *actions,
            f"(:init {' '.join(facts)}))",
        )
    )


def change_plan(
    model: ComponentModel,
    observed: Iterable[Literal],
    bad: Collection[str],
    states: Mapping[str, FunctionState],
    changes: Sequence[VariantChange],
    options: PlanOptions,
    work: Work | None = None,
) -> Plan:
    """Return a plan of the acts that make these changes, with what their variants need before them.

    What a variant needs and is meant to be off, a cold spare, is switched on for it; what is broken is not
    repaired here.

    Raises:
        OutOfWork, DomainError, SolverError: as robomend.planning.planning.plan_for does.
    """
    base = load_domain(options.domain, options.domain_file)

    def cost(act: str) -> float:
        schema = base.schemas.get(act)
        return ACT_COST if schema is None else schema.cost

    domain = load_domain(
        options.domain, options.domain_file, variants_pddl(model, states, changes, base.name, cost)
    )
    wanted = frozenset[str]().union(
        *(all_of(model.functions[change.function].variants[change.target], model) for change in changes)
    )
    stopped = tuple(name for name in options.expected_stopped if name not in wanted)
    problem = repair_problem(model, domain, observed, bad, replace(options, expected_stopped=stopped))
    numbers = _numbers(model)
    goal = tuple((f"active-{numbers[change.function, change.target]}",) for change in changes)
    problem = replace(problem, goal=goal)
    plan = plan_problem(domain, problem, options, work)
    by_action = {f"change-to-{numbers[change.function, change.target]}": change for change in changes}
    said = {f"active-{number}": f"{function} by {variant}" for (function, variant), number in numbers.items()}
    steps = _expanded(plan, by_action, model, Grounder(domain, problem), base)
    return replace(
        plan,
        steps=steps,
        initial=frozenset(atom for atom in plan.initial if not atom.predicate.startswith("active-")),
        unreachable=tuple(_in_words(sentence, said) for sentence in plan.unreachable),
    )


def _in_words(sentence: str, said: Mapping[str, str]) -> str:
    for fact, words in sorted(said.items(), key=lambda one: -len(one[0])):
        sentence = sentence.replace(fact, words)
    return sentence.removeprefix(": ")


def _expanded(
    plan: Plan,
    changes: Mapping[str, VariantChange],
    model: ComponentModel,
    grounder: Grounder,
    domain: Domain,
) -> tuple[Step, ...]:
    """Return the plan's steps with the acts of the variants in place of the actions that stand for them."""
    steps: list[Step] = []
    ends: dict[int, tuple[int, ...]] = {}  # a step of the plan -> the last ones that stand for it
    for step in plan.steps:
        after = tuple(sorted({end for before in step.after for end in ends[before]}))
        change = changes.get(step.name)
        if change is None:
            ends[step.index] = (len(steps),)
            steps.append(replace(step, index=len(steps), after=after))
            continue
        function = model.functions[change.function]
        variant = function.variants[change.target]
        shown = [
            Literal(Atom(ACTIVE, (function.name, one)), one == variant.name) for one in function.variants
        ]
        for position, (act, parameters) in enumerate(variant.do):
            last = position == len(variant.do) - 1
            effects: tuple[Literal, ...] = tuple(shown) if last else ()
            known = domain.schemas.get(act)
            if known is not None and len(known.parameters) == len(parameters):
                for instance in grounder.instances(act, parameters)[:1]:
                    own = map(grounder.literal, sorted(instance.effects, key=abs))
                    effects = (*own, *effects)
            cost = ACT_COST if known is None else known.cost
            steps.append(Step(len(steps), act, parameters, cost, after, (), effects))
            after = (len(steps) - 1,)
        ends[step.index] = after
    return tuple(steps)


def _numbers(model: ComponentModel) -> dict[tuple[str, str], int]:
    pairs = ((name, variant) for name, function in model.functions.items() for variant in function.variants)
    return {pair: number for number, pair in enumerate(pairs)}


def _word(name: str | None) -> str:
    escaped = (name or "").replace("\\", "\\\\").replace('"', '\\"')
    return f'"{escaped}"'


def awaited(steps: Iterable[Step]) -> frozenset[Literal]:
    """Return what must be seen of a change once its acts are done."""
    return frozenset(
        effect
        for step in steps
        for effect in step.effects
        if effect.positive and effect.atom.predicate in {ACTIVE, *OBSERVED_FACTS}
    )
