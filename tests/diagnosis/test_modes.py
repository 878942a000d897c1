"""Fault modes in answers."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from itertools import product

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pysat.solvers import Solver
from tests.diagnosis.netlists import fresh_solver_diagnoses
from tests.diagnosis.systems import ATOMS, model, systems

from robomend.diagnosis.engines import ENGINES, make_engine
from robomend.diagnosis.result import Options
from robomend.errors import ContradictoryModel
from robomend.model.cnf import Clause, HealthCnf
from robomend.model.loading import load_text
from robomend.oneshots.warm_model import WarmModel
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


@pytest.mark.parametrize("name", ENGINES.built_in)
@pytest.mark.parametrize(
    ("seen", "told"),
    [
        (("not ok(img)", "not ok(log)"), "hard"),
        (("not ok(log)",), "hard"),
        (("not ok(img)",), "soft"),  # both explain it: the first in the model
        (("not ok(img)", "ok(log)"), "soft"),
        (("not ok(other)",), "soft"),
    ],
)
def test_of_the_modes_that_fit_the_one_that_explains_most_is_told(
    name: str, seen: tuple[str, ...], told: str
) -> None:
    system = load_text("""
robomend: 1
nodes:
  camera:
    publishes: {img: [], log: [], other: []}
    modes: {soft: ["not ok(img)"], hard: ["not ok(img)", "not ok(log)"]}
""")
    with WarmModel(system, name) as warm:
        [diagnosis] = warm.ask(warm.question(seen)).result.diagnoses
    assert dict(diagnosis.modes) == {"camera": told}


@pytest.mark.parametrize("name", ENGINES.built_in)
def test_the_modes_of_faults_that_have_nothing_to_do_with_one_another_are_told_together(name: str) -> None:
    first, second = 5, 6  # topics: c1 and c2 make one, c3 and c4 the other; c1 and c3 have modes
    mute, noisy, frozen, wild = 7, 8, 9, 10
    clauses: list[Clause] = [(-1, -2, first), (1, mute, noisy), (-mute, -first), (-noisy, first)]
    clauses += [(-3, -4, second), (3, frozen, wild), (-frozen, -second), (-wild, second)]
    modes = {"c1": {"mute": mute, "noisy": noisy}, "c3": {"frozen": frozen, "wild": wild}}
    cnf = replace(model(4, clauses, atoms=2), variables=10, modes=modes, weak=False)
    engine = make_engine(name, cnf)
    found = engine.diagnose([-Literal(atom) for atom in cnf.atoms]).diagnoses
    engine.close()
    assert {one.bad: dict(one.modes) for one in found} == {
        ("c1", "c3"): {"c1": "mute", "c3": "frozen"},
        ("c1", "c4"): {"c1": "mute"},
        ("c2", "c3"): {"c3": "frozen"},
        ("c2", "c4"): {},
    }


@st.composite
def systems_with_modes(draw: st.DrawFn) -> tuple[HealthCnf, frozenset[Literal]]:
    """Draw a model; some components have two fault modes that imply something, or one and "unknown"."""
    cnf, observations = draw(systems())
    clauses: list[Clause] = list(cnf.clauses)
    modes: dict[str, dict[str, int]] = {}
    top = cnf.variables
    for variable, component in enumerate(cnf.components[:3], 1):
        if not draw(st.booleans()):
            continue
        one, other = top + 1, top + 2
        top += 2
        exhaustive = draw(st.booleans())
        modes[component] = {"stuck": one, "noisy" if exhaustive else "unknown": other}
        clauses += [(variable, one, other), (-one, -other), (-variable, -one), (-variable, -other)]
        atoms = st.integers(len(cnf.components) + 1, len(cnf.components) + ATOMS)
        clauses.append((-one, draw(atoms)))
        if exhaustive:
            clauses.append((-other, -draw(atoms)))
    made = model(len(cnf.components), clauses, modes=modes)
    return replace(made, variables=top, weak=made.weak and not modes), observations


@pytest.mark.parametrize("name", ENGINES.built_in)
@settings(deadline=None)
@given(systems_with_modes())
def test_diagnoses_with_modes_are_those_of_the_definition(
    name: str, system: tuple[HealthCnf, frozenset[Literal]]
) -> None:
    cnf, observations = system
    engine = make_engine(name, cnf)
    try:
        result = engine.diagnose(observations, Options(limit=None, timeout_s=None))
    except ContradictoryModel:
        assert not fresh_solver_diagnoses(cnf, observations)
        return
    finally:
        engine.close()
    assert result.complete
    assert {diagnosis.bad for diagnosis in result.diagnoses} == fresh_solver_diagnoses(cnf, observations)
    with Solver(
        bootstrap_with=[*cnf.clauses, *([number] for one in observations if (number := cnf.literal(one)))]
    ) as solver:
        for diagnosis in result.diagnoses:
            assert set(diagnosis.modes) == set(diagnosis.bad) & set(cnf.modes)
            health = [-v if name in diagnosis.bad else v for name, v in cnf.health.items()]
            fit = [
                modes
                for modes in product(*(cnf.modes[name] for name in diagnosis.modes))
                if solver.solve([*health, *literals_of(cnf, dict(zip(diagnosis.modes, modes, strict=True)))])
            ]
            seen = {number for one in observations if (number := cnf.literal(one))}
            # Named ones before the others, then by what of OBS their sentences say, then as in the model.
            order = [
                sorted(known, key=lambda mode: -sum((-known[mode], one) in cnf.clauses for one in seen))
                for known in (cnf.modes[name] for name in diagnosis.modes)
            ]
            first = min(
                fit,
                key=lambda modes: (
                    [mode == "unknown" for mode in modes],
                    [known.index(mode) for known, mode in zip(order, modes, strict=True)],
                ),
            )
            assert tuple(diagnosis.modes.values()) == first


def literals_of(cnf: HealthCnf, modes: dict[str, str]) -> Iterator[int]:
    """Yield that components are in these modes, and not in one that has no name beside another."""
    for name, mode in modes.items():
        yield cnf.modes[name][mode]
        if mode != "unknown" and "unknown" in cnf.modes[name]:
            yield -cnf.modes[name]["unknown"]
