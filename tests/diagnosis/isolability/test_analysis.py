"""Isolability agrees with its definition, pair by pair; and what further observables cost is least."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from contextlib import suppress
from dataclasses import replace
from functools import cached_property
from itertools import combinations, product

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from tests.diagnosis.systems import model, systems

from robomend.diagnosis.engines import make_engine
from robomend.diagnosis.isolability import analysis
from robomend.diagnosis.isolability.analysis import Ambiguity, isolability
from robomend.diagnosis.isolability.comparing import BySearch, Definite, Fault, comparison
from robomend.diagnosis.oracle import Deadline
from robomend.diagnosis.result import Options
from robomend.errors import ContradictoryModel
from robomend.model.cnf import Clause, HealthCnf
from robomend.model.loading import load_model
from robomend_bench.suite import DATA
from robomend_client.literals import Atom, Literal

Seen = tuple[bool, ...]


class ByDefinition:
    """What can be seen of every fault set, over some observed variables."""

    def __init__(self, cnf: HealthCnf, observed: Iterable[int]) -> None:
        self.cnf = cnf
        self.observed = sorted(observed)

    @cached_property
    def shown(self) -> dict[frozenset[int], set[Seen]]:
        """Fault set -> Obs(F): the projections of the models in which just its components are abnormal."""
        count = len(self.cnf.components)
        found: dict[frozenset[int], set[Seen]] = {}
        for signs in product((False, True), repeat=self.cnf.variables):
            if all(any(signs[abs(x) - 1] == (x > 0) for x in clause) for clause in self.cnf.clauses):
                bad = frozenset(c for c in range(1, count + 1) if not signs[c - 1])
                found.setdefault(bad, set()).add(tuple(signs[v - 1] for v in self.observed))
        return found

    def of(self, fault: Iterable[int]) -> set[Seen]:
        return self.shown.get(frozenset(fault), set())

    def diagnosed(self, fault: Sequence[int]) -> set[Seen]:
        """Return the observations of which a fault is a minimal diagnosis."""
        less = [frozenset(some) for size in range(len(fault)) for some in combinations(fault, size)]
        return self.of(fault) - set().union(*map(self.of, less))

    def detectable(self, fault: Sequence[int]) -> bool:
        return bool(self.diagnosed(fault))

    def told(self, fault: Sequence[int], rival: Sequence[int]) -> bool:
        return bool(self.diagnosed(fault) - self.of(rival))

    def always(self, fault: Sequence[int], rival: Sequence[int]) -> bool:
        return not self.diagnosed(fault) & self.of(rival)

    def place(self, fault: Sequence[int], rival: Sequence[int]) -> str:
        """Return what the matrix has to say."""
        if fault == rival:
            return "="
        if not self.told(fault, rival):
            return "-"
        return "+" if self.always(fault, rival) else "~"


def least_cost(
    cnf: HealthCnf,
    observed: Sequence[int],
    goals: Sequence[tuple[Sequence[int], Sequence[int] | None]],
) -> float | None:
    """Return the least cost of further atoms that reach each goal that all atoms together reach."""
    atoms = {variable: atom for atom, variable in cnf.atom_variable.items()}
    left = sorted(set(atoms) - set(observed))

    def reached(goal: tuple[Sequence[int], Sequence[int] | None], by: ByDefinition) -> bool:
        fault, rival = goal
        return by.detectable(fault) if rival is None else by.told(fault, rival)

    everything = ByDefinition(cnf, [*observed, *left])
    within = [goal for goal in goals if reached(goal, everything)]
    if not within:
        return None
    best: float | None = None
    for size in range(len(left) + 1):
        for more in combinations(left, size):
            cost = sum(cnf.costs.get(atoms[variable], 1.0) for variable in more)
            if best is None or cost < best:
                by = ByDefinition(cnf, [*observed, *more])
                if all(reached(goal, by) for goal in within):
                    best = cost
    return best


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


Question = tuple[HealthCnf, list[int]]


def atoms_of(cnf: HealthCnf, observed: list[int]) -> list[Atom]:
    return [atom for atom, variable in cnf.atom_variable.items() if variable in observed]


# --- the definition


def test_single_faults_are_told_apart_as_the_definition_says(long: bool) -> None:
    @settings(max_examples=500 if long else 50)
    @given(questions())
    def agrees(question: Question) -> None:
        cnf, observed = question
        by_definition = ByDefinition(cnf, observed)
        found = isolability(cnf, atoms_of(cnf, observed), timeout_s=None)
        singles = [(variable,) for variable in cnf.health.values()]
        assert found.complete
        assert list(found.detectable) == [by_definition.detectable(fault) for fault in singles]
        assert list(found.matrix) == [
            "".join(by_definition.place(fault, rival) for rival in singles) for fault in singles
        ]

    agrees()


def test_double_faults_are_told_apart_as_the_definition_says(long: bool) -> None:
    @settings(max_examples=500 if long else 30)
    @given(questions())
    def agrees(question: Question) -> None:
        cnf, observed = question
        by_definition = ByDefinition(cnf, observed)
        compared = comparison(cnf, observed, Deadline())
        singles: list[Fault] = [(variable,) for variable in cnf.health.values()]
        doubles: list[Fault] = list(combinations(cnf.health.values(), 2))
        for fault in doubles:
            assert compared.shows(fault) == by_definition.detectable(fault)
        for fault, rival in (*product(doubles, (*singles, *doubles)), *product(singles, doubles)):
            assert compared.told(fault, rival) == by_definition.told(fault, rival)
        compared.close()

    agrees()


def test_no_cheaper_observables_split_a_group(long: bool) -> None:
    @settings(max_examples=200 if long else 25)
    @given(questions())
    def agrees(question: Question) -> None:
        cnf, observed = question
        found = isolability(cnf, atoms_of(cnf, observed), timeout_s=None)
        for group in (*found.ambiguities, *found.undetectable):
            assert group.further is not None
            cost = group.further.cost_s if group.further.atoms else None
            assert cost == least_cost(cnf, observed, goals_of(cnf, group))

    agrees()


def goals_of(cnf: HealthCnf, group: Ambiguity) -> list[tuple[list[int], list[int] | None]]:
    """Return what is asked of a group's further observables; one that shows nothing is to be detected."""
    faults = [[cnf.health[name] for name in fault] for fault in group.faults]
    rivals = [[cnf.health[name] for name in fault] for fault in group.rivals]
    if len(faults) == 1 and not rivals:
        return [(faults[0], None)]
    return [(fault, rival) for fault in faults for rival in (*faults, *rivals) if fault != rival]


def test_a_circuit_is_judged_by_its_inputs_and_outputs_as_the_definition_says() -> None:
    cnf = load_model(DATA / "iscas85" / "c17.bench").cnf
    observed = [cnf.atom_variable[net] for net in (*cnf.inputs, *cnf.outputs)]
    by_definition = ByDefinition(cnf, observed)
    singles = [(variable,) for variable in cnf.health.values()]
    found = isolability(cnf)
    assert found.exact_by == "search"
    assert list(found.matrix) == [
        "".join(by_definition.place(fault, rival) for rival in singles) for fault in singles
    ]


@given(definite())
@settings(max_examples=20)
def test_signatures_say_what_a_search_says(cnf: HealthCnf) -> None:
    assert Definite.of(cnf) is not None
    observed = list(cnf.atom_variable.values())[::2]
    by_signatures, by_search = (
        comparison(cnf, observed, Deadline()),
        BySearch(cnf, frozenset(observed), Deadline()),
    )
    faults = [*((v,) for v in cnf.health.values()), *combinations(cnf.health.values(), 2)]
    for fault, rival in product(faults, faults):
        assert by_signatures.told(fault, rival) == by_search.told(fault, rival)
    by_search.close()


@given(definite())
@settings(max_examples=15)
def test_a_fault_is_told_from_another_where_an_engine_finds_the_one_and_not_the_other(cnf: HealthCnf) -> None:
    found = isolability(cnf, cnf.atoms, timeout_s=None)
    with_engine = make_engine("sat", cnf)
    diagnosed = []
    for signs in product((False, True), repeat=len(cnf.atoms)):
        seen = [Literal(atom, sign) for atom, sign in zip(cnf.atoms, signs, strict=True)]
        with suppress(ContradictoryModel):
            result = with_engine.diagnose(seen, Options(conflicts=False))
            diagnosed.append({one.bad[0] for one in result.diagnoses if len(one.bad) == 1})
    with_engine.close()
    for i, fault in enumerate(cnf.components):
        assert found.detectable[i] == any(fault in bad for bad in diagnosed)
        for j, rival in enumerate(cnf.components):
            if i != j:
                told = any(fault in bad and rival not in bad for bad in diagnosed)
                shared = any(fault in bad and rival in bad for bad in diagnosed)
                assert found.matrix[i][j] == ("-" if not told else "~" if shared else "+")


# --- small systems, by hand

C1, C2, A, B, X = range(1, 6)  # of two components


def test_without_time_the_answer_says_what_it_does_not_know() -> None:
    found = isolability(model(2, [(-C1, A), (-C2, A)], atoms=2), timeout_s=0.0)
    assert not found.complete
    assert found.matrix == ("=?", "?=")
    assert found.detectable == (None, None)


def test_double_faults_beyond_the_bound_are_said_to_be_there(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(analysis, "MOST_DOUBLE_FAULTS", 2)
    cnf = model(3, [(-1, 4), (-2, 5), (-3, 6)], atoms=3)
    doubles = isolability(cnf, double=True).double_faults
    assert doubles is not None
    assert (doubles.faults, doubles.complete) == ((("c1", "c2"), ("c1", "c3")), False)
