"""Random systems and the oracle that the engines are held against: Reiter's definition, over all subsets."""

from __future__ import annotations

from functools import cache, reduce
from itertools import combinations
from operator import or_

from hypothesis import strategies as st

from robomend.model.cnf import Clause, HealthCnf, Rule
from robomend_client.literals import Atom, Literal

ATOMS = 4


def model(components: int, clauses: list[Clause], atoms: int = ATOMS, **more: object) -> HealthCnf:
    """Return a model with components c1 …, atoms a1 … and one rule a clause."""
    return HealthCnf(
        name="random",
        components=tuple(f"c{i}" for i in range(1, components + 1)),
        atoms=tuple(Atom("ok", (f"a{i}",)) for i in range(1, atoms + 1)),
        clauses=tuple(clauses),
        origins=tuple(range(len(clauses))),
        rules=tuple(
            Rule(" or ".join(map(str, clause)), f"user rule {i}") for i, clause in enumerate(clauses, 1)
        ),
        variables=components + atoms,
        weak=all(literal <= -1 for clause in clauses for literal in clause if abs(literal) <= components),
        **more,  # type: ignore[arg-type]  # fields of HealthCnf, by name
    )


def satisfiable(clauses: list[Clause], variables: int) -> bool:
    """Return whether some assignment satisfies the clauses, by trying all: each is a bit of a number."""
    every = left = (1 << (1 << variables)) - 1
    for clause in clauses:
        left &= reduce(
            or_, (_where(literal, variables) ^ (every if literal < 0 else 0) for literal in clause), 0
        )
    return left != 0


@cache
def _where(literal: int, variables: int) -> int:
    """Return the assignments in which a literal's variable is true."""
    half = 1 << (abs(literal) - 1)
    found, width = ((1 << half) - 1) << half, 2 * half
    while width < 1 << variables:
        found |= found << width
        width *= 2
    return found


def brute_force(cnf: HealthCnf, observations: frozenset[Literal]) -> set[tuple[str, ...]] | None:
    """Return the subset-minimal diagnoses by definition; None when even all abnormal does not help."""
    n = len(cnf.components)
    seen = [(number,) for number in map(cnf.literal, observations) if number is not None]
    minimal: list[frozenset[int]] = []
    for size in range(n + 1):
        for bad in map(frozenset, combinations(range(1, n + 1), size)):
            if any(smaller <= bad for smaller in minimal):
                continue
            healthy = [(i,) for i in range(1, n + 1) if i not in bad]
            if satisfiable([*cnf.clauses, *seen, *healthy], cnf.variables):
                minimal.append(bad)
    if not minimal:
        return None
    return {tuple(cnf.components[i - 1] for i in sorted(bad)) for bad in minimal}


@st.composite
def systems(draw: st.DrawFn, weak: bool | None = None) -> tuple[HealthCnf, frozenset[Literal]]:
    """Draw a model of up to 5 components with conflicts drawn outright, and clauses of any shape, and OBS."""
    n = draw(st.integers(1, 5))
    health = st.integers(1, n)
    atom = st.integers(n + 1, n + ATOMS)
    blamed = st.lists(health, min_size=1, max_size=3, unique=True).map(lambda cs: [-c for c in cs])
    values = st.lists(st.tuples(atom, st.booleans()), min_size=0, max_size=3, unique_by=lambda p: p[0]).map(
        lambda ps: [a if positive else -a for a, positive in ps]
    )
    shapes = [st.tuples(blamed, values).map(lambda parts: tuple(parts[0] + parts[1]))]
    if not weak:
        free = st.lists(st.integers(1, n + ATOMS), min_size=1, max_size=3, unique=True)
        shapes.append(
            st.tuples(free, st.lists(st.booleans(), min_size=3, max_size=3)).map(
                lambda pair: tuple(v if s else -v for v, s in zip(pair[0], pair[1], strict=False))
            )
        )
    clauses = draw(st.lists(st.one_of(shapes), min_size=1, max_size=12))
    cnf = model(n, clauses)
    signs = draw(st.dictionaries(st.integers(0, ATOMS - 1), st.booleans()))
    return cnf, frozenset(Literal(cnf.atoms[i], positive) for i, positive in signs.items())
