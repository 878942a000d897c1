"""Small random models and what is observed of them: definite ones as of robots, and of any shape."""

from __future__ import annotations

from dataclasses import replace

from hypothesis import strategies as st
from tests.diagnosis.systems import model, systems

from robomend.model.cnf import Clause, HealthCnf

MOST_ATOMS = 6


@st.composite
def definite(draw: st.DrawFn) -> HealthCnf:
    """Draw a model with at most one definite rule an atom; atoms may need one another in circles."""
    components = draw(st.integers(2, 4))
    atoms = draw(st.integers(2, MOST_ATOMS))
    clauses: list[Clause] = []
    for head in range(components + 1, components + atoms + 1):
        needed = draw(st.lists(st.integers(1, components + atoms), min_size=0, max_size=4, unique=True))
        if needed and head not in needed:
            clauses.append((*(-variable for variable in needed), head))
    return model(components, clauses, atoms)


@st.composite
def questions(draw: st.DrawFn) -> tuple[HealthCnf, list[int]]:
    """Draw a model with costs, and the variables that are observed: some atoms, at least one."""
    cnf = draw(st.one_of(definite(), definite(), systems().map(lambda drawn: drawn[0])))
    mentioned = {abs(literal) for clause in cnf.clauses for literal in clause}
    atoms = list(cnf.atom_variable.values())
    observed = draw(st.lists(st.sampled_from(atoms), min_size=1, max_size=len(atoms), unique=True))
    prices = st.sampled_from((0.5, 1.0, 2.0, 3.0))
    costs = {atom: draw(prices) for atom, variable in cnf.atom_variable.items() if variable in mentioned}
    return replace(cnf, costs=costs), sorted(observed)
