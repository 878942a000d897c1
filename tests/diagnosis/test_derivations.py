"""All conflicts of Horn rules by backward chaining: named systems, and the definition."""

from __future__ import annotations

from types import ModuleType

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from tests.diagnosis.systems import brute_force, model, satisfiable, systems

from robomend.diagnosis import by_conflicts, derivations
from robomend.diagnosis.derivations import Derivations
from robomend.diagnosis.engines import make_engine
from robomend.diagnosis.masks import bits
from robomend.diagnosis.observed import NOTHING_SUPPOSED, ObservationReader, Supposed
from robomend.diagnosis.result import Options
from robomend.model.cnf import Clause, HealthCnf
from robomend_client.literals import Literal

N, ATOMS = 4, 5  # components 1-4, atoms 5-9
OK = {f"a{i}": N + i for i in range(1, ATOMS + 1)}


def masks(cnf: HealthCnf, *seen: Literal, supposed: Supposed = NOTHING_SUPPOSED) -> list[set[int]]:
    """Return the components of each conflict, as variables."""
    observed = ObservationReader(cnf).read(seen)
    found = Derivations(cnf).conflicts(observed, supposed, lambda: None)
    return [{bit + 1 for bit in bits(one.mask)} for one in found]


@st.composite
def horn_systems(draw: st.DrawFn) -> tuple[HealthCnf, frozenset[Literal]]:
    clauses: list[Clause] = []
    for _ in range(draw(st.integers(1, 12))):
        health = draw(st.lists(st.integers(1, N), max_size=2, unique=True))
        body = draw(st.lists(st.sampled_from(list(OK.values())), max_size=2, unique=True))
        head = draw(st.sampled_from([0, *OK.values()]))
        clause = (*(-v for v in health), *(-v for v in body), *([head] if head else []))
        if clause and head not in body:
            clauses.append(clause)
    cnf = model(N, clauses, atoms=ATOMS)
    signs = draw(st.dictionaries(st.sampled_from(cnf.atoms), st.booleans()))
    return cnf, frozenset(Literal(atom, positive) for atom, positive in signs.items())


@settings(deadline=None)
@given(horn_systems())
def test_all_minimal_conflicts_are_among_them(system: tuple[HealthCnf, frozenset[Literal]]) -> None:
    cnf, seen = system
    numbers = [(number,) for number in map(cnf.literal, seen) if number is not None]
    found = masks(cnf, *seen)

    def conflict(components: set[int]) -> bool:
        return not satisfiable([*cnf.clauses, *numbers, *((c,) for c in components)], cnf.variables)

    assert all(map(conflict, found))
    for number in range(2**N):
        components = {bit + 1 for bit in bits(number)}
        smaller = any(conflict(components - {c}) for c in components)
        if conflict(components) and not smaller:
            assert components in found


def same_with(
    system: tuple[HealthCnf, frozenset[Literal]], module: ModuleType, constant: str, value: int
) -> None:
    """The diagnoses are those of the definition, whatever a bound of the search is."""
    cnf, seen = system
    expected = brute_force(cnf, seen)
    if expected is None:
        return
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(module, constant, value)
        result = make_engine("sat", cnf).diagnose(seen, Options(limit=None, timeout_s=None))
    assert {diagnosis.bad for diagnosis in result.diagnoses} == expected
    assert result.complete


@settings(deadline=None)
@given(horn_systems(), st.integers(0, 12))
def test_diagnoses_are_the_same_whatever_the_bound(
    system: tuple[HealthCnf, frozenset[Literal]], bound: int
) -> None:
    same_with(system, derivations, "MAX_ENVIRONMENTS", bound)


# components 1-4, atoms 5-9


@pytest.mark.parametrize("nodes", [0, 3, 20])
@settings(deadline=None)
@given(systems())
def test_another_search_goes_on_from_what_was_found(
    nodes: int, system: tuple[HealthCnf, frozenset[Literal]]
) -> None:
    same_with(system, by_conflicts, "SEARCHED_NODES", nodes)
