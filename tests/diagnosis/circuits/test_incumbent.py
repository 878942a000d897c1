"""An incumbent explains what is seen, and a search that knows one still finds the minimum."""

from __future__ import annotations

import pytest
from hypothesis import assume, given
from tests.diagnosis.netlists import Circuit, circuit, fresh_solver_diagnoses, observed_circuits

from robomend.diagnosis.circuits.flips import Flips
from robomend.diagnosis.circuits.netlist import recover
from robomend.diagnosis.circuits.toplevel import find_incumbent
from robomend.diagnosis.engines import make_engine
from robomend.diagnosis.result import Engine, Options
from robomend_client.literals import Literal

FIRST = Options(minimal="cardinality", limit=1, timeout_s=None, conflicts=False)
MANY_FAULTS = [("c17", 3, 0), ("c432", 5, 5), ("c499", 9, 2), ("c880", 12, 3), ("c1355", 8, 4)]


def warm(made: Circuit) -> Engine:
    """Return an engine that knows the circuit's structure: its first question is behind it."""
    engine = make_engine("sat", made.cnf)
    engine.diagnose([], FIRST)
    return engine


def incumbent_of(made: Circuit, observations: frozenset[Literal]) -> set[str] | None:
    """Return the names of the gates of the incumbent."""
    netlist = recover(made.cnf)
    assert netlist is not None
    seen = {literal.atom.args[0]: literal.positive for literal in observations}
    nets = {number: name for name, number in zip(seen, made.numbers(list(seen)), strict=True)}
    driven = {gate.output for gate in netlist.gates}
    checks = sorted(net for net in nets if net in driven)
    every = range(len(netlist.gates))
    flips = Flips(netlist, every, every, checks)
    inputs = [seen[nets[net]] for net in flips.inputs]
    expected = [seen[nets[net]] for net in checks]
    found = find_incumbent(flips, inputs, expected, flips.one_by_one(inputs, expected))
    if found is None:
        return None
    return {made.cnf.components[netlist.gates[position].component - 1] for position in found}


@pytest.mark.parametrize(("name", "faults", "seed"), MANY_FAULTS)
def test_an_incumbent_explains_what_is_seen_and_each_of_its_gates_is_needed(
    name: str, faults: int, seed: int
) -> None:
    made = circuit(name)
    observations = made.observe(faults, seed)
    gates = incumbent_of(made, observations)
    assert gates
    seen = {literal.atom.args[0]: literal.positive for literal in observations}
    inputs = {net: seen[net] for net in made.inputs}

    def explains(flipped: set[str]) -> bool:
        values = made.simulate(inputs, frozenset(flipped))
        return all(values[net] == value for net, value in seen.items())

    assert explains(gates)
    assert not any(explains(gates - {gate}) for gate in gates)


@given(observed_circuits())
def test_the_first_diagnosis_is_one_of_the_smallest_of_the_definition(
    system: tuple[Circuit, frozenset[Literal]],
) -> None:
    made, observations = system
    expected = fresh_solver_diagnoses(made.cnf, observations)
    assume(expected)
    least = min(map(len, expected))
    (found,) = warm(made).diagnose(observations, FIRST).diagnoses
    assert len(found.bad) == least
    assert found.bad in expected
