"""Generated robots, and seeded faults in circuits."""

from __future__ import annotations

import random
from itertools import product

import pytest

from robomend.diagnosis.engines import make_engine
from robomend.diagnosis.result import Options
from robomend.errors import ModelError
from robomend.model.cnf import HealthCnf
from robomend.model.loading import load_text
from robomend_bench.generator import FUNCTIONS, Circuit, make_robot, observe, observe_faulty, read_circuit
from robomend_bench.suite import DATA
from robomend_client.literals import Atom, Literal


@pytest.mark.parametrize("components", [3, 20, 101])
def test_a_robot_has_the_size_that_was_asked_for(components: int) -> None:
    assert len(make_robot(components, 1).cnf.components) == components


def test_the_same_seed_gives_the_same_robot_and_another_seed_another() -> None:
    assert make_robot(20, 1).cnf == make_robot(20, 1).cnf
    assert make_robot(20, 1).cnf != make_robot(20, 2).cnf


def test_a_healthy_robot_looks_healthy_and_a_broken_one_mostly_does_not() -> None:
    robot = make_robot(40, 1)
    engine = make_engine("sat", robot.cnf)
    assert engine.consistent(observe(robot, 0, random.Random(1)))
    broken = [observe(robot, 2, random.Random(seed)) for seed in range(20)]
    assert sum(not engine.consistent(seen) for seen in broken) >= 15
    engine.close()


def test_what_was_broken_explains_what_is_seen() -> None:
    robot = make_robot(12, 3)
    engine = make_engine("sat", robot.cnf)
    for seed in range(20):
        result = engine.diagnose(observe(robot, 2, random.Random(seed)), Options(limit=None))
        assert result.complete
        assert min(len(diagnosis.bad) for diagnosis in result.diagnoses) <= 2
    engine.close()


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
