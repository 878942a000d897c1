"""Fault modes in answers."""

from __future__ import annotations

from dataclasses import replace

import pytest
from tests.diagnosis.systems import model

from robomend.diagnosis.engines import ENGINES, make_engine
from robomend.diagnosis.result import Options
from robomend.model.cnf import HealthCnf
from robomend_client.literals import Literal

MOTOR, TURNS, STUCK, REVERSED = 1, 2, 6, 7


def motor() -> HealthCnf:
    """A healthy motor turns (a1); a broken one is stuck, or turns backwards (a2)."""
    clauses = [
        (-MOTOR, TURNS),
        (-MOTOR, -(TURNS + 1)),
        (MOTOR, STUCK, REVERSED),
        (-STUCK, -TURNS),
        (-STUCK, -(TURNS + 1)),
        (-REVERSED, TURNS),
        (-REVERSED, TURNS + 1),
    ]
    modes = {"c1": {"stuck": STUCK, "reversed": REVERSED}}
    return replace(model(1, clauses), variables=7, modes=modes, weak=False)


@pytest.mark.parametrize("name", ENGINES.built_in)
@pytest.mark.parametrize("minimal", ["cardinality", "subset"])
def test_the_mode_that_fits_is_told(name: str, minimal: str) -> None:
    cnf = motor()
    turns, backwards = (Literal(atom) for atom in cnf.atoms[:2])
    engine = make_engine(name, cnf)
    options = Options(minimal="cardinality" if minimal == "cardinality" else "subset")
    assert engine.diagnose([turns, -backwards], options).healthy
    (stuck,) = engine.diagnose([-turns], options).diagnoses
    assert (stuck.bad, dict(stuck.modes)) == (("c1",), {"c1": "stuck"})
    (reversed_,) = engine.diagnose([backwards], options).diagnoses
    assert dict(reversed_.modes) == {"c1": "reversed"}
    engine.close()
