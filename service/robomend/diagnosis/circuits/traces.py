"""Why a circuit cannot show what was seen unless this gate is abnormal, by simulation with unknown values.

    gates of the diagnosis but one: unknown ──► known values, forward ──► an observed net that differs
                                                                              │
    conflict: the gates passed, the nets seen at the ends ◄── back along what decides each value

What is known on a net holds whatever the unknown gates do, so that the gates which decide it cannot all be
healthy, and the diagnosis meets this conflict in the one gate that was left. A lane of bits is one such
question; one walk over the gates answers all of a diagnosis. No solver, and nothing to compile: some 0.5 µs
a gate. Where two unknown gates would have to be tried both ways, nothing is found; that is the solver's.

Most conflicts are seen to be minimal by a second walk, over their own gates: each is turned over in a lane of
its own, with all that others do set so that it matters. If what was seen comes out, that gate is needed.

Sources:
    M. Abramovici, P. Menon, D. Miller. Critical path tracing: an alternative to fault simulation. IEEE Design
        & Test 1(1), 1984.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Sequence

from robomend.diagnosis.circuits.flips import compiled
from robomend.diagnosis.circuits.netlist import Gate, Netlist
from robomend.diagnosis.conflicts import Known
from robomend.diagnosis.observed import SignedObs

AND, OR, XOR, ANY = range(4)
"""Kinds of steps; all but the last have two inputs, which may be the same one."""

Step = tuple[int, int, int, int, bool, Gate]
"""Output, kind, two inputs, whether the result is the other way round, and the gate."""


def _step(gate: Gate) -> Step:
    kind = {"&": AND, "|": OR, "^": XOR}.get(gate.operator, ANY)
    if kind == ANY or not gate.inputs or len(gate.inputs) > 2 or (kind == XOR and len(gate.inputs) == 1):
        return gate.output, ANY, 0, 0, gate.inverted, gate
    # a | b is the complement of ¬a & ¬b: what is known to be 0 takes the place of what is known to be 1.
    return gate.output, kind, gate.inputs[0], gate.inputs[-1], gate.inverted != (kind == OR), gate


class Traces:
    """The traces of one netlist, for one set of observed nets.

    Args:
        simulated: the gates with a path to an observed net, in topological order.
    """

    def __init__(self, netlist: Netlist, simulated: Iterable[int], observed: Collection[int]) -> None:
        self.gates = [netlist.gates[index] for index in simulated]
        self.by_output = {gate.output: (place, gate) for place, gate in enumerate(self.gates)}
        self.output = {gate.component: gate.output for gate in self.gates}
        self.nets = 1 + max([max(gate.output, *gate.inputs) for gate in self.gates], default=0)
        self.checks = [gate.output for gate in self.gates if gate.output in observed]
        self.tables: dict[str, Callable[..., int]] = {}
        self.steps = [_step(gate) for gate in self.gates]

    def walk(self, observed: SignedObs, abnormal: Sequence[Iterable[int]]) -> Walk:
        """Return what is known on each net, in lane i with just the components of `abnormal[i]` abnormal."""
        return Walk(self, observed, abnormal)


class Walk:
    """What is known on each net, lane by lane."""

    def __init__(self, traces: Traces, observed: SignedObs, abnormal: Sequence[Iterable[int]]) -> None:
        self._traces = traces
        self._seen = observed.seen
        self._ones = [0] * traces.nets  # of each net the lanes in which it is known to be 1
        self._zeros = [0] * traces.nets
        self._wrong: dict[int, int] = {}  # observed net -> the lanes in which something else was seen
        unknown: dict[int, int] = {}
        for lane, components in enumerate(abnormal):
            for component in components:
                if (output := traces.output.get(component)) is not None:
                    unknown[output] = unknown.get(output, 0) | 1 << lane
        lanes = (1 << len(abnormal)) - 1
        self._simulate(unknown, lanes)

    def _simulate(self, unknown: dict[int, int], lanes: int) -> None:
        """Go through the gates. An observed net has its observed value, whatever drives it."""
        ones, zeros = self._ones, self._zeros
        for number in self._seen:
            if abs(number) < len(ones):
                (ones if number > 0 else zeros)[abs(number)] = lanes
        rails = ones, zeros
        special = {*unknown, *self._traces.checks}
        for output, kind, one, other, turned, gate in self._traces.steps:
            if kind <= OR:
                high, low = rails[kind], rails[1 - kind]
                known, opposite = high[one] & high[other], low[one] | low[other]
            elif kind == XOR:
                known = ones[one] & zeros[other] | zeros[one] & ones[other]
                opposite = zeros[one] & zeros[other] | ones[one] & ones[other]
            else:
                known, opposite = self._by_function(gate, lanes)
            if turned:
                known, opposite = opposite, known
            if output in special:
                known &= ~unknown.get(output, 0)
                opposite &= ~unknown.get(output, 0)
                if ones[output] or zeros[output]:
                    self._wrong[output] = opposite if ones[output] else known
                    continue
            ones[output], zeros[output] = known, opposite

    def _by_function(self, gate: Gate, lanes: int) -> tuple[int, int]:
        """Return the lanes in which a gate of any kind, were it not inverted, is known to be 1, and 0."""
        ones, zeros = self._ones, self._zeros
        if gate.operator == "^":
            one, zero = 0, lanes
            for net in gate.inputs:
                one, zero = one & zeros[net] | zero & ones[net], zero & zeros[net] | one & ones[net]
            return one, zero
        if gate.operator:
            high, low = (ones, zeros) if gate.operator == "&" else (zeros, ones)
            known, opposite = lanes, 0
            for net in gate.inputs:
                known &= high[net]
                opposite |= low[net]
            return (known, opposite) if gate.operator == "&" else (opposite, known)
        return self._by_table(gate, lanes)

    def _by_table(self, gate: Gate, lanes: int) -> tuple[int, int]:
        """Return the same of a gate of no named kind: known where all of its inputs are."""
        tables = self._traces.tables
        if (function := tables.get(gate.expression)) is None:
            names = [f"a{index}" for index in range(len(gate.inputs))]
            source = f"def gate({', '.join(['M', *names])}): return {gate.expression.format(*names)}"
            function = tables[gate.expression] = compiled(source, "gate")
        known = lanes
        for net in gate.inputs:
            known &= self._ones[net] | self._zeros[net]
        value = function(lanes, *[self._ones[net] for net in gate.inputs])
        return known & value, known & ~value

    def conflict(self, lane: int) -> Known | None:
        """Return a conflict with none of the lane's abnormal components, None where simulation shows none."""
        bit = 1 << lane
        start = next((net for net in self._traces.checks if self._wrong.get(net, 0) & bit), None)
        return None if start is None else self._traced(start, bit)

    def _traced(self, start: int, bit: int) -> Known:
        """Follow back what decides that this net is other than it was seen."""
        seen, by_output = self._seen, self._traces.by_output
        passed, ends = {start}, set()
        todo = [start]
        while todo:
            gate = by_output[todo.pop()][1]
            follow: Sequence[int] = gate.inputs
            if gate.controlling is not None:
                deciding = self._ones if gate.controlling else self._zeros
                best, least = 0, len(by_output)
                for net in follow:
                    if deciding[net] & bit:
                        if net in seen or -net in seen or net in passed:
                            best = net  # it costs nothing
                            break
                        if by_output[net][0] < least:  # else the gate that is nearest to the inputs
                            best, least = net, by_output[net][0]
                if best:
                    follow = (best,)
            for net in follow:
                if net in seen or -net in seen:
                    ends.add(net)
                elif net not in passed:
                    passed.add(net)
                    todo.append(net)
        rests = [net if net in seen else -net for net in (*sorted(ends), start)]
        components = [by_output[net][1].component for net in passed]
        return Known.of(components, rests, minimal=self._each_is_needed(start, passed))

    def _each_is_needed(self, start: int, passed: set[int]) -> bool:
        """Return whether turning over the output of any of these gates can make it right; no: not known.

        Nets that no gate of the conflict drives, and nobody observed, may have any value: the one that
        leaves the decision to the other inputs.
        """
        seen = self._seen
        in_order = sorted([self._traces.by_output[net] for net in passed])
        lanes = (1 << len(in_order)) - 1
        value: dict[int, int] = {}
        for lane, (_, gate) in enumerate(in_order):
            operator = gate.operator
            if not operator:
                return len(in_order) == 1
            open_value = lanes if operator == "&" else 0
            for net in gate.inputs:
                if net not in value:
                    value[net] = lanes if net in seen else 0 if -net in seen else open_value
            result = lanes if operator == "&" else 0
            for net in gate.inputs:
                if operator == "&":
                    result &= value[net]
                elif operator == "|":
                    result |= value[net]
                else:
                    result ^= value[net]
            value[gate.output] = (result ^ lanes if gate.inverted else result) ^ 1 << lane
        return value[start] == (lanes if start in seen else 0)
