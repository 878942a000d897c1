"""Every engine against Reiter's definition, against each other, and against its own word."""

from __future__ import annotations

import random
from dataclasses import replace
from itertools import pairwise
from math import log, prod

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from tests.diagnosis.netlists import circuit
from tests.diagnosis.systems import brute_force, model, satisfiable, systems

from robomend.diagnosis.engines import ENGINES, make_engine
from robomend.diagnosis.result import Minimal, Options
from robomend.errors import ContradictoryModel, OptionRefused, UnknownComponent
from robomend.model.cnf import HealthCnf
from robomend_bench.generator import make_robot, observe
from robomend_client.literals import Atom, Literal, holds

OURS = tuple(ENGINES.built_in)
ALL = Options(limit=None, timeout_s=None)
System = tuple[HealthCnf, frozenset[Literal]]

engines = pytest.mark.parametrize("name", OURS)


@engines
@settings(deadline=None)
@given(systems())
def test_diagnoses_are_those_of_the_definition(name: str, system: System) -> None:
    cnf, observations = system
    expected = brute_force(cnf, observations)
    engine = make_engine(name, cnf)
    if expected is None:
        with pytest.raises(ContradictoryModel):
            engine.diagnose(observations, ALL)
        return
    subset = engine.diagnose(observations, ALL)
    assert subset.complete
    assert {diagnosis.bad for diagnosis in subset.diagnoses} == expected
    sizes = [len(diagnosis.bad) for diagnosis in subset.diagnoses]
    assert sizes == sorted(sizes)
    assert len(sizes) == len(expected) == subset.count
    least = min(map(len, expected))
    minimum = engine.diagnose(observations, Options(minimal="cardinality", limit=None, timeout_s=None))
    assert {diagnosis.bad for diagnosis in minimum.diagnoses} == {
        bad for bad in expected if len(bad) == least
    }
    assert minimum.complete
    assert engine.consistent(observations) == (() in expected) == subset.healthy
    engine.close()


@engines
@settings(deadline=None)
@given(
    systems(),
    st.integers(0, 3),
    st.integers(1, 4),
    st.sampled_from(["cardinality", "subset"]),
)
def test_bounds_are_kept_and_completeness_is_true(
    name: str, system: System, max_size: int, limit: int, minimal: Minimal
) -> None:
    cnf, observations = system
    expected = brute_force(cnf, observations)
    options = Options(minimal=minimal, max_size=max_size, limit=limit, timeout_s=None)
    engine = make_engine(name, cnf)
    if expected is None:
        with pytest.raises(ContradictoryModel):
            engine.diagnose(observations, options)
        return
    if minimal == "cardinality":
        expected = {bad for bad in expected if len(bad) == min(map(len, expected))}
    result = engine.diagnose(observations, options)
    found = {diagnosis.bad for diagnosis in result.diagnoses}
    small = {bad for bad in expected if len(bad) <= max_size}
    assert found <= small
    assert len(found) == len(result.diagnoses) == min(limit, len(small))
    assert sorted(map(len, found)) == sorted(map(len, small))[: len(found)]
    if result.complete:
        assert found == expected
        assert result.stopped_by is None
    elif result.stopped_by == "size":
        assert found == small != expected
    else:
        assert result.stopped_by == "limit"
        assert len(found) == limit
        assert limit == 1 or len(small) > limit


@engines
@settings(deadline=None)
@given(systems(), st.data())
def test_what_is_supposed_holds(name: str, system: System, data: st.DataObject) -> None:
    cnf, observations = system
    roles = data.draw(st.lists(st.sampled_from(["", "", "healthy", "abnormal"]), min_size=5, max_size=5))
    of = dict(zip(cnf.components, roles, strict=False))
    healthy = frozenset(c for c, role in of.items() if role == "healthy")
    abnormal = frozenset(c for c, role in of.items() if role == "abnormal")
    fixed = [(cnf.health[c],) for c in healthy] + [(-cnf.health[c],) for c in abnormal]
    options = Options(limit=None, timeout_s=None, healthy=healthy, abnormal=abnormal)
    what_if = model(len(cnf.components), [*cnf.clauses, *fixed])
    expected = brute_force(what_if, observations)
    engine = make_engine(name, cnf)
    if expected is None and brute_force(cnf, observations) is None:
        with pytest.raises(ContradictoryModel):
            engine.diagnose(observations, options)
        return
    result = engine.diagnose(observations, options)
    assert {diagnosis.bad for diagnosis in result.diagnoses} == (expected or set())
    assert result.complete


@engines
@settings(deadline=None)
@given(systems())
def test_conflicts_are_minimal_and_every_diagnosis_resolves_them(name: str, system: System) -> None:
    cnf, observations = system
    if brute_force(cnf, observations) is None:
        return
    result = make_engine(name, cnf).diagnose(observations, ALL)
    for conflict in result.conflicts:
        assert conflict.text
        assert _contradictory(cnf, conflict.components, conflict.observations)
        for component in conflict.components:
            rest = tuple(c for c in conflict.components if c != component)
            assert not _contradictory(cnf, rest, tuple(observations))
        for literal in conflict.observations:
            fewer = tuple(other for other in conflict.observations if other != literal)
            assert not _contradictory(cnf, conflict.components, fewer)
        texts = {rule.text for rule in cnf.rules}
        assert set(conflict.rules) <= texts
        used = [
            c for c, o in zip(cnf.clauses, cnf.origins, strict=True) if cnf.rules[o].text in conflict.rules
        ]
        only = model(len(cnf.components), used)
        assert _contradictory(only, conflict.components, conflict.observations)
    for diagnosis in result.diagnoses:
        assert diagnosis.resolves == tuple(range(len(result.conflicts)))
        for component in diagnosis.bad:
            assert any(set(c.components) & set(diagnosis.bad) == {component} for c in result.conflicts)


def _contradictory(cnf: HealthCnf, components: tuple[str, ...], observations: tuple[Literal, ...]) -> bool:
    healthy = [(cnf.health[c],) for c in components]
    rigid = model(len(cnf.components), [*cnf.clauses, *healthy])
    numbers = [(number,) for number in map(cnf.literal, observations) if number is not None]
    return not satisfiable([*rigid.clauses, *numbers], cnf.variables)


@pytest.mark.parametrize(
    ("name", "faults", "seed"), [("c17", 2, 1), ("c432", 2, 3), ("c432", 3, 12), ("c499", 1, 2)]
)
def test_minimum_cardinality_agrees_on_iscas85(name: str, faults: int, seed: int) -> None:
    observations = circuit(name).observe(faults, seed)
    options = Options(minimal="cardinality", limit=None, timeout_s=None, conflicts=False)
    answers = [
        {d.bad for d in make_engine(engine, circuit(name).cnf).diagnose(observations, options).diagnoses}
        for engine in ("sat", "asp", "maxsat")
    ]
    assert answers[0]
    assert answers[0] == answers[1] == answers[2]


@pytest.mark.parametrize("name", ["sat", "maxsat", "cda_star"])
def test_what_is_supposed_abnormal_may_be_too_many_by_itself(name: str) -> None:
    cnf = model(2, [(-1, 3)], priors={"c1": 0.1, "c2": 0.2})
    options = Options(order="probability", max_size=0, abnormal=frozenset({"c2"}))
    result = make_engine(name, cnf).diagnose([holds("ok", "a1")], options)
    assert (result.diagnoses, result.stopped_by) == ((), "size")


@engines
def test_a_timeout_of_zero_is_an_incomplete_answer(name: str) -> None:
    cnf = circuit("c17").cnf
    result = make_engine(name, cnf).diagnose(circuit("c17").observe(1, 1), Options(timeout_s=0.0))
    assert result.diagnoses == ()
    assert not result.complete
    assert result.stopped_by == "time"


@engines
def test_literals_that_no_rule_mentions_are_named(name: str) -> None:
    stray = Literal(Atom("ok", ("elsewhere",)))
    result = make_engine(name, circuit("c17").cnf).diagnose([stray])
    assert result.unused == (stray,)
    assert result.healthy


@engines
@pytest.mark.parametrize("minimal", ["cardinality", "subset"])
@pytest.mark.parametrize("max_size", [None, 1])
def test_a_model_without_components_or_sense_has_a_clear_answer(
    name: str, minimal: Minimal, max_size: int | None
) -> None:
    options = Options(minimal=minimal, max_size=max_size, timeout_s=None)
    nobody = make_engine(name, model(0, [(1, 2)], atoms=2)).diagnose([Literal(Atom("ok", ("a1",)))], options)
    assert [diagnosis.bad for diagnosis in nobody.diagnoses] == [()]
    assert nobody.complete
    senseless = make_engine(name, model(3, [(4,), (-4,), (-1, -2)], atoms=1))
    for _ in range(2):
        with pytest.raises(ContradictoryModel):
            senseless.diagnose([], options)


@engines
def test_opposite_observations_are_told(name: str) -> None:
    literal = Literal(Atom("v", ("22",)))
    with pytest.raises(ContradictoryModel, match=r"v\(22\) and not v\(22\)"):
        make_engine(name, circuit("c17").cnf).diagnose([literal, -literal])


@engines
@pytest.mark.parametrize(
    "options",
    [
        Options(limit=0),
        Options(max_size=-1),
        Options(timeout_s=-1.0),
        Options(timeout_s=float("nan")),
        Options(factored=True),
        Options(order="probability"),
        Options(healthy=frozenset({"10"}), abnormal=frozenset({"10"})),
    ],
)
def test_options_that_mean_nothing_are_refused_each_time(name: str, options: Options) -> None:
    engine = make_engine(name, circuit("c17").cnf)
    for _ in range(2):
        with pytest.raises(OptionRefused):
            engine.diagnose([], options)
        assert engine.diagnose([]).healthy


@engines
def test_an_unknown_component_is_named(name: str) -> None:
    with pytest.raises(UnknownComponent, match="nosuch"):
        make_engine(name, circuit("c17").cnf).diagnose([], Options(healthy=frozenset({"nosuch"})))


@pytest.mark.parametrize("name", ["sat", "maxsat", "hs_dag", "cda_star"])
@pytest.mark.parametrize("solver", ["kissat404", "ks", "cadical153", "cd19", "lingeling", "nosuch"])
def test_solvers_that_cannot_be_used_are_refused(name: str, solver: str) -> None:
    with pytest.raises(OptionRefused, match=solver):
        make_engine(name, circuit("c17").cnf, solver=solver)


@pytest.mark.parametrize(
    "solver", ["minisat22", "m22", "minicard", "glucose4", "mgh", "maplesat", "gluecard4"]
)
def test_other_solvers_give_the_same(solver: str) -> None:
    observations = circuit("c432").observe(4, 12)
    cnf = circuit("c432").cnf
    options = Options(minimal="cardinality", limit=None, timeout_s=None, conflicts=False)
    one, other = make_engine("sat", cnf, solver=solver), make_engine("sat", cnf)
    assert one.diagnose(observations, options).count == other.diagnose(observations, options).count
    small = Options(
        max_size=2, limit=None, timeout_s=None, conflicts=False, healthy=frozenset({cnf.components[0]})
    )
    assert one.diagnose(observations, small).diagnoses == other.diagnose(observations, small).diagnoses


def test_an_unknown_engine_is_refused_with_the_names_that_exist() -> None:
    assert ENGINES.names()[:5] == ("sat", "asp", "maxsat", "hs_dag", "cda_star")
    with pytest.raises(OptionRefused, match="sat, asp, maxsat, hs_dag, cda_star"):
        make_engine("nosuch", circuit("c17").cnf)


@pytest.mark.parametrize("name", ["sat", "maxsat", "cda_star"])
@settings(deadline=None)
@given(systems(), st.lists(st.sampled_from([0.001, 0.02, 0.1, 0.3, 0.45]), min_size=5, max_size=5))
def test_order_of_probability_is_that_of_the_priors(name: str, system: System, priors: list[float]) -> None:
    drawn, observations = system
    expected = brute_force(drawn, observations)
    if expected is None:
        return
    cnf = replace(drawn, priors=dict(zip(drawn.components, priors, strict=False)))
    everything = Options(limit=None, timeout_s=None, order="probability")
    result = make_engine(name, cnf).diagnose(observations, everything)
    assert {diagnosis.bad for diagnosis in result.diagnoses} == expected
    odds = [prod(cnf.priors[c] / (1 - cnf.priors[c]) for c in d.bad) for d in result.diagnoses]
    assert all(later <= earlier * 1.001 for earlier, later in pairwise(odds))
    first = make_engine(name, cnf).diagnose(observations, replace(everything, limit=1)).diagnoses[0]
    assert prod(cnf.priors[c] / (1 - cnf.priors[c]) for c in first.bad) >= max(odds) * 0.999


@settings(max_examples=40, deadline=None)
@given(st.integers(3, 40), st.integers(0, 1000), st.lists(st.floats(0.001, 0.45), min_size=40, max_size=40))
def test_engines_that_weigh_agree_on_the_most_probable_faults_of_a_robot(
    components: int, seed: int, priors: list[float]
) -> None:
    robot = make_robot(components, seed)
    seen = observe(robot, 1 + seed % 4, random.Random(seed))
    cnf = replace(robot.cnf, priors=dict(zip(robot.cnf.components, priors, strict=False)))
    options = Options(limit=1 + seed % 3, timeout_s=None, order="probability", conflicts=False)
    told = []
    for name in ("sat", "cda_star", "maxsat"):
        result = make_engine(name, cnf).diagnose(seen, options)
        told.append([sum(log(cnf.priors[c] / (1 - cnf.priors[c])) for c in d.bad) for d in result.diagnoses])
    assert told[0] == pytest.approx(told[1])
    assert told[0] == pytest.approx(told[2], abs=0.01)  # its weights are whole numbers
