"""Fault modes in answers, and engines of third parties."""

from __future__ import annotations

from dataclasses import replace
from importlib.metadata import EntryPoint

import pytest
from tests.diagnosis.systems import model

from robomend.diagnosis import engines
from robomend.diagnosis.engines import BUILT_IN, engine_names, make_engine
from robomend.diagnosis.result import Options
from robomend.diagnosis.sat import SatEngine
from robomend.errors import OptionRefused, SolverError
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


@pytest.mark.parametrize("name", BUILT_IN)
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


def test_third_parties_register_engines_by_entry_point(monkeypatch: pytest.MonkeyPatch) -> None:
    points = [
        EntryPoint("mine", "robomend.diagnosis.sat:SatEngine", engines.GROUP),
        EntryPoint("broken", "robomend.nowhere:Engine", engines.GROUP),
        EntryPoint("maxsat", "robomend.diagnosis.sat:SatEngine", engines.GROUP),
    ]

    def entry_points(group: str, name: str | None = None) -> list[EntryPoint]:
        return [point for point in points if point.group == group and name in (None, point.name)]

    monkeypatch.setattr(engines, "entry_points", entry_points)
    assert engine_names() == (*BUILT_IN, "broken", "mine")
    assert isinstance(make_engine("mine", motor()), SatEngine)
    assert not isinstance(make_engine("maxsat", motor()), SatEngine)
    with pytest.raises(SolverError, match="could not be loaded"):
        make_engine("broken", motor())
    with pytest.raises(OptionRefused, match="mine"):
        make_engine("nosuch", motor())
