"""One fault set that explains many snapshots."""

from __future__ import annotations

import json
from dataclasses import replace
from functools import reduce
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pysat.solvers import Solver
from tests.diagnosis.systems import brute_force, model, systems

from robomend.diagnosis.engines import make_engine
from robomend.diagnosis.explanations import explain_diagnoses
from robomend.diagnosis.result import Options
from robomend.diagnosis.snapshots import SnapshotEngine, diagnose_snapshots
from robomend.diagnosis.wcnf import read_wcnf
from robomend.errors import ContradictoryModel, OptionRefused
from robomend.model.cnf import HealthCnf
from robomend_client.literals import Literal, fails, holds

DATA = Path(__file__).parent.parent.parent / "clients/robomend_bench/data/multi_observation"

EVERYTHING = Options(limit=None)

TWO_LAMPS = model(
    3,  # c1 feeds the lamps c2 and c3; a1 and a2 are lit, a3: the switch is on
    [(-1, -2, -6, 4), (-1, -3, -6, 5), (-2, 6, -4)],
    atoms=3,
)


def union_of_snapshots(cnf: HealthCnf, snapshots: list[frozenset[Literal]]) -> set[tuple[str, ...]] | None:
    """By definition, from the minimal diagnoses of each: Δ must contain one of each snapshot's."""
    each = [brute_force(cnf, snapshot) for snapshot in snapshots]
    if any(diagnoses is None for diagnoses in each):
        return None
    families = [{frozenset(bad) for bad in diagnoses or ()} for diagnoses in each]
    unions = reduce(lambda left, right: {a | b for a in left for b in right}, families, {frozenset[str]()})
    minimal = {bad for bad in unions if not any(other < bad for other in unions)}
    return {tuple(sorted(bad)) for bad in minimal}


def blamed(
    cnf: HealthCnf, snapshots: list[frozenset[Literal]], options: Options = EVERYTHING
) -> list[tuple[str, ...]]:
    result = diagnose_snapshots(cnf, snapshots, options)
    assert result.complete
    return [diagnosis.bad for diagnosis in result.diagnoses]


def test_conflicts_say_what_was_seen_and_healthy_suspects_are_cleared() -> None:
    dark = frozenset({holds("ok", "a3"), fails("ok", "a1"), fails("ok", "a2")})
    result = diagnose_snapshots(TWO_LAMPS, [dark])
    assert {conflict.components for conflict in result.conflicts} == {("c1", "c2"), ("c1", "c3")}
    assert set(result.cleared) == {"c2", "c3"}
    assert result.diagnoses[0].resolves == (0, 1)
    assert explain_diagnoses(result.diagnoses, result.conflicts)[0] == "c1 explains not ok(a1) and not ok(a2)"


def test_what_is_supposed_healthy_is_named_in_a_conflict_as_of_one_snapshot() -> None:
    dark = frozenset({holds("ok", "a3"), fails("ok", "a1"), fails("ok", "a2")})
    options = Options(healthy=frozenset({"c2"}))
    engine = make_engine("sat", TWO_LAMPS)
    one = engine.diagnose(dark, options)
    engine.close()
    together = diagnose_snapshots(TWO_LAMPS, [dark], options)
    assert {(c.components, c.text, c.unmet) for c in together.conflicts} == {
        (c.components, c.text, c.unmet) for c in one.conflicts
    }


@settings(deadline=None)
@given(st.data())
def test_agrees_with_the_definition(data: st.DataObject) -> None:
    cnf, first = data.draw(systems())
    atoms = st.dictionaries(st.sampled_from(cnf.atoms), st.booleans())
    more = data.draw(st.lists(atoms, max_size=3))
    snapshots = [first, *(frozenset(Literal(atom, sign) for atom, sign in seen.items()) for seen in more)]
    expected = union_of_snapshots(cnf, snapshots)
    if expected is None:
        with pytest.raises(ContradictoryModel):
            diagnose_snapshots(cnf, snapshots)
        return
    with pytest.MonkeyPatch.context() as patch:  # ask whether there are others now and then, or each time
        patch.setattr("robomend.diagnosis.snapshots.ASKED_AGAIN", data.draw(st.sampled_from((0, 4))))
        patch.setattr("robomend.diagnosis.snapshots.OFTEN", data.draw(st.sampled_from((0, 8))))
        everything = blamed(cnf, snapshots)
    assert len(everything) == len(expected)
    assert set(everything) == expected
    assert [len(bad) for bad in everything] == sorted(len(bad) for bad in everything)
    least = len(everything[0])
    assert set(blamed(cnf, snapshots, replace(EVERYTHING, minimal="cardinality"))) == {
        bad for bad in expected if len(bad) == least
    }


@settings(deadline=None)
@given(systems(weak=True), st.integers(0, 3), st.integers(1, 3))
def test_bounds_are_kept_and_told(drawn: tuple[HealthCnf, frozenset[Literal]], size: int, limit: int) -> None:
    cnf, seen = drawn
    expected = brute_force(cnf, seen)
    assert expected is not None
    by_size = diagnose_snapshots(cnf, [seen], Options(max_size=size, limit=None))
    assert {diagnosis.bad for diagnosis in by_size.diagnoses} == {b for b in expected if len(b) <= size}
    assert by_size.complete == all(len(bad) <= size for bad in expected)
    limited = diagnose_snapshots(cnf, [seen], Options(limit=limit))
    assert len(limited.diagnoses) == min(limit, len(expected))
    assert (limited.stopped_by == "limit") == (len(expected) > limit)
    assert {diagnosis.bad for diagnosis in limited.diagnoses} <= expected
    sizes = [len(diagnosis.bad) for diagnosis in limited.diagnoses]
    assert sizes == sorted(map(len, expected))[:limit]  # none that is left out is smaller


def test_what_is_listed_is_the_smallest_whichever_of_the_two_searches_comes_first(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    pairs = [(-1, -second, 7) for second in range(2, 7)]  # c1, or all five others
    others = [(-2, -third, 8) for third in range(3, 7)]  # c2, or four
    cnf = model(6, [*pairs, *others], atoms=2)
    seen = [frozenset({fails("ok", "a1"), fails("ok", "a2")})]
    for head_start in (-1e9, 0.0, 1e9):
        monkeypatch.setattr("robomend.diagnosis.snapshots.HEAD_START_S", head_start)
        assert blamed(cnf, seen) == [
            ("c1", "c2"),
            ("c1", "c3", "c4", "c5", "c6"),
            ("c2", "c3", "c4", "c5", "c6"),
        ]
        (least,) = diagnose_snapshots(cnf, seen, Options(limit=1)).diagnoses
        assert least.bad == ("c1", "c2")


@pytest.mark.parametrize("calls", [0, 3, 1_000])
def test_told_conflicts_are_minimal_however_large_those_of_the_search_are(
    calls: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    file = read_wcnf(DATA / "c432" / "c432mut285p.wcnf.gz")
    cnf, seen = file.cnf, file.snapshots
    every = [one.bad for one in diagnose_snapshots(cnf, seen, EVERYTHING).diagnoses]
    monkeypatch.setattr("robomend.diagnosis.snapshots.ROUGH_CALLS", calls)
    result = diagnose_snapshots(cnf, seen, Options(limit=None, max_size=len(every[-1]), timeout_s=None))
    assert [one.bad for one in result.diagnoses] == every
    assert result.conflicts
    with Solver("minisat22", bootstrap_with=cnf.clauses) as solver:
        for conflict in result.conflicts:
            assert conflict.minimal
            healthy = [cnf.health[component] for component in conflict.components]
            rests_on = [number for one in conflict.observations if (number := cnf.literal(one)) is not None]
            assert not solver.solve([*healthy, *rests_on])
            for needed in healthy:
                assert solver.solve([*(other for other in healthy if other != needed), *rests_on])


def test_a_snapshot_that_contradicts_the_model_is_an_error() -> None:
    broken = model(1, [(2,), (-1, 3)], atoms=2)
    with pytest.raises(ContradictoryModel, match="a1"):
        diagnose_snapshots(broken, [[holds("ok", "a2")], [fails("ok", "a1")]])


def test_what_snapshots_cannot_have_is_refused() -> None:
    for options in (Options(order="probability"), Options(factored=True, minimal="cardinality")):
        with pytest.raises(OptionRefused):
            diagnose_snapshots(TWO_LAMPS, [], options)


@pytest.mark.parametrize("circuit", ["c17", "c432", "c499", "c880"])
def test_published_counts_are_reached(circuit: str, long: bool) -> None:
    published = json.loads((DATA / "hsd.json").read_text())["stats"]
    files = sorted((DATA / circuit).glob("*.wcnf.gz"))
    assert files
    for path in files if long else files[:4]:
        engine = SnapshotEngine(read_wcnf(path).cnf)
        result = engine.diagnose(read_wcnf(path).snapshots, Options(limit=None, timeout_s=300))
        engine.close()
        key = f"iscas85-mobs/{circuit}/{path.name.removesuffix('.gz')}"
        assert (key, result.complete, len(result.diagnoses)) == (key, True, published[key]["diags"])
