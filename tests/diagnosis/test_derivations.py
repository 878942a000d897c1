"""All conflicts of Horn rules by backward chaining: named systems, and the definition."""

from __future__ import annotations

import random
from dataclasses import replace

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from tests.diagnosis.systems import brute_force, model, satisfiable

from robomend.diagnosis import derivations
from robomend.diagnosis.derivations import Derivations, TooManyEnvironments
from robomend.diagnosis.engines import make_engine
from robomend.diagnosis.masks import bits
from robomend.diagnosis.observed import NOTHING_SUPPOSED, ObservationReader, Supposed
from robomend.diagnosis.result import Options
from robomend.model.cnf import Clause, HealthCnf
from robomend_bench.odd_models import ladder
from robomend_client.literals import Literal, fails, holds

N, ATOMS = 4, 5  # components 1-4, atoms 5-9
OK = {f"a{i}": N + i for i in range(1, ATOMS + 1)}


def masks(cnf: HealthCnf, *seen: Literal, supposed: Supposed = NOTHING_SUPPOSED) -> list[set[int]]:
    """Return the components of each conflict, as variables."""
    observed = ObservationReader(cnf).read(seen)
    found = Derivations(cnf).conflicts(observed, supposed, lambda: None)
    return [{bit + 1 for bit in bits(one.mask)} for one in found]


def minimal(sets: list[set[int]]) -> set[frozenset[int]]:
    return {frozenset(one) for one in sets if not any(other < one for other in sets)}


CHAIN = model(N, [(-1, 5), (-2, -5, 6), (-3, -6, 7)], atoms=ATOMS)


def test_what_is_derived_over_unseen_atoms_is_one_conflict() -> None:
    assert masks(CHAIN, fails("ok", "a3")) == [{1, 2, 3}]


def test_an_atom_that_was_seen_cuts_the_chain() -> None:
    assert masks(CHAIN, fails("ok", "a3"), holds("ok", "a2")) == [{3}]


def test_an_atom_that_was_seen_to_fail_derives_nothing() -> None:
    assert masks(CHAIN, fails("ok", "a3"), fails("ok", "a2")) == [{1, 2}]


def test_each_way_of_deriving_is_a_conflict_of_its_own() -> None:
    two = model(N, [(-1, 5), (-2, 5), (-3, -5, 6)], atoms=ATOMS)
    assert minimal(masks(two, fails("ok", "a2"))) == {frozenset({1, 3}), frozenset({2, 3})}


def test_atoms_that_derive_only_one_another_are_not_derived() -> None:
    circle = model(N, [(-1, -6, 5), (-2, -5, 6)], atoms=ATOMS)
    assert masks(circle, fails("ok", "a1")) == []
    fed = model(N, [(-1, -6, 5), (-2, -5, 6), (-3, 6)], atoms=ATOMS)
    assert masks(fed, fails("ok", "a1")) == [{1, 3}]


def test_a_rule_without_conclusion_is_a_conflict_where_its_premises_hold() -> None:
    goal = model(N, [(-1, -5), (-2, 5)], atoms=ATOMS)
    assert masks(goal) == [{1, 2}]
    assert masks(goal, holds("ok", "a1")) == [{1}]


def test_those_supposed_healthy_are_no_suspects_and_those_abnormal_derive_nothing() -> None:
    seen = fails("ok", "a3")
    assert masks(CHAIN, seen, supposed=Supposed(healthy=frozenset({2}))) == [{1, 3}]
    assert masks(CHAIN, seen, supposed=Supposed(abnormal=frozenset({2}))) == []


def test_only_horn_rules_with_health_as_a_premise_suit() -> None:
    assert Derivations.suit(CHAIN)
    assert not Derivations.suit(model(N, [(-1, 5, 6)], atoms=ATOMS))
    assert not Derivations.suit(model(N, [(1, 5)], atoms=ATOMS))
    assert not Derivations.suit(replace(CHAIN, circuit=True))


def test_too_many_ways_are_left_to_another_search(monkeypatch: pytest.MonkeyPatch) -> None:
    cnf, seen = ladder(8)  # 256 of them
    assert len(minimal(masks(cnf, *seen))) == 256
    expected = make_engine("sat", cnf).diagnose(seen, Options(limit=None))
    monkeypatch.setattr(derivations, "MAX_ENVIRONMENTS", 100)
    with pytest.raises(TooManyEnvironments):
        masks(cnf, *seen)
    found = make_engine("sat", cnf).diagnose(seen, Options(limit=None))
    assert found.diagnoses[0].bad
    assert {d.bad for d in found.diagnoses} == {d.bad for d in expected.diagnoses}
    assert found.complete


def test_as_many_environments_as_are_allowed_are_found(monkeypatch: pytest.MonkeyPatch) -> None:
    two = model(N, [(-1, 5), (-2, 5), (-3, -5, 6)], atoms=ATOMS)  # one more for the atom, one for its rule
    monkeypatch.setattr(derivations, "MAX_ENVIRONMENTS", 2)
    assert minimal(masks(two, fails("ok", "a2"))) == {frozenset({1, 3}), frozenset({2, 3})}
    monkeypatch.setattr(derivations, "MAX_ENVIRONMENTS", 1)
    with pytest.raises(TooManyEnvironments):
        masks(two, fails("ok", "a2"))


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


@settings(deadline=None)
@given(horn_systems(), st.integers(0, 12))
def test_diagnoses_are_the_same_whatever_the_bound(
    system: tuple[HealthCnf, frozenset[Literal]], bound: int
) -> None:
    cnf, seen = system
    expected = brute_force(cnf, seen)
    if expected is None:
        return
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(derivations, "MAX_ENVIRONMENTS", bound)
        result = make_engine("sat", cnf).diagnose(seen, Options(limit=None, timeout_s=None))
    assert {diagnosis.bad for diagnosis in result.diagnoses} == expected
    assert result.complete


def test_robots_whose_topics_have_several_publishers_agree_with_reiters_algorithm() -> None:
    chance = random.Random(3)
    for _ in range(30):
        n, atoms = 8, 10
        clauses: list[Clause] = []
        for head in range(atoms):
            for _ in range(chance.randint(1, 2)):  # publishers
                body = [-(n + 1 + one) for one in chance.sample(range(atoms), chance.randint(0, 2))]
                clauses.append((-chance.randint(1, n), *body, n + 1 + head))
        clauses = [clause for clause in clauses if -clause[-1] not in clause]
        cnf = model(n, clauses, atoms=atoms)
        seen = [Literal(atom, chance.random() < 0.6) for atom in cnf.atoms if chance.random() < 0.5]
        options = Options(limit=None, timeout_s=None)
        one, other = (make_engine(name, cnf).diagnose(seen, options) for name in ("sat", "hs_dag"))
        assert {d.bad for d in one.diagnoses} == {d.bad for d in other.diagnoses}
