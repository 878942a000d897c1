"""ISCAS-85 circuits as models, and observations of them with seeded faults."""

from __future__ import annotations

import random
import re
from functools import cache
from itertools import combinations, product
from pathlib import Path

from hypothesis import strategies as st
from pysat.solvers import Solver

from robomend.model.cnf import Clause, HealthCnf, Rule
from robomend_client.literals import Atom, Literal

DATA = Path(__file__).parents[2] / "clients" / "robomend_bench" / "data" / "iscas85"
LINE = re.compile(r"(\S+)\s*=\s*(\w+)\((.*)\)")


class Circuit:
    """A netlist in topological order, with its model."""

    def __init__(self, name: str) -> None:
        self.inputs: list[str] = []
        self.outputs: list[str] = []
        gates: dict[str, tuple[str, list[str]]] = {}
        for line in (DATA / f"{name}.bench").read_text().splitlines():
            text = line.split("#")[0].strip()
            if match := LINE.match(text):
                gates[match[1]] = (match[2].upper(), [a.strip() for a in match[3].split(",")])
            elif text.startswith("INPUT"):
                self.inputs.append(text[6:-1].strip())
            elif text.startswith("OUTPUT"):
                self.outputs.append(text[7:-1].strip())
        self.gates: dict[str, tuple[str, list[str]]] = {}
        done = set(self.inputs)
        while gates:
            for net in [net for net, (_, ins) in gates.items() if done.issuperset(ins)]:
                self.gates[net] = gates.pop(net)
                done.add(net)
        self.cnf = self._model(name)

    def _model(self, name: str) -> HealthCnf:
        components = tuple(self.gates)
        nets = (*self.inputs, *self.gates)
        number = {net: len(components) + i for i, net in enumerate(nets, 1)}
        clauses: list[Clause] = []
        origins: list[int] = []
        for i, (net, (kind, ins)) in enumerate(self.gates.items(), 1):
            for signs in gate_clauses(kind, len(ins)):
                variables = [number[x] for x in [*ins, net]]
                clauses.append((-i, *(s * variables[j] for j, s in signs)))
                origins.append(i - 1)
        return HealthCnf(
            name=name,
            components=components,
            atoms=tuple(Atom("v", (net,)) for net in nets),
            clauses=tuple(clauses),
            origins=tuple(origins),
            rules=tuple(Rule(f"{n} = {k}({', '.join(i)})", f"gate {n}") for n, (k, i) in self.gates.items()),
            variables=len(components) + len(nets),
            circuit=True,
        )

    def numbers(self, nets: list[str]) -> list[int]:
        """Return the variables of nets."""
        return [self.cnf.atom_variable[Atom("v", (net,))] for net in nets]

    def simulate(self, inputs: dict[str, bool], flipped: frozenset[str] = frozenset()) -> dict[str, bool]:
        """Return the value of each net when the flipped gates give the opposite of what they should."""
        values = dict(inputs)
        for net, (kind, ins) in self.gates.items():
            values[net] = evaluate(kind, [values[x] for x in ins]) != (net in flipped)
        return values

    def observe(self, faults: int, seed: int) -> frozenset[Literal]:
        """Return inputs and outputs of a run with some gates flipped."""
        chance = random.Random(seed)
        inputs = {net: chance.random() < 0.5 for net in self.inputs}
        values = self.simulate(inputs, frozenset(chance.sample(list(self.gates), faults)))
        return frozenset(Literal(Atom("v", (n,)), values[n]) for n in (*self.inputs, *self.outputs))


def evaluate(kind: str, values: list[bool]) -> bool:
    """Return the output of a healthy gate."""
    if kind in ("XOR", "XNOR"):
        return (sum(values) % 2 == 1) == (kind == "XOR")
    if kind in ("AND", "NAND"):
        return all(values) == (kind == "AND")
    if kind in ("OR", "NOR"):
        return any(values) == (kind == "OR")
    return values[0] == kind.startswith("BUF")


def gate_clauses(kind: str, width: int) -> list[list[tuple[int, int]]]:
    """Return clauses of (position, sign); position `width` is the output."""
    if kind in ("XOR", "XNOR"):
        return [
            [(j, -1 if v else 1) for j, v in enumerate(row)]
            + [(width, 1 if evaluate(kind, list(row)) else -1)]
            for row in product((False, True), repeat=width)
        ]
    controlling = -1 if kind in ("AND", "NAND") else 1  # the sign of the inputs in the long clause
    if kind in ("NOT", "BUF", "BUFF"):
        controlling = -1
    inverted = kind in ("NAND", "NOR", "NOT")
    out = 1 if (controlling == -1) != inverted else -1
    long = [(j, controlling) for j in range(width)] + [(width, out)]
    return [long, *([(j, -controlling), (width, -out)] for j in range(width))]


@cache
def circuit(name: str) -> Circuit:
    """Return one of the eleven circuits, read once."""
    return Circuit(name)


def netlist_model(inputs: list[str], gates: dict[str, tuple[str, list[str]]]) -> Circuit:
    """Return a circuit made up for a test; the gates are in topological order."""
    made = Circuit.__new__(Circuit)
    made.inputs = inputs
    made.gates = gates
    read = {net for _, ins in gates.values() for net in ins}
    made.outputs = [net for net in gates if net not in read]
    made.cnf = made._model("made up")
    return made


@st.composite
def observed_circuits(draw: st.DrawFn) -> tuple[Circuit, frozenset[Literal]]:
    """Draw a circuit of up to 8 gates that share nets, and observations, mostly of inputs and outputs."""
    inputs = [f"x{i}" for i in range(draw(st.integers(1, 3)))]
    nets = list(inputs)
    gates: dict[str, tuple[str, list[str]]] = {}
    for index in range(draw(st.integers(1, 8))):
        kind = draw(st.sampled_from(["AND", "NAND", "OR", "NOR", "XOR", "XNOR", "NOT", "BUFF"]))
        width = 1 if kind in ("NOT", "BUFF") else min(len(nets), draw(st.integers(1, 3)))
        kind = "BUFF" if width == 1 and kind not in ("NOT", "BUFF") else kind
        ins = draw(st.lists(st.sampled_from(nets), min_size=width, max_size=width, unique=True))
        gates[f"g{index}"] = (kind, ins)
        nets.append(f"g{index}")
    circuit = netlist_model(inputs, gates)
    inner = draw(st.sets(st.sampled_from(nets), max_size=2))
    hidden = draw(st.sets(st.sampled_from(nets), max_size=2)) if draw(st.booleans()) else set()
    observed = [
        net for net in nets if (net in inputs or net in circuit.outputs or net in inner) and net not in hidden
    ]
    values = draw(st.lists(st.booleans(), min_size=len(observed), max_size=len(observed)))
    return circuit, frozenset(Literal(Atom("v", (n,)), v) for n, v in zip(observed, values, strict=True))


def fresh_solver_diagnoses(cnf: HealthCnf, observations: frozenset[Literal]) -> set[tuple[str, ...]]:
    """Return the subset-minimal diagnoses, asking a fresh solver about each set of components."""
    n = len(cnf.components)
    seen = [number for number in map(cnf.literal, observations) if number is not None]
    minimal: list[frozenset[int]] = []
    for size in range(n + 1):
        for bad in map(frozenset, combinations(range(1, n + 1), size)):
            if any(smaller <= bad for smaller in minimal):
                continue
            with Solver("minisat22", bootstrap_with=cnf.clauses) as solver:
                if solver.solve([*seen, *(i for i in range(1, n + 1) if i not in bad)]):
                    minimal.append(bad)
    return {tuple(cnf.components[i - 1] for i in sorted(bad)) for bad in minimal}
