"""Cones, flips and factors: exact, whatever is observed."""

from __future__ import annotations

from dataclasses import replace
from itertools import product

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from tests.diagnosis.netlists import (
    Circuit,
    fresh_solver_diagnoses,
    observed_circuits,
)
from tests.examples import examples

from robomend.diagnosis.circuits import toplevel
from robomend.diagnosis.circuits.flips import Flips
from robomend.diagnosis.circuits.netlist import recover
from robomend.diagnosis.engines import make_engine
from robomend.diagnosis.result import Options
from robomend.model.cnf import HealthCnf
from robomend.model.loading import load_text
from robomend_client.literals import Atom, Literal

SUBSET = Options(limit=None, timeout_s=None)
MINIMUM = Options(minimal="cardinality", limit=None, timeout_s=None)
FACTORED = Options(minimal="cardinality", limit=None, timeout_s=None, factored=True)


@examples(150)
@given(observed_circuits())
def test_engines_for_circuits_agree_with_the_definition(system: tuple[Circuit, frozenset[Literal]]) -> None:
    agrees_with_the_definition(system[0].cnf, system[1])


@pytest.mark.parametrize("width", [1, 2, 5, 6, 8, 9, 12, 21])
@pytest.mark.parametrize("kind", ["XOR", "XNOR"])
def test_parities_of_any_width_are_gates(kind: str, width: int) -> None:
    names = [f"x{i}" for i in range(width)]
    cnf = bench([*names, "e"], [f"odd = {kind}({', '.join(names)})", "y = AND(odd, e)"])
    netlist = recover(cnf)
    assert netlist is not None
    gate = netlist.gates[0]
    assert [cnf.word(net) for net in gate.inputs] == [f"v({name})" for name in names]
    for ones in range(width + 1):
        values = [int(i < ones) for i in range(width)]
        assert eval(gate.expression.format(*values), {"M": 1}) == (ones % 2 == (kind == "XOR"))


@pytest.mark.parametrize("spoilt", ["a clause less", "another sign", "an auxiliary variable of two gates"])
def test_what_only_looks_like_a_parity_is_no_netlist(spoilt: str) -> None:
    names = [f"x{i}" for i in range(8)]
    cnf = bench([*names, "e"], [f"odd = XOR({', '.join(names)})", "y = AND(odd, e)"])
    assert recover(cnf) is not None
    after = len(cnf.components) + len(cnf.atoms)
    index = next(i for i, clause in enumerate(cnf.clauses) if max(map(abs, clause)) > after)
    clause = list(cnf.clauses[index])
    others = [*cnf.clauses[:index], *cnf.clauses[index + 1 :]]
    if spoilt == "another sign":
        clause[1] = -clause[1]
    changed = [*others, tuple(clause)]
    if spoilt == "a clause less":
        changed = [*others, others[0]]
    if spoilt == "an auxiliary variable of two gates":
        (other,) = {1, 2} - {-clause[0]}
        changed = [*cnf.clauses, (-other, -clause[1], -(after + 1))]
    origins = [cnf.origins[0]] * len(changed)
    assert recover(replace(cnf, clauses=tuple(changed), origins=tuple(origins))) is None


@st.composite
def wide_parities(draw: st.DrawFn) -> tuple[HealthCnf, frozenset[Literal]]:
    """Draw a circuit with two parities of 6 to 8 inputs in sequence, and what is seen of it."""
    inputs = [f"x{i}" for i in range(7)]
    kinds = draw(st.lists(st.sampled_from(["XOR", "XNOR"]), min_size=2, max_size=2))
    nets = [*inputs, "a", "n"]
    lines = [f"a = {draw(st.sampled_from(['AND', 'NOR']))}(x0, x1)", "n = NOT(x2)"]
    for name, kind in zip(("p", "q"), kinds, strict=True):
        read = draw(st.lists(st.sampled_from(nets), min_size=6, max_size=8, unique=True))
        lines.append(f"{name} = {kind}({', '.join(read)})")
        nets.append(name)
    lines.append("y = OR(p, q, a)")
    seen = [*draw(st.sampled_from([inputs, inputs[:5], nets])), "y", *draw(st.sets(st.sampled_from(["q"])))]
    values = draw(st.lists(st.booleans(), min_size=len(seen), max_size=len(seen)))
    observed = {Atom("v", (net,)): value for net, value in zip(seen, values, strict=True)}
    return bench(inputs, lines), frozenset(Literal(atom, value) for atom, value in observed.items())


@settings(max_examples=60, deadline=None)
@given(wide_parities(), st.booleans())
def test_circuits_with_wide_parities_agree_with_the_definition(
    system: tuple[HealthCnf, frozenset[Literal]], simulated: bool
) -> None:
    cnf, observations = system
    assert recover(cnf) is not None
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(toplevel, "SIMULATED_GATES", toplevel.SIMULATED_GATES if simulated else 0)
        agrees_with_the_definition(cnf, observations)


@given(observed_circuits(), st.data())
def test_a_pass_gives_what_gate_after_gate_gives(
    system: tuple[Circuit, frozenset[Literal]], data: st.DataObject
) -> None:
    netlist = recover(system[0].cnf)
    assert netlist is not None
    gates = netlist.gates
    every = range(len(gates))
    flippable = sorted(data.draw(st.sets(st.sampled_from(every))))
    checks = data.draw(st.lists(st.sampled_from([gate.output for gate in gates]), unique=True))
    flips = Flips(netlist, flippable, every, checks)
    inputs = data.draw(st.lists(st.booleans(), min_size=len(flips.inputs), max_size=len(flips.inputs)))

    def seen(flipped: int | None) -> list[bool]:
        values = {net: int(value) for net, value in zip(flips.inputs, inputs, strict=True)}
        for index, gate in enumerate(gates):
            value = eval(gate.expression.format(*(values[net] for net in gate.inputs)), {"M": 1})
            values[gate.output] = value ^ (index == flipped)
        return [bool(values[net]) for net in checks]

    expected = seen(data.draw(st.sampled_from([None, *every])))
    healthy, singles = flips.singles(inputs, expected)
    assert healthy == flips.agrees(inputs, expected) == (seen(None) == expected)
    alone = [gate for gate in flippable if seen(gate) == expected]
    assert [flippable[position] for position in singles] == alone
    assert flips.explaining_alone(inputs, expected, flippable[1:]) == [g for g in alone if g in flippable[1:]]


def bench(inputs: list[str], gates: list[str]) -> HealthCnf:
    ports = [f"INPUT({name})" for name in inputs]
    return load_text("\n".join([*ports, *gates, "OUTPUT(y)"]), name="made up", format="bench").cnf


def agrees_with_the_definition(cnf: HealthCnf, observations: frozenset[Literal]) -> None:
    expected = fresh_solver_diagnoses(cnf, observations)
    engine = make_engine("sat", cnf)
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
