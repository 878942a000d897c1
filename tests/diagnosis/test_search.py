"""Diagnoses as products: a row of factors, each with its alternatives."""

from __future__ import annotations

from robomend.diagnosis.result import Factor
from robomend.diagnosis.search import factors


def test_alternatives_of_a_factor_are_told_as_single_components_and_as_sets() -> None:
    row = (((1,), (2, 3)), ((4,),))
    assert factors(row, "abcd") == (Factor("a", ("a",), (("b", "c"),)), Factor("d", ("d",), ()))
