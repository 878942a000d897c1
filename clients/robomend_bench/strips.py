"""A repair problem as plain STRIPS, for planners that read no more: ground, without types, quantifiers,
conditional effects or negative preconditions.

    (start_node imu_node)    ──►   (start_node__imu_node)      an action without parameters
    (good imu)               ──►   (good__imu)                 a predicate without arguments; of what cannot
                                                               change, none
    asked for: not (bad imu) ──►   (not__bad__imu)             a fact of its own, kept opposite by all actions

All ground actions are there, whether a plan can use them or not: choosing is the planner's work. Only those
that may not be taken (of protected components) are left out.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from robomend.planning.domain.values import Domain
from robomend.planning.grounding import GroundAction, Grounder
from robomend.planning.pddl_text import pddl_names
from robomend.planning.problem import Fact, RepairProblem
from robomend.planning.validation import Named


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
