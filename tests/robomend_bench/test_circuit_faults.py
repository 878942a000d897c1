"""Seeded faults in circuits."""

from __future__ import annotations

import random
from itertools import product

import pytest

from robomend.diagnosis.engines import make_engine
from robomend.errors import ModelError
from robomend.model.cnf import HealthCnf
from robomend.model.loading import load_text
from robomend_bench.generator import FUNCTIONS, Circuit, observe_faulty, read_circuit
from robomend_bench.suite import DATA
from robomend_client.literals import Atom, Literal

C17 = (DATA / "iscas85" / "c17.bench").read_text()


def load(text: str) -> tuple[Circuit, HealthCnf]:
    return read_circuit(text), load_text(text, name="circuit", format="bench").cnf


def test_a_simulated_run_is_what_a_healthy_circuit_shows() -> None:
    circuit, cnf = load(C17)
    engine = make_engine("sat", cnf)
    for values in product((False, True), repeat=len(circuit.inputs)):
        seen = circuit.simulate(dict(zip(circuit.inputs, values, strict=True)), {})
        assert engine.consistent([Literal(Atom("v", (net,)), value) for net, value in seen.items()])
        flipped = circuit.simulate(dict(zip(circuit.inputs, values, strict=True)), {"22": "flipped"})
        assert flipped["22"] != seen["22"]
    engine.close()


def test_every_kept_run_has_something_to_diagnose() -> None:
    circuit, cnf = load(C17)
    engine = make_engine("sat", cnf)
    for seed in range(20):
        observed = observe_faulty(circuit, 1 + seed % 3, random.Random(seed))
        assert {literal.atom.args[0] for literal in observed} == {*circuit.inputs, *circuit.outputs}
        assert not engine.consistent(observed)
    engine.close()


def test_faults_that_can_never_be_seen_are_an_error() -> None:
    circuit, _ = load("INPUT(a)\nOUTPUT(b)\nb = NOT(a)\nc = NOT(a)\nd = AND(c, c)\n")
    assert observe_faulty(circuit, 3, random.Random(1))
    hidden = Circuit(("a",), ("a",), {"b": ("NOT", ("a",))})
    with pytest.raises(ModelError, match="never seen"):
        observe_faulty(hidden, 1, random.Random(1))


def test_the_functions_are_those_of_the_form() -> None:
    assert [FUNCTIONS[kind]([True, False]) for kind in ("AND", "NAND", "OR", "NOR", "XOR", "XNOR")] == [
        False,
        True,
        True,
        False,
        True,
        False,
    ]
    with pytest.raises(ModelError, match="only combinational"):
        read_circuit("INPUT(a)\nb = DFF(a)\n")
