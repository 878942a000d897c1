"""Circuits: every gate against its truth table, every broken file with its line."""

from __future__ import annotations

from collections.abc import Callable
from itertools import product

import pytest
from hypothesis import given
from hypothesis import strategies as st
from pysat.solvers import Solver

from robomend.errors import ModelError
from robomend.model.bench import circuit
from robomend_client.literals import Atom

C17 = """\
# c17
INPUT(1)
INPUT(2)
INPUT(3)
INPUT(6)
INPUT(7)
OUTPUT(22)
OUTPUT(23)

10 = NAND(1, 3)
11 = NAND(3, 6)
16 = NAND(2, 11)
19 = NAND(11, 7)
22 = NAND(10, 16)
23 = NAND(16, 19)
"""

FUNCTIONS: dict[str, Callable[[tuple[bool, ...]], bool]] = {
    "AND": all,
    "NAND": lambda ins: not all(ins),
    "OR": any,
    "NOR": lambda ins: not any(ins),
    "XOR": lambda ins: sum(ins) % 2 == 1,
    "XNOR": lambda ins: sum(ins) % 2 == 0,
    "NOT": lambda ins: not ins[0],
    "BUFF": lambda ins: ins[0],
}


def test_reads_c17() -> None:
    system = circuit(C17, name="c17")
    cnf = system.cnf
    assert cnf.components == ("10", "11", "16", "19", "22", "23")
    assert len(cnf.clauses) == len(cnf.origins) == 18
    for clause, gate in zip(cnf.clauses, cnf.origins, strict=True):  # each is of a gate, if that is healthy
        assert -cnf.health[cnf.components[gate]] in clause
    assert cnf.inputs == tuple(Atom("v", (net,)) for net in "12367")
    assert cnf.outputs == (Atom("v", ("22",)), Atom("v", ("23",)))
    assert cnf.circuit
    assert cnf.weak
    assert cnf.rules[0].text == "not ab(10) -> (v(10) <-> not (v(1) and v(3)))"
    assert (cnf.rules[0].source, cnf.rules[0].line) == ("gate 10", 10)
    assert system.warnings == ()


@given(st.sampled_from([*FUNCTIONS]), st.integers(1, 8), st.data())
def test_a_healthy_gate_computes_its_function_and_an_abnormal_one_anything(
    kind: str, arity: int, data: st.DataObject
) -> None:
    arity = 1 if kind in ("NOT", "BUFF") else arity
    nets = data.draw(st.lists(st.sampled_from("abcdefgh"), min_size=arity, max_size=arity))
    names = sorted(set(nets))
    text = "".join(f"INPUT({net})\n" for net in names) + f"OUTPUT(z)\nz = {kind}({', '.join(nets)})\n"
    cnf = circuit(text).cnf
    wire = {atom.args[0]: variable for atom, variable in cnf.atom_variable.items()}
    with Solver("glucose4", bootstrap_with=cnf.clauses) as solver:
        for values in product((False, True), repeat=len(names)):
            value = dict(zip(names, values, strict=True))
            given_values = [wire[net] if value[net] else -wire[net] for net in names]
            right = FUNCTIONS[kind](tuple(value[net] for net in nets))
            for out in (False, True):
                observed = [*given_values, wire["z"] if out else -wire["z"]]
                assert solver.solve(assumptions=[1, *observed]) == (out == right)
                assert solver.solve(assumptions=[-1, *observed])


def test_flip_flops_are_cut() -> None:
    cnf = circuit("INPUT(a)\nOUTPUT(z)\nq = DFF(z)\nz = XOR(a, q)\n").cnf
    assert cnf.components == ("z",)
    assert cnf.inputs == (Atom("v", ("a",)), Atom("v", ("q",)))
    assert cnf.outputs == (Atom("v", ("z",)),)


@pytest.mark.parametrize(
    ("text", "line", "message"),
    [
        ("INPUT(a)\nOUTPUT(a)", None, "no gate"),
        ("", None, "no gate"),
        ("INPUT(a)\nz = NOT(b)", 2, "nothing drives net b"),
        ("INPUT(a)\nOUTPUT(y)\nz = NOT(a)", 2, "nothing drives output y"),
        ("INPUT(a)\nz = NOT(a)\nz = BUFF(a)", 3, "driven twice"),
        ("INPUT(a)\na = NOT(a)", 2, "driven twice"),
        ("INPUT(a)\nINPUT(a)\nz = NOT(a)", 2, "driven twice"),
        ("INPUT(a)\nz = AND(a, y)\ny = NOT(x)\nx = BUFF(z)", 2, "gates feed themselves: z <- y <- x <- z"),
        ("INPUT(a)\nz = NOT(z)", 2, "feed themselves"),
        ("INPUT(a)\nz = MUX(a, a)", 2, "no gate is named MUX"),
        ("INPUT(a)\nz = NOT(a, a)", 2, "takes one net"),
        ("INPUT(a)\nz = AND()", 2, "no name"),
        ("INPUT(a)\nz = AND(a,,a)", 2, "no name"),
        ("INPUT(a)\nhello", 2, "no line of a circuit"),
        ("INPUT(a", 1, "no line of a circuit"),
    ],
)
def test_broken_circuits_are_refused_with_their_line(text: str, line: int | None, message: str) -> None:
    with pytest.raises(ModelError, match=message) as caught:
        circuit(text, file="x.bench")
    assert (caught.value.file, caught.value.line) == ("x.bench", line)


def test_a_circuit_deeper_than_the_stack_compiles() -> None:
    chain = "".join(f"n{i + 1} = NOT(n{i})\n" for i in range(20_000))
    assert len(circuit("INPUT(n0)\nOUTPUT(n20000)\n" + chain).cnf.components) == 20_000


@given(st.text(alphabet="INPUTO()=,# \nabNDXR", max_size=80))
def test_garbage_raises_model_errors_only(text: str) -> None:
    for whole in (text, "INPUT(a)\nOUTPUT(z)\nz = NOT(a)\n" + text):
        try:
            circuit(whole)
        except ModelError as error:
            str(error)
