"""Cones, flips and factors: exact, whatever is observed."""

from __future__ import annotations

from itertools import product

import pytest
from hypothesis import given, settings
from tests.diagnosis.circuits import (
    Circuit,
    circuit,
    fresh_solver_diagnoses,
    netlist_model,
    observed_circuits,
)

from robomend.diagnosis import toplevel
from robomend.diagnosis.cones import find_cones
from robomend.diagnosis.engines import make_engine
from robomend.diagnosis.netlist import recover
from robomend.diagnosis.result import Options
from robomend_client.literals import Literal

SUBSET = Options(limit=None, timeout_s=None)
MINIMUM = Options(minimal="cardinality", limit=None, timeout_s=None)
FACTORED = Options(minimal="cardinality", limit=None, timeout_s=None, factored=True)


def test_a_chain_is_one_cone() -> None:
    chain = netlist_model(["x"], {"a": ("NOT", ["x"]), "b": ("NOT", ["a"]), "c": ("NOT", ["b"])})
    netlist = recover(chain.cnf)
    assert netlist is not None
    cones = find_cones(netlist, [netlist.gates[2].output])
    assert cones.top == (2,)
    assert cones.members == {2: (0, 1, 2)}


def test_an_observed_inner_net_ends_a_cone() -> None:
    chain = netlist_model(["x"], {"a": ("NOT", ["x"]), "b": ("NOT", ["a"]), "c": ("NOT", ["b"])})
    netlist = recover(chain.cnf)
    assert netlist is not None
    cones = find_cones(netlist, [netlist.gates[1].output, netlist.gates[2].output])
    assert cones.top == (1, 2)


def test_gates_that_no_observed_net_depends_on_are_in_no_cone() -> None:
    fork = netlist_model(["x"], {"a": ("NOT", ["x"]), "b": ("NOT", ["x"])})
    netlist = recover(fork.cnf)
    assert netlist is not None
    assert find_cones(netlist, [netlist.gates[0].output]).seen == (0,)


@pytest.mark.parametrize(("name", "tops"), [("c17", 4), ("c432", 59), ("c1908", 160), ("c7552", 545)])
def test_the_netlist_and_its_cones_are_found_in_the_clauses(name: str, tops: int) -> None:
    netlist = recover(circuit(name).cnf)
    assert netlist is not None
    assert len(netlist.gates) == len(circuit(name).gates)
    assert len(find_cones(netlist, circuit(name).numbers(circuit(name).outputs)).top) == tops


@settings(max_examples=150, deadline=None)
@given(observed_circuits())
def test_engines_for_circuits_agree_with_the_definition(system: tuple[Circuit, frozenset[Literal]]) -> None:
    agrees_with_the_definition(*system)


@settings(max_examples=100, deadline=None)
@given(observed_circuits())
def test_they_agree_without_simulation_too(system: tuple[Circuit, frozenset[Literal]]) -> None:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(toplevel, "SIMULATED_GATES", 0)
        agrees_with_the_definition(*system)


def agrees_with_the_definition(made: Circuit, observations: frozenset[Literal]) -> None:
    expected = fresh_solver_diagnoses(made.cnf, observations)
    engine = make_engine("sat", made.cnf)
    subset = engine.diagnose(observations, SUBSET)
    assert {d.bad for d in subset.diagnoses} == expected
    assert len(subset.diagnoses) == len(expected)
    least = min(map(len, expected))
    smallest = {bad for bad in expected if len(bad) == least}
    flat = engine.diagnose(observations, MINIMUM)
    assert flat.complete
    assert {d.bad for d in flat.diagnoses} == smallest
    assert flat.count == len(flat.diagnoses) == len(smallest)
    factored = engine.diagnose(observations, FACTORED)
    assert factored.count == len(smallest)
    products = [choice for row in factored.factored for choice in product(*(f.alternatives for f in row))]
    assert len(products) == len(smallest)
    assert {frozenset(choice) for choice in products} == set(map(frozenset, smallest))
