"""Small faults of a circuit by bit-parallel simulation: thousands of fault sets in one pass, no search.

When all inputs are observed, the members of a minimal diagnosis all give the opposite of what they should:
one that gives what it should could be dropped. So a set of gates is tried by flipping them, and each bit of
a Python integer is one trial, a *lane*. One pass over the gates tries all sets of one gate:

    lane           … 3 2 1 0          flip of g1   … 0 0 1 0       lane 0: nothing is flipped
    net "10"       … 1 0 1 1          flip of g2   … 0 1 0 0       lane i: gate i is flipped

For pairs, one of the two must be in a conflict, the support of one wrong output, and the other in the
supports of the wrong outputs that this leaves: the lanes are rows × columns. Larger sets are left to SAT.

The pass is a generated function of straight-line integer operations, about 40 ns a gate, with registers that
are used again as soon as a net is dead, so that long integers stay in the cache.

Source: J. A. Waicukauskauski et al. Fault simulation for structured VLSI. VLSI Systems Design, 1985
(parallel patterns; here the lanes are fault sets).
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Iterator, Sequence
from functools import reduce
from itertools import count
from operator import or_
from typing import Any

from robomend.diagnosis.circuits.netlist import Gate, Netlist
from robomend.diagnosis.masks import bits

Pass = Callable[[list[int], list[int], list[int], int], list[int]]
"""(inputs, flips, expected, ones) -> of each observed net the lanes in which it is wrong."""

Values = Callable[[dict[int, int], list[int], int], list[int]]
"""(inputs by net, flips, ones) -> the value on each net, by its number; 0 where there is no simulated net."""

LANES = 60_000
"""Of one pass: longer integers fall out of the cache."""

NESTED = 12
"""Gates within one expression, at most, one in the other: the compiler has a bound on parentheses."""


class Flips:
    """The generated passes of one netlist and one set of observed nets.

    Args:
        flippable: the gates (indices) that may be abnormal.
        simulated: the gates to simulate, in topological order: those with a path to an observed net.
        checks: the observed nets that a gate drives.
    """

    def __init__(
        self, netlist: Netlist, flippable: Sequence[int], simulated: Sequence[int], checks: Sequence[int]
    ) -> None:
        self.netlist = netlist
        self.flippable = tuple(flippable)
        self.checks = tuple(checks)
        used = {net for index in simulated for net in netlist.gates[index].inputs}
        self.inputs = tuple(sorted(used & netlist.sources))
        self._simulated = tuple(simulated)
        self._position = {gate: position for position, gate in enumerate(self.flippable)}
        self.lanes = (2 << len(self.flippable)) - 1  # of a pass over single gates
        self._one_by_one = [2 << position for position in range(len(self.flippable))]
        self._pass = self._generate()

    def one_by_one(
        self, inputs: Sequence[bool], expected: Sequence[bool], flipped: Collection[int] = ()
    ) -> list[int]:
        """Return of each observed net the lanes in which it is wrong.

        Lane 0 has these gates (indices into flippable) flipped, each other lane one gate more, or, if it is
        one of them, one less.
        """
        flips = self._one_by_one
        if flipped:
            flips = flips.copy()
            for gate in flipped:
                flips[gate] ^= self.lanes
        return self._wrong(inputs, flips, expected, self.lanes)

    def singles(self, inputs: Sequence[bool], expected: Sequence[bool]) -> tuple[bool, list[int]]:
        """Return whether nothing need be flipped, and (indices into flippable) who explains all alone."""
        good = self.lanes & ~reduce(or_, self.one_by_one(inputs, expected), 0)
        return bool(good & 1), bits(good >> 1)

    def needed(
        self, inputs: Sequence[bool], expected: Sequence[bool], gates: Sequence[int]
    ) -> set[int] | None:
        """Return those of these gates (indices into flippable) that cannot be left out, one at a time.

        None: together they do not explain all. A lane for each of them is a short integer, so that this takes
        half of what a pass over all single gates takes.
        """
        ones = (2 << len(gates)) - 1
        flips = [0] * len(self.flippable)
        for lane, gate in enumerate(gates):
            flips[gate] = ones ^ 2 << lane
        wrong = reduce(or_, self._wrong(inputs, flips, expected, ones), 0)
        if wrong & 1:
            return None
        return {gate for lane, gate in enumerate(gates, 1) if wrong >> lane & 1}

    def explaining_alone(
        self, inputs: Sequence[bool], expected: Sequence[bool], gates: Sequence[int]
    ) -> list[int]:
        """Return those of these gates that explain all alone: one lane each, however many are flippable."""
        flips = [0] * len(self.flippable)
        for lane, gate in enumerate(gates):
            flips[self._position[gate]] = 1 << lane
        good = self._good(inputs, flips, expected, (1 << len(gates)) - 1)
        return [gates[lane] for lane in bits(good)]

    def pairs(
        self,
        inputs: Sequence[bool],
        expected: Sequence[bool],
        supports: Sequence[int],
        between: Callable[[], None] = lambda: None,
    ) -> list[tuple[int, int]]:
        """Return the pairs (indices into flippable) that explain all.

        Where one explains all alone and flipping the other changes nothing, they may be among them.

        Args:
            supports: conflicts as masks over the flippable gates. One member of a pair is in the smallest,
                and the other in each support that the first is not in.
            between: called between passes.
        """
        smallest = min(supports, key=int.bit_count)
        everything = (1 << len(self.flippable)) - 1
        alone: list[int] = []  # in all supports: anything may go with it
        paired: list[int] = []
        partners = 0
        for one in bits(smallest):
            others = everything
            for support in supports:
                if not support >> one & 1:
                    others &= support
            if others == everything:
                alone.append(one)
            elif others:
                paired.append(one)
                partners |= others
        found: set[tuple[int, int]] = set()
        for rows, columns in ((alone, everything), (paired, partners)):
            found.update(self._rectangle(inputs, expected, rows, bits(columns), between))
        return sorted(found)

    def _rectangle(
        self,
        inputs: Sequence[bool],
        expected: Sequence[bool],
        rows: list[int],
        columns: list[int],
        between: Callable[[], None],
    ) -> Iterator[tuple[int, int]]:
        """Try each row gate with each column gate, in one lane each."""
        width = len(columns)
        height = max(1, LANES // max(1, width))
        for start in range(0, len(rows), height):
            between()
            chosen = rows[start : start + height]
            row = (1 << width) - 1
            ones = (1 << (width * len(chosen))) - 1
            comb = ones // row  # the first lane of each row
            flips = [0] * len(self.flippable)
            for position, gate in enumerate(columns):
                flips[gate] = comb << position
            for index, gate in enumerate(chosen):
                flips[gate] |= row << (index * width)
            for lane in bits(self._good(inputs, flips, expected, ones)):
                one, other = chosen[lane // width], columns[lane % width]
                if one != other:
                    yield (one, other) if one < other else (other, one)

    def agrees(self, inputs: Sequence[bool], expected: Sequence[bool]) -> bool:
        """Return whether nothing need be flipped."""
        return self._good(inputs, [0] * len(self.flippable), expected, 1) == 1

    def _good(self, inputs: Sequence[bool], flips: list[int], expected: Sequence[bool], ones: int) -> int:
        return ones & ~reduce(or_, self._wrong(inputs, flips, expected, ones), 0)

    def _wrong(
        self, inputs: Sequence[bool], flips: list[int], expected: Sequence[bool], ones: int
    ) -> list[int]:
        return self._pass(
            [ones if value else 0 for value in inputs],
            flips,
            [ones if value else 0 for value in expected],
            ones,
        )

    def _generate(self) -> Pass:
        """Write the pass as Python source and compile it.

        A register holds the value of a net or its complement, whichever comes cheaper, and buffers and
        inverters that cannot be flipped share the register of their input: half of the work on c7552. A net
        that is read once needs none: its gate, if it cannot be flipped, stands in the expression that reads
        it, which takes another sixth off.
        """
        gates, sources = self.netlist.gates, self.netlist.sources
        check_of = {net: position for position, net in enumerate(self.checks)}
        holder = self._holders()
        last: dict[int, int] = {}  # holder -> the last step that reads its register
        readers: dict[int, int] = dict.fromkeys((holder[net][0] for net in self.checks), 2)  # 2: or more
        for step, index in enumerate(self._simulated):
            read = [holder[net][0] for net in gates[index].inputs]
            last.update(dict.fromkeys(read, step))
            if holder[gates[index].output][0] == gates[index].output:
                readers.update((one, readers.get(one, 0) + 1) for one in read)
        # Of each holder the expression that has its value: a register, or a gate over registers.
        value_of = {net: f"i{position}" for position, net in enumerate(self.inputs)}
        turned = dict.fromkeys(self.inputs, False)  # holder -> whether that is the complement
        within: dict[int, set[int]] = {}  # holder without a register -> the holders of those that it reads
        depth: dict[int, int] = {}
        free: list[str] = []
        fresh = (f"r{number}" for number in count())
        lines = ["def sweep(I, F, E, M):"]
        lines += [f" i{position} = I[{position}]" for position in range(len(self.inputs))]
        for step, index in enumerate(self._simulated):
            gate = gates[index]
            operands = [holder[net] for net in gate.inputs]
            net, inverted = holder[gate.output]
            registers = set().union(*(within.get(one, {one}) for one, _ in operands)) - sources
            dead = {one for one in registers if last[one] == step}
            if net == gate.output:
                value, turned[net] = _value(
                    gate, [(value_of[one], turned[one] != opposite) for one, opposite in operands]
                )
                if index in self._position:
                    value = f"F[{self._position[index]}]^({value})"
                elif readers.get(net) == 1:
                    depth[net] = 1 + max([depth.get(one, 0) for one, _ in operands], default=0)
                    if depth[net] <= NESTED:
                        value_of[net], within[net] = f"({value})", registers
                        last.update((one, max(last[one], last[net])) for one in registers)
                        continue
                    depth[net] = 0
                free += [value_of.pop(one) for one in dead]
                value_of[net] = free.pop() if free else next(fresh)
                lines.append(f" {value_of[net]} = {value}")
                dead = set() if net in last else {net}
            if gate.output in check_of:
                check = check_of[gate.output]
                wrong = f"{value_of[net]}^E[{check}]"
                lines.append(f" c{check} = M^{wrong}" if turned[net] != inverted else f" c{check} = {wrong}")
            free += [value_of.pop(one) for one in dead]
        lines.append(f" return [{','.join(f'c{check}' for check in range(len(self.checks)))}]")
        sweep: Pass = compiled("\n".join(lines), "sweep")
        return sweep

    def _holders(self) -> dict[int, tuple[int, bool]]:
        """Return net -> the net whose register it shares (itself, mostly), and whether it is the opposite."""
        holder = {net: (net, False) for net in self.inputs}
        for index in self._simulated:
            gate = self.netlist.gates[index]
            holder[gate.output] = (gate.output, False)
            if gate.operator and len(gate.inputs) == 1 and index not in self._position:
                net, inverted = holder[gate.inputs[0]]
                holder[gate.output] = (net, inverted != gate.inverted)
        return holder


def _value(gate: Gate, operands: list[tuple[str, bool]]) -> tuple[str, bool]:
    """Return the gate as an expression over registers, and whether it is the complement of the output.

    Args:
        operands: the register of each input, and whether it has the complement.
    """
    if not gate.operator:
        straight = [f"(M^{name})" if turned else name for name, turned in operands]
        return gate.expression.format(*straight), False
    plain = [name for name, turned in operands if not turned]
    opposite = [name for name, turned in operands if turned]
    if gate.operator == "^":
        return "^".join([*plain, *opposite]), gate.inverted != (len(opposite) % 2 == 1)
    inverted = gate.inverted
    if gate.operator == "|":  # a | b is the complement of ¬a & ¬b
        plain, opposite, inverted = opposite, plain, not inverted
    if not opposite:
        return "&".join(plain), inverted
    if not plain:
        return "|".join(opposite), not inverted
    return f"{'&'.join(plain)}&(M^({'|'.join(opposite)}))", inverted


def values_of(netlist: Netlist, simulated: Sequence[int], flippable: Iterable[int]) -> Values:
    """Write and compile a pass that returns the value of each net: see Values."""
    position = {gate: index for index, gate in enumerate(flippable)}
    used = {net for index in simulated for net in netlist.gates[index].inputs} & netlist.sources
    lines = ["def values(V, F, M):", *(f" w{net} = V[{net}]" for net in sorted(used))]
    known = set(used)
    for index in simulated:
        gate = netlist.gates[index]
        value = gate.expression.format(*(f"w{net}" for net in gate.inputs))
        if index in position:
            value = f"F[{position[index]}]^({value})"
        lines.append(f" w{gate.output} = {value}")
        known.add(gate.output)
    listed = ",".join(f"w{net}" if net in known else "0" for net in range(max(known, default=0) + 1))
    lines.append(f" return [{listed}]")
    run: Values = compiled("\n".join(lines), "values")
    return run


def compiled(source: str, name: str) -> Any:
    """Return the function that the source defines; the source is ours, nothing in it comes from outside."""
    scope: dict[str, Any] = {}
    exec(compile(source, f"<{name} of a circuit>", "exec"), {}, scope)
    return scope[name]
