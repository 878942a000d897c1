"""Questions as files that other solvers read, each with its known answer: WCNF, ASP and PDDL.

    wcnf    weighted partial MaxSAT, as in the MaxSAT Evaluations since 2022: `h` before a hard clause. Hard
            are SD and OBS, soft (weight 1) is the health of each component, variables 1 … n. The optimum is
            the minimum cardinality of a diagnosis; what a solution makes false of 1 … n is one.
    lp      the same for clingo: `ab(C)` are the abnormal components, and they are minimized
    pddl    a repair problem, in the domain as it is written: types, quantifiers, conditional effects, costs
    strips  the same for planners that read less: ground, a domain for each problem (see below);
            strips-costs has the actions' costs as well

Several observations are one copy of SD each, over the same components: who is blamed is blamed in all of
them. How a blamed component behaves may differ from one to the next, as in the definition of
diagnosis/snapshots.py: where fault modes say something of that, each copy has a health of its own, which is
only bound where the component is not blamed.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

from robomend.diagnosis.engines import make_engine
from robomend.diagnosis.result import DiagnosisResult, Options
from robomend.errors import ContradictoryModel
from robomend.model.cnf import Clause, HealthCnf
from robomend.resources import resource
from robomend_client.literals import Literal

if TYPE_CHECKING:  # every suite and contender loads this module, and few export anything
    from robomend.planning.domain.values import Domain
    from robomend.planning.problem import RepairProblem
    from robomend.planning.validation import Named


from collections.abc import Mapping

from robomend.planning.domain.values import Domain
from robomend.planning.grounding import GroundAction, Grounder
from robomend.planning.problem import Fact, RepairProblem, pddl_names
from robomend.planning.validation import Named

# --- A repair problem as plain STRIPS, for planners that read no more: ground, without types, quantifiers,
# conditional effects or negative preconditions.
#
#     (start_node imu_node)    ──►   (start_node__imu_node)      an action without parameters
#     (good imu)               ──►   (good__imu)                 a predicate without arguments; of what cannot
#                                                                change, none
#     asked for: not (bad imu) ──►   (not__bad__imu)             a fact of its own, kept opposite by actions
#
# All ground actions are there, whether a plan can use them or not: choosing is the planner's work. Only
# those that may not be taken (of protected components) are left out.


@dataclass(frozen=True)
class Strips:
    """The two files, and which action each word of a plan stands for."""

    domain: str
    problem: str
    actions: Mapping[str, Named]


def strips(domain: Domain, problem: RepairProblem, *, costs: bool) -> Strips:
    """Return the problem as STRIPS; with costs, which not all planners read, in thousandths."""
    grounder = Grounder(domain, problem)
    actions = list(grounder.every_action())
    goal = [grounder.number(fact) for fact in problem.goal if fact[0] not in domain.static]
    impossible = any(fact[0] in domain.static and fact not in problem.initial for fact in problem.goal)
    asked = {*goal, *(number for action in actions for number in action.needs)}
    names = pddl_names(problem.objects)
    word = {number: _word(grounder.fact(number), number > 0, names) for number in sorted(asked)}
    if impossible:  # a goal that no action can bring about
        word[0] = "impossible"
        goal.append(0)
    texts: list[str] = []
    by_word: dict[str, Named] = {}
    for action in actions:
        called = _called(action, names, by_word)
        by_word[called] = (action.name, action.parameters)
        texts.append(_action(called, action, word, costs=costs))
    head = ["(define (domain strips)", f"  (:requirements :strips{' :action-costs' if costs else ''})"]
    head.append(f"  (:predicates {' '.join(f'({one})' for one in word.values())})")
    if costs:
        head.append("  (:functions (total-cost) - number)")
    initial = [f"({one})" for number, one in word.items() if number and grounder.holds_at_first(number)]
    lines = ["(define (problem repair)", "  (:domain strips)", "  (:objects)"]
    lines.append(f"  (:init {' '.join([*initial, *(['(= (total-cost) 0)'] if costs else [])])})")
    lines.append(f"  (:goal (and {' '.join(f'({word[number]})' for number in goal)}))")
    if costs:
        lines.append("  (:metric minimize (total-cost))")
    lines[-1] += ")"
    return Strips("\n".join([*head, *texts]) + ")\n", "\n".join(lines) + "\n", by_word)


def _word(fact: Fact, holds: bool, names: Mapping[str, str]) -> str:
    word = "__".join((fact[0], *(names[name] for name in fact[1:])))
    return word if holds else f"not__{word}"


def _called(action: GroundAction, names: Mapping[str, str], taken: Mapping[str, Named]) -> str:
    """Return a word of its own for the action; one with a disjunctive precondition is several."""
    word = "__".join((action.name, *(names[name] for name in action.parameters)))
    found, number = word, 1
    while found in taken:
        number += 1
        found = f"{word}__{number}"
    return found


def _action(called: str, action: GroundAction, word: Mapping[int, str], *, costs: bool) -> str:
    needs = [f"({word[number]})" for number in sorted(action.needs)]
    effects = [f"({word[number]})" for number in sorted(action.effects) if number in word]
    effects += [f"(not ({word[-number]}))" for number in sorted(action.effects) if -number in word]
    if costs:
        effects.append(f"(increase (total-cost) {round(1000 * action.cost)})")
    return (
        f"  (:action {called}\n    :parameters ()\n    :precondition (and {' '.join(needs)})\n"
        f"    :effect (and {' '.join(effects)}))"
    )


ANSWERED_WITHIN_S = 600.0
"""The answer of a question that takes longer is not known."""

KnownAnswer = dict[str, object]
"""As in the manifest; `{"solvable": False}`: proved that there is none. None instead: not known."""


@dataclass(frozen=True)
class DiagnosisProblem:
    """Which fewest components explain all snapshots?"""

    cnf: HealthCnf
    snapshots: Sequence[Iterable[Literal]]

    @cached_property
    def hard(self) -> list[Clause]:
        """SD and OBS as clauses; variables 1 … n are health, the others one set a snapshot."""
        n = len(self.cnf.components)
        several = len(self.snapshots) > 1
        free = {literal for clause in self.cnf.clauses for literal in clause if several and 0 < literal <= n}
        own = {variable: self.cnf.variables + place for place, variable in enumerate(sorted(free), 1)}
        found: list[Clause] = []
        for index, snapshot in enumerate(self.snapshots):
            shift = index * (self.cnf.variables - n + len(own))

            def moved(literal: int, shift: int = shift) -> int:
                variable = own.get(abs(literal), abs(literal))
                variable += shift if variable > n else 0
                return variable if literal > 0 else -variable

            found += [tuple(map(moved, clause)) for clause in self.cnf.clauses]
            found += [(-variable, moved(variable)) for variable in own]
            found += [(moved(number),) for number in map(self.cnf.literal, snapshot) if number]
        return found

    def wcnf(self) -> str:
        """Return the text of a .wcnf file, without a comment."""
        soft = [f"1 {variable} 0" for variable in range(1, len(self.cnf.components) + 1)]
        return "\n".join([*(f"h {' '.join(map(str, clause))} 0" for clause in self.hard), *soft, ""])

    def lp(self) -> str:
        """Return the text of an .lp file, without a comment."""
        from robomend.diagnosis.asp import facts_of

        n = len(self.cnf.components)
        variables = max(n, max((abs(literal) for clause in self.hard for literal in clause), default=0))
        encoding = resource("encodings", "diagnosis.lp").read_text()
        base, minimum, _ = encoding.split("#program ")
        return "\n".join([facts_of(n, variables, self.hard), base, minimum.partition("\n")[2]])

    def answer(self) -> KnownAnswer | None:
        """Return the minimum cardinality and a diagnosis of it, as components by number."""
        options = Options(minimal="cardinality", limit=1, timeout_s=ANSWERED_WITHIN_S, conflicts=False)
        try:
            result = self._asked(options)
        except ContradictoryModel:
            return {"solvable": False}
        if not result.diagnoses or not result.smallest_proved:
            return None
        bad = [self.cnf.health[component] for component in result.diagnoses[0].bad]
        return {"minimum_cardinality": len(bad), "diagnosis": bad}

    def _asked(self, options: Options) -> DiagnosisResult:
        if len(self.snapshots) == 1:
            engine = make_engine("sat", self.cnf)
            try:
                return engine.diagnose(self.snapshots[0], options)
            finally:
                engine.close()
        from robomend.diagnosis.snapshots import SnapshotEngine

        together = SnapshotEngine(self.cnf)
        try:
            return together.diagnose(self.snapshots, options)
        finally:
            together.close()


@dataclass(frozen=True)
class PddlFiles:
    """A repair problem as PDDL text, and what reads an action of a plan, as words; None: it is none."""

    domain: str
    problem: str
    named: Callable[[Sequence[str]], Named | None]


@dataclass(frozen=True)
class PlanningProblem:
    """Which cheapest plan makes everything good again?"""

    domain: Domain
    problem: RepairProblem

    def written(self, kind: str) -> PddlFiles:
        """Return the problem in one of the formats for planners."""
        if kind != "pddl":
            from robomend_bench.exporting import strips

            made = strips(self.domain, self.problem, costs=kind == "strips-costs")
            return PddlFiles(made.domain, made.problem, lambda words: made.actions.get(" ".join(words)))
        from robomend.planning.problem import pddl_names, problem_text

        objects = {word: name for name, word in pddl_names(self.problem.objects).items()}

        def named(words: Sequence[str]) -> Named | None:
            name, *parameters = words
            if name not in self.domain.schemas or not objects.keys() >= set(parameters):
                return None
            return name, tuple(objects[word] for word in parameters)

        return PddlFiles(self.domain.pddl, problem_text(self.domain, self.problem, self.problem.goal), named)

    def answer(self) -> KnownAnswer | None:
        """Return the least cost of a plan."""
        from robomend.planning.plan import Outcome
        from robomend.planning.planning import PlanOptions, plan_problem

        options = PlanOptions(planner="asp", timeout_s=ANSWERED_WITHIN_S)
        plan = plan_problem(self.domain, self.problem, options)
        if plan.outcome is Outcome.GAVE_UP:
            return None
        return {"solvable": False} if plan.outcome is Outcome.UNSOLVABLE else {"cost": plan.cost}


Exported = DiagnosisProblem | PlanningProblem

PLANNING = ("pddl", "strips", "strips-costs")
"""Formats for planners."""

FORMATS = ("wcnf", "lp", *PLANNING)


def text_in(one: Exported, kind: str) -> str | None:
    """Return the question in a format, of a repair problem without its domain; None: it cannot be said so."""
    if isinstance(one, PlanningProblem):
        return one.written(kind).problem if kind in PLANNING else None
    return one.wcnf() if kind == "wcnf" else one.lp() if kind == "lp" else None
