"""Posterior, unexplored mass, and diagnoses in order of probability."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from tests.diagnosis.systems import model
from tests.diagnosis.test_hitting_sets import COMPONENTS, families, minimal_hitting_sets, revealing

from robomend.diagnosis.oracle import Deadline, OutOfTime
from robomend.diagnosis.ranking import (
    SCALE,
    by_probability,
    log_odds,
    posterior,
    rank,
    unexplored_mass,
)
from robomend.diagnosis.result import Conflict, Diagnosis, DiagnosisResult, Options

NAMES = [f"c{i}" for i in range(1, COMPONENTS + 1)]

priors = st.lists(st.floats(1e-6, 0.95, exclude_min=True), min_size=len(NAMES), max_size=len(NAMES)).map(
    lambda values: dict(zip(NAMES, values, strict=True))
)


def named(mask: int) -> tuple[str, ...]:
    return tuple(name for bit, name in enumerate(NAMES) if mask >> bit & 1)


def probability_of(mask: int, priors: dict[str, float]) -> float:
    """Return the prior probability of the state in which just these are abnormal."""
    return math.prod(p if mask >> bit & 1 else 1 - p for bit, p in enumerate(priors.values()))


def enumerate_all(family: list[int], priors: dict[str, float]) -> list[int]:
    return list(by_probability(revealing(family), NAMES, priors, Deadline()))


def test_without_the_priors_that_matter_there_is_no_probability() -> None:
    assert posterior([("a",), ("b",)], {}) is None
    assert posterior([("a",), ("b",)], {"a": 0.1}) is None
    assert posterior([], {"a": 0.1}) is None
    assert posterior([("a",)], {"a": 0.1}) == (1.0,)
    assert posterior([()], {"a": 0.1}) == (1.0,)
    assert posterior([("a", "x"), ("b", "x")], {"a": 0.1, "b": 0.1}, given={"x"}) == (0.5, 0.5)


@given(families, priors)
def test_the_posterior_is_that_of_the_states(family: list[int], priors: dict[str, float]) -> None:
    masks = minimal_hitting_sets(family)
    weights = [probability_of(mask, priors) for mask in masks]
    shares = posterior([named(mask) for mask in masks], priors)
    assert shares == pytest.approx([weight / sum(weights) for weight in weights])


@settings(deadline=None)
@given(families, priors)
def test_diagnoses_come_in_order_of_probability(family: list[int], priors: dict[str, float]) -> None:
    found = enumerate_all(family, priors)
    assert sorted(found) == sorted(minimal_hitting_sets(family))
    weights = [math.fsum(log_odds(priors[name]) for name in named(mask)) for mask in found]  # exact sums
    assert weights == sorted(weights, reverse=True)


@given(families, priors, st.integers(0, 5), st.integers(0, 5))
def test_the_unexplored_mass_is_an_upper_bound(
    family: list[int], priors: dict[str, float], found: int, known: int
) -> None:
    masks = minimal_hitting_sets(family)[:found]
    bound = unexplored_mass([named(m) for m in masks], [named(c) for c in family[:known]], priors)
    left = sum(
        probability_of(state, priors)
        for state in range(2 ** len(NAMES))
        if all(state & conflict for conflict in family) and not any(state & m == m for m in masks)
    )
    assert bound is not None
    assert bound >= left - 1e-12


@given(families, priors, st.integers(0, 5))
def test_where_supersets_may_not_be_diagnoses_only_the_states_themselves_are_accounted_for(
    family: list[int], priors: dict[str, float], found: int
) -> None:
    masks = minimal_hitting_sets(family)[:found]
    bound = unexplored_mass(
        [named(m) for m in masks], [named(c) for c in family], priors, weak=False, components=NAMES
    )
    left = sum(
        probability_of(state, priors)
        for state in range(2 ** len(NAMES))
        if all(state & conflict for conflict in family) and state not in masks
    )
    assert bound is not None
    assert bound >= left - 1e-12


def test_rounding_does_not_change_the_order() -> None:
    """c is more probable than a and b together by 0.2 of a unit; rounded, it is less by one."""
    odds = {"a": 2 + 0.4 / SCALE, "b": 2 + 0.4 / SCALE, "c": 4 + 0.6 / SCALE}
    priors = {name: 1 / (1 + math.exp(cost)) for name, cost in odds.items()}

    assert list(by_probability(revealing([0b101, 0b110]), list(odds), priors, Deadline())) == [0b100, 0b011]


def test_what_was_found_before_the_deadline_is_not_lost() -> None:
    clock = Deadline()
    certain = dict.fromkeys(NAMES, 0.9)  # each is held back: any larger set is more probable

    def find_conflict(mask: int) -> int | None:
        if not mask:
            return 0b11
        clock.stop()
        return None

    found: list[int] = []
    search = by_probability(find_conflict, NAMES, certain, clock)
    with pytest.raises(OutOfTime):
        found.extend(search)
    assert found in ([0b01], [0b10])


def test_a_result_is_ranked_and_says_what_is_left() -> None:
    cnf = model(2, [(-1, -2, 3)], priors={"c1": 0.1, "c2": 0.3})
    conflict = Conflict(("c1", "c2"), (), (), "")
    result = DiagnosisResult(
        cnf.components, (Diagnosis(("c1",)), Diagnosis(("c2",))), True, None, (conflict,), 0.0
    )
    ranked = rank(result, cnf, Options())
    assert [diagnosis.bad for diagnosis in ranked.diagnoses] == [("c1",), ("c2",)]
    assert sum(diagnosis.probability or 0 for diagnosis in ranked.diagnoses) == pytest.approx(1)
    assert ranked.unexplored == 0.0
    # Where what is abnormal must misbehave, a state beyond a diagnosis may be possible or not: it is not
    # accounted for, however complete the list is.
    strong = rank(result, replace(cnf, weak=False), Options())
    assert strong.unexplored is not None
    assert strong.unexplored > 0.01
    by_weight = rank(result, cnf, Options(order="probability"))
    assert [diagnosis.bad for diagnosis in by_weight.diagnoses] == [("c2",), ("c1",)]
    smallest = rank(result, cnf, Options(minimal="cardinality"))
    assert smallest.unexplored == pytest.approx(0.0)  # 1 - 0.9 * 0.7, less what the two account for
    without = model(2, [(-1, -2, 3)])
    assert rank(result, without, Options()) == result
