"""Formulas of preconditions and effects: what they speak of."""

from __future__ import annotations

from robomend.planning.domain.formulas import (
    Conjunction,
    Disjunction,
    Equal,
    Exists,
    Forall,
    Is,
    Negation,
    atoms,
)

ON, OFF, BAD = (Is(name, ("?h",)) for name in ("on", "off", "bad"))


def test_the_atoms_of_a_formula_are_those_at_any_depth() -> None:
    deep = Forall((("?h", "hardware"),), Conjunction((ON, Negation(Disjunction((OFF, Equal("?h", "?g")))))))
    assert list(atoms(Exists((("?g", "hardware"),), Conjunction((deep, BAD))))) == [ON, OFF, BAD]
    assert list(atoms(Equal("?h", "?g"))) == []
