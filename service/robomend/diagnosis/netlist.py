"""A circuit, found again in its clauses: which gate drives which net, and by which function.

Engines read nothing of a model but its clauses, so the netlist is recovered from them. A component is a gate
with output o when o occurs in each of its clauses and the clauses fix o for every input: its truth table is
total and single-valued. Everything here is checked, not believed: where a clause belongs to no single gate,
a net has two drivers, or nets feed back, there is no netlist, and the engine falls back on methods that need
none.
"""

from __future__ import annotations

from collections import defaultdict
from dataclasses import dataclass
from itertools import product

from robomend.model.cnf import Clause, HealthCnf

WIDEST_TABLE = 6


@dataclass(frozen=True, slots=True)
class Gate:
    """One component: output = function(inputs), as a Python expression over bit-parallel values."""

    component: int  # its health variable
    output: int
    inputs: tuple[int, ...]
    expression: str  # {0}, {1}, … stand for the inputs, M for all ones
    controlling: int | None  # the input value that alone decides the output, if there is one


@dataclass(frozen=True)
class Netlist:
    """The gates in topological order; nets are variables."""

    gates: tuple[Gate, ...]
    sources: frozenset[int]  # nets that no gate drives

    def driver(self) -> dict[int, int]:
        """Return net -> the index of the gate that drives it."""
        return {gate.output: index for index, gate in enumerate(self.gates)}


def recover(cnf: HealthCnf) -> Netlist | None:
    """Return the netlist behind the clauses of a circuit, or None when they are not those of one."""
    if not cnf.circuit or not cnf.weak or cnf.modes:
        return None
    n = len(cnf.components)
    own: dict[int, list[Clause]] = defaultdict(list)
    title: dict[int, str] = {}
    for clause, origin in zip(cnf.clauses, cnf.origins, strict=True):
        health = [literal for literal in clause if abs(literal) <= n]
        if len(health) != 1 or health[0] > 0:
            return None
        own[-health[0]].append(tuple(literal for literal in clause if abs(literal) > n))
        title.setdefault(-health[0], cnf.rules[origin].source.partition(" ")[2])
    gates: dict[int, Gate] = {}
    for component in range(1, n + 1):
        names = {cnf.components[component - 1], title.get(component, "")}
        gate = _gate(own.get(component, []), names, cnf, gates, component)
        if gate is None:
            return None
        gates[gate.output] = gate
    return _in_order(gates)


def _gate(
    clauses: list[Clause], names: set[str], cnf: HealthCnf, taken: dict[int, Gate], component: int
) -> Gate | None:
    """Return the gate. Where several nets could be its output (a buffer, a parity), its name decides."""
    if not clauses:
        return None
    shared = set.intersection(*({abs(literal) for literal in clause} for clause in clauses)) - taken.keys()
    first = len(cnf.components) + 1
    named = {
        net
        for net in shared
        if net - first < len(cnf.atoms)
        and cnf.atoms[net - first].args
        and cnf.atoms[net - first].args[0] in names
    }
    for output in sorted(named or shared):
        function = _function(output, clauses)
        if function is not None:
            inputs, expression, controlling = function
            return Gate(component, output, inputs, expression, controlling)
    return None


def _function(output: int, clauses: list[Clause]) -> tuple[tuple[int, ...], str, int | None] | None:
    """Return inputs, expression and controlling value of the function that the clauses define, if they
    define one.
    """
    inputs = tuple(sorted({abs(lit) for clause in clauses for lit in clause} - {output}))
    position = {variable: index for index, variable in enumerate(inputs)}
    wide = _and_or(output, clauses, inputs)
    if wide is not None:
        return inputs, *wide
    if len(inputs) > WIDEST_TABLE:
        return None
    minterms: list[str] = []
    ones: list[tuple[bool, ...]] = []
    for row in product((False, True), repeat=len(inputs)):
        forced = set()
        for clause in clauses:
            value = 0
            for literal in clause:
                if abs(literal) == output:
                    value = 1 if literal > 0 else -1
                elif row[position[abs(literal)]] == (literal > 0):
                    break
            else:
                forced.add(value)
        if len(forced) != 1:
            return None
        if forced == {1}:
            ones.append(row)
            minterms.append(
                "&".join(f"{{{i}}}" if bit else f"(M^{{{i}}})" for i, bit in enumerate(row)) or "M"
            )
    width = len(inputs)
    if width and all(sum(row) % 2 == 1 for row in ones) and len(ones) == 2 ** (width - 1):
        return inputs, "^".join(f"{{{i}}}" for i in range(width)), None
    if width and all(sum(row) % 2 == 0 for row in ones) and len(ones) == 2 ** (width - 1):
        return inputs, "^".join(["M", *(f"{{{i}}}" for i in range(width))]), None
    return inputs, "|".join(f"({term})" for term in minterms) or "0", None


def _and_or(output: int, clauses: list[Clause], inputs: tuple[int, ...]) -> tuple[str, int | None] | None:
    """Recognise AND, NAND, OR, NOR, NOT and BUF of any width: one long clause, and one of two literals an
    input.
    """
    long = [clause for clause in clauses if len(clause) == len(inputs) + 1]
    if len(inputs) == 1:
        long = [clause for clause in clauses if output in clause]
    if len(long) != 1 or len(clauses) != len(inputs) + 1 or not inputs:
        return None
    body = [literal for literal in long[0] if abs(literal) != output]
    head = output if output in long[0] else -output
    short = {frozenset((-literal, -head)) for literal in body}
    if {frozenset(clause) for clause in clauses if clause is not long[0]} != short or len(body) != len(
        inputs
    ):
        return None
    signs = {literal > 0 for literal in body}
    if len(signs) != 1:
        return None
    joined = ("|" if signs == {True} else "&").join(f"{{{i}}}" for i in range(len(inputs)))
    # body all negative: the inputs being all true forces `head`; all positive: being all false does.
    inverted = (head < 0) if signs == {False} else (head > 0)
    expression = f"M^({joined})" if inverted else joined
    return expression, (1 if signs == {True} else 0) if len(inputs) > 1 else None


def _in_order(gates: dict[int, Gate]) -> Netlist | None:
    """Sort topologically, without recursion; None when nets feed back."""
    users: dict[int, list[int]] = defaultdict(list)
    waits: dict[int, int] = {}
    for output, gate in gates.items():
        driven = [net for net in gate.inputs if net in gates]
        waits[output] = len(driven)
        for net in driven:
            users[net].append(output)
    ready = [output for output, count in waits.items() if count == 0]
    for output in ready:  # grows while it is read
        for user in users[output]:
            waits[user] -= 1
            if waits[user] == 0:
                ready.append(user)
    if len(ready) < len(gates):
        return None
    nets = {net for gate in gates.values() for net in gate.inputs}
    return Netlist(tuple(gates[output] for output in ready), frozenset(nets - gates.keys()))
