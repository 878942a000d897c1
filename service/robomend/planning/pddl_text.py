"""A repair problem as PDDL text, for people and for other planners.

Names that are no PDDL words, or that differ in case only, become `o7`; a comment says what each stands for.
"""

from __future__ import annotations

import re
from collections.abc import Iterable

from robomend.planning.domain.values import Domain
from robomend.planning.problem import Fact, RepairProblem

WORD = re.compile(r"[A-Za-z][A-Za-z0-9_-]*\Z")


def problem_text(domain: Domain, problem: RepairProblem, goal: Iterable[Fact]) -> str:
    """Return the problem file that goes with `domain.pddl`."""
    names = pddl_names(problem.objects)
    renamed = [f";; {word} is {name}" for name, word in names.items() if word != name.lower()]
    lines = [
        ";; Made by robomend. Protected and excluded components are not expressed here: their shutdown and",
        ";; stop actions are left out before planning.",
        *renamed,
        f"(define (problem {_word(problem.name)})",
        f"  (:domain {domain.name})",
        "  (:objects",
    ]
    by_type: dict[str, list[str]] = {}
    for name, kind in problem.objects.items():
        if name not in domain.constants:
            by_type.setdefault(kind, []).append(names[name])
    lines += [f"    {' '.join(members)} - {kind}" for kind, members in by_type.items()]
    lines[-1] += ")"
    lines.append("  (:init")
    lines += [f"    {_fact(fact, names)}" for fact in sorted(problem.initial)]
    lines += ["    (= (total-cost) 0))", "  (:goal (and"]
    lines += [f"    {_fact(fact, names)}" for fact in goal]
    lines += ["  ))", "  (:metric minimize (total-cost)))", ""]
    return "\n".join(lines)


def pddl_names(objects: Iterable[str]) -> dict[str, str]:
    """Return object -> its word in the problem file, each word once."""
    found: dict[str, str] = {}
    taken: set[str] = set()
    for index, name in enumerate(objects):
        word = name.lower()
        if not WORD.match(name) or word in taken:
            word = f"o{index}"
            while word in taken:
                word += "x"
        taken.add(word)
        found[name] = word
    return found


def _word(name: str) -> str:
    return name.lower() if WORD.match(name) else "robot"


def _fact(fact: Fact, names: dict[str, str]) -> str:
    return f"({' '.join((fact[0], *(names[name] for name in fact[1:])))})"
