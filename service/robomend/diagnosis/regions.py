"""Regions of a model that say nothing of one another, once OBS is known.

What is observed satisfies some clauses and shortens others. Clauses that still share a variable are one
region: whether it can be healthy does not depend on what is wrong in another. A variable that occurs with one
sign only satisfies all its clauses, so those go first; with them goes what nobody looks at.

    ¬AB(a) → ok(x)         x seen not ok      region {a}
    ¬AB(b) ∧ ok(y) → ok(z) y seen ok          z was not seen and nothing follows from it: no region
    ¬AB(c) ∧ ok(v) → ok(w) w seen not ok  ┐
    ¬AB(d) → ok(v)                        ┘   region {c, d}

It takes time in proportion to the model, so it is done when a first diagnosis has more than one member.
Models whose conflicts can be listed (derivations.py) do without.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable

from robomend.model.cnf import Clause, HealthCnf


def regions(cnf: HealthCnf, implied: Iterable[int], supposed_abnormal: Collection[int]) -> list[int]:
    """Return the components of each region as masks, given the literals that OBS and what-ifs imply.

    A component that must be abnormal is a region of its own, unless it is supposed to be.
    """
    true = set(implied)
    n = len(cnf.components)
    certain = [-number for number in true if -n <= number < 0 and -number not in supposed_abnormal]
    clauses: list[Clause | None] = []
    occurs: dict[int, list[int]] = {}
    for clause in cnf.clauses:
        if true.isdisjoint(clause):
            left = tuple(literal for literal in clause if -literal not in true)
            for literal in left:
                occurs.setdefault(literal, []).append(len(clauses))
            clauses.append(left)
    count = {literal: len(where) for literal, where in occurs.items()}
    pure = [literal for literal in count if abs(literal) > n and -literal not in count]
    for literal in pure:  # grows while it is read
        for index in occurs[literal]:
            clause_ = clauses[index]
            if clause_ is None:
                continue
            clauses[index] = None
            for other in clause_:
                count[other] -= 1
                if not count[other] and abs(other) > n and count.get(-other):
                    pure.append(-other)
    return [1 << (c - 1) for c in sorted(certain)] + _connected([clause for clause in clauses if clause], n)


def _connected(clauses: Iterable[Clause], components: int) -> list[int]:
    """Return the components of clauses that share variables, directly or through others."""
    leader: dict[int, int] = {}

    def find(variable: int) -> int:
        root = variable
        while leader[root] != root:
            root = leader[root]
        while leader[variable] != root:
            leader[variable], variable = root, leader[variable]
        return root

    for clause in clauses:
        first = abs(clause[0])
        leader.setdefault(first, first)
        for literal in clause[1:]:
            other = abs(literal)
            leader.setdefault(other, other)
            leader[find(other)] = find(first)
    masks: dict[int, int] = {}
    for variable in leader:
        if variable <= components:
            root = find(variable)
            masks[root] = masks.get(root, 0) | 1 << (variable - 1)
    return list(masks.values())
