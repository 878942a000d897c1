"""What a circuit looks like from one set of sensors: cones, simulation passes and a small CNF for the solver.

Everything here depends on which nets are observed, not on their values, and is made once for each such set:

    netlist + observed nets ──► cones ──► simulation passes (flips)          faults of one or two gates
                                     └──► top-level CNF, simplified          larger ones, core-guided

In the top-level CNF the gates below the top level are simply healthy, so most of their nets can be
eliminated. The health literals of the top level and the observed nets are frozen: they are what the search
speaks of.

Replacing members by gates of their cones is exact. With all inputs observed, each member of a
minimum-cardinality diagnosis gives the opposite of what it should (else it could be dropped), so the values
on all nets outside the cones are fixed, one way only; a gate of the cone can stand in for its top exactly
when flipping it flips the top, whatever stands in for the other members. The flat diagnoses are therefore
the products, and the count is exact.
"""

from __future__ import annotations

from collections.abc import Callable, Generator, Iterator, Sequence
from functools import reduce
from itertools import compress
from operator import or_

from pysat.solvers import Cadical153

from robomend.diagnosis.circuits.flips import Flips, Values, compiled, values_of
from robomend.diagnosis.circuits.netlist import Netlist, by_output, few_behind, find_cones
from robomend.diagnosis.circuits.traces import Traces
from robomend.diagnosis.core_guided import CoreGuided, MinimumTooLarge
from robomend.diagnosis.masks import bits
from robomend.diagnosis.observed import SignedObs
from robomend.diagnosis.oracle import Deadline
from robomend.model.cnf import HealthCnf

# --- A small diagnosis of a circuit by a few simulations: an upper bound, often the minimum, never surely.
#
#     pass: each gate flipped, in a lane of its own ──► which wrong outputs it mends, if it spoils one
#        ▲                                                     │
#        │                                                     ▼
#        └─── again, with these flipped already ◄── few gates that mend all and spoil nothing
#                      │
#                      ▼ all outputs are right (a short pass tells: without each of them, or with all)
#             gates that need not be flipped are dropped
#
# What mends one output may spoil what another gate mends, so that the next pass goes on from what is still
# wrong. A search for the minimum that knows such an incumbent need only prove that there is nothing
# smaller: the model that it would search for, and most of what leads to it, is saved.

PASSES = 6
"""What is not mended by then is mended by too many gates to be of use; most take one or two."""


def find_incumbent(
    flips: Flips,
    inputs: Sequence[bool],
    expected: Sequence[bool],
    wrong: list[int],
    between: Callable[[], None] = lambda: None,
) -> list[int] | None:
    """Return gates (indices into flippable) that explain all together, and each is needed; None: not found.

    Args:
        wrong: what the pass over single gates found, `Flips.one_by_one`.
        between: called between passes.
    """
    gates = flips.lanes & ~1
    chosen: frozenset[int] = frozenset()
    before = len(wrong) + 1
    for attempt in range(PASSES):
        if attempt:
            wrong = flips.one_by_one(inputs, expected, chosen)
        still = []
        spoiling = 0
        for lanes in wrong:
            if lanes & 1:
                still.append(lanes)
            else:
                spoiling |= lanes
        added = _cover([gates & ~(lanes | spoiling) for lanes in still])
        if not added or len(still) >= before:  # they were in each other's way: the best one alone
            added = {_lowest(_least(wrong, gates)) - 1}
        chosen ^= added
        before = len(still)
        members = sorted(chosen)
        between()
        while (needed := flips.needed(inputs, expected, members)) is not None:
            spare = next((gate for gate in members if gate not in needed), None)
            if spare is None:
                return members
            members.remove(spare)
            between()
    return None


def _cover(mending: list[int]) -> set[int]:
    """Return few gates of which one mends each output, the outputs that few gates mend first.

    Args:
        mending: of each wrong output the lanes in which it is right, and no other output is spoilt.
    """
    chosen = set()
    mending = sorted(filter(None, mending), key=int.bit_count)
    while mending:
        lanes = mending[0]
        for others in mending:
            lanes = lanes & others or lanes
        lane = _lowest(lanes)
        chosen.add(lane - 1)
        mending = [others for others in mending if not others >> lane & 1]
    return chosen


def _lowest(lanes: int) -> int:
    return (lanes & -lanes).bit_length() - 1


def _least(words: list[int], among: int) -> int:
    """Return the lanes that are in fewest of the words."""
    for digit in reversed(_counted(words)):
        among = among & ~digit or among
    return among


def _counted(words: list[int]) -> list[int]:
    """Return in how many of the words each lane is, as binary digits, the last one first: an adder a lane."""
    digits: list[int] = []
    for word in words:
        carry = word
        for index, digit in enumerate(digits):
            digits[index] = digit ^ carry
            carry &= digit
            if not carry:
                break
        else:
            if carry:
                digits.append(carry)
    return digits


Top = tuple[int, ...]
"""A top-level diagnosis: gates, as indices into the netlist, ascending."""

SIMPLIFIED_CLAUSES = 200_000
"""Larger formulas are searched as they are: the simplifier cannot be interrupted."""

PROBED_CLAUSES = 20_000
"""Of larger formulas, variables are eliminated without probing and vivification: they take a third of the
time and hardly change the formula."""

SIMPLIFIED_S = 10e-6
"""A clause, to simplify: half of the time left must be enough, or the formula is searched as it is."""

SIMULATED_GATES = 20_000
"""Larger circuits are left to the solver: Python takes long to compile their passes."""

COMPILED_S = 100e-6
"""A gate, to write and compile a pass: it cannot be interrupted, so half of the time left must be enough."""

SUPPORTS_TRIED = 3

NARROW = 5
"""Where no more top-level gates are behind a wrong output, one of them is abnormal: that is as good as the
solver's core, and costs nothing. Wider ones are much wider than what the solver would find."""

BATCH = 1_024
"""Top-level diagnoses whose cones are expanded in one go."""


class TopLevel:
    """The top level for one set of observed nets."""

    def __init__(
        self, cnf: HealthCnf, netlist: Netlist, observed: frozenset[int], clock: Deadline, solver: str
    ) -> None:
        self.netlist = netlist
        self.cones = find_cones(netlist, observed)
        self.uses = 0
        self.at_least = 0  # after a search: no diagnosis has fewer members
        self.best: Top | None = None  # one that it came upon, which may not be the minimum
        self._cnf = cnf
        self._clock = clock
        self._solver = solver
        self._driver = netlist.driver()
        self._checks = tuple(sorted(net for net in observed if net in self._driver))
        used = {net for index in self.cones.seen for net in netlist.gates[index].inputs}
        self._observed_sources = sorted(used & netlist.sources & observed)
        self.determined = (used & netlist.sources) <= observed
        """All inputs that matter are observed: what healthy gates do is known, and simulation is exact."""
        self._flips: dict[bool, Flips] = {}
        self._values: Values | None = None
        self._functions: dict[str, Callable[..., int]] = {}
        self._traces: Traces | None = None
        self._guided: CoreGuided | None = None
        self._narrow: list[tuple[int, ...]] = []  # of each check the candidates behind it, where they are few
        self._number: dict[int, int] = {}  # of a signed net, in the top-level CNF
        self._candidate: dict[int, int] = {}  # top-level gate -> its number in the top-level CNF

    # --- top-level diagnoses ----------------------------------------------------------------------

    def minimum(
        self, observed: SignedObs, first_only: bool, at_most: int | None
    ) -> Generator[Top, None, None]:
        """Yield the minimum-cardinality diagnoses among the top-level gates.

        Args:
            first_only: one is wanted, whether or not others follow.

        Raises:
            MinimumTooLarge: they have more than `at_most` members.
            OutOfTime: what was yielded before stays true.
        """
        self.uses += 1
        self.at_least, self.best = 0, None
        at_least = 0
        incumbent = None
        wrong: list[int] = []
        if self._simulates(first_only):
            top = self.cones.top
            flips = self._passes(flat=False)
            inputs, expected = self._inputs(observed)
            if not first_only:
                self._prepare_cones()
            wrong = flips.one_by_one(inputs, expected)
            good = flips.lanes & ~reduce(or_, wrong, 0)
            if good & 1:
                yield ()
                return
            if at_most == 0:
                raise MinimumTooLarge
            if good:
                yield from ((top[lane - 1],) for lane in bits(good))
                return
            if at_most == 1:
                raise MinimumTooLarge
            at_least = self.at_least = 2
            if first_only:
                incumbent = find_incumbent(flips, inputs, expected, wrong, self._clock.check)
                if incumbent is not None and len(incumbent) == at_least:
                    yield tuple([top[position] for position in incumbent])
                    return
                if incumbent is not None:
                    self.best = tuple([top[position] for position in incumbent])
                else:
                    self.best = self._mended(inputs, expected, wrong)
            else:
                self._clock.check()
                pairs = flips.pairs(inputs, expected, self._supports(observed, flat=False), self._clock.check)
                if pairs:
                    yield from ((top[one], top[other]) for one, other in pairs)
                    return
                at_least = self.at_least = 3
                self.best = self._mended(inputs, expected, wrong)
        guided = self._search()
        assumptions = list(filter(None, map(self._number.get, observed.numbers)))
        known = None
        if incumbent is not None:
            known = [self._candidate[self.cones.top[position]] for position in incumbent]
        narrow = compress(self._narrow, [lanes & 1 for lanes in wrong])
        cores = sorted(filter(None, narrow), key=len)
        in_order = tuple(self._candidate)
        try:
            for found in guided.minimum(assumptions, at_least, at_most, incumbent=known, cores=cores):
                yield tuple(sorted([in_order[candidate - 1] for candidate in found]))
        finally:
            self.at_least = guided.paid
            if guided.best is not None and (self.best is None or len(guided.best) < len(self.best)):
                self.best = tuple(sorted([in_order[candidate - 1] for candidate in guided.best]))

    def _mended(self, inputs: Sequence[bool], expected: Sequence[bool], wrong: Sequence[int]) -> Top | None:
        """Return the gates that drive wrong outputs, if with these turned over all is right."""
        position = {gate: place for place, gate in enumerate(self.cones.top)}
        driving = [self._driver[net] for net, lanes in zip(self._checks, wrong, strict=True) if lanes & 1]
        gates = [position[gate] for gate in driving]
        return (
            tuple(driving) if self._passes(flat=False).needed(inputs, expected, gates) is not None else None
        )

    def small_subset_minimal(self, observed: SignedObs, size: int, smaller: set[int]) -> Iterator[Top]:
        """Yield the subset-minimal diagnoses of 1 or 2 gates, of all gates; `smaller`: those of size 1."""
        flips = self._passes(flat=True)
        inputs, expected = self._inputs(observed)
        seen = self.cones.seen
        if size == 1:
            yield from ((seen[position],) for position in flips.singles(inputs, expected)[1])
            return
        for one, other in flips.pairs(
            inputs, expected, self._supports(observed, flat=True), self._clock.check
        ):
            if seen[one] not in smaller and seen[other] not in smaller:
                yield seen[one], seen[other]

    def all_healthy(self, observed: SignedObs) -> bool:
        """Return whether simulation agrees with all that is observed."""
        inputs, expected = self._inputs(observed)
        return self._passes(flat=False).agrees(inputs, expected)

    def prepare(self) -> None:
        """Make what searches for one diagnosis, and for what it rests on."""
        self._search()
        self.traces()
        if self._simulates(first_only=True):
            self._passes(flat=False)

    def traces(self) -> Traces:
        """Return what finds conflicts by simulation."""
        if self._traces is None:
            sensors = {*self._checks, *self._observed_sources}
            self._traces = Traces(self.netlist, self.cones.seen, sensors)
        return self._traces

    def _simulates(self, first_only: bool) -> bool:
        """Whether passes are worth compiling: for one diagnosis they are, as many are asked for.

        Else at the second use; for all diagnoses of a few gates at once.
        """
        at_once = first_only or len(self.netlist.gates) <= 1_000
        return self.can_simulate and (self.uses > 1 or at_once)

    @property
    def can_simulate(self) -> bool:
        """Whether the circuit, its sensors and the time that is left allow simulation at all."""
        gates = len(self.netlist.gates)
        if not self.determined or gates > SIMULATED_GATES:
            return False
        return bool(self._flips) or 2 * gates * COMPILED_S < self._clock.left_s

    def _passes(self, flat: bool) -> Flips:
        flips = self._flips.get(flat)
        if flips is None:
            flippable = self.cones.seen if flat else self.cones.top
            flips = self._flips[flat] = Flips(self.netlist, flippable, self.cones.seen, self._checks)
        return flips

    def _inputs(self, observed: SignedObs) -> tuple[list[bool], list[bool]]:
        seen = observed.seen.__contains__
        return list(map(seen, self._observed_sources)), list(map(seen, self._checks))

    def _prepare_cones(self) -> None:
        """Compile all that cones need with the rest, so that no later call of a warm engine waits for it."""
        if len(self.cones.top) < len(self.cones.seen):
            self._passes(flat=True)
            self._value_pass()

    def _value_pass(self) -> Values:
        if self._values is None:
            self._values = values_of(self.netlist, self.cones.seen, self.cones.top)
        return self._values

    def _net_values(self, observed: SignedObs, flips: list[int], ones: int) -> list[int]:
        return self._value_pass()(
            {net: ones if net in observed.seen else 0 for net in self._observed_sources}, flips, ones
        )

    def _supports(self, observed: SignedObs, flat: bool) -> list[int]:
        """Return conflicts as masks over the flippable gates: those that make a wrong output what it is.

        Where an input alone decides a gate's output, only that input is followed.
        """
        nets = self._net_values(observed, [0] * len(self.cones.top), 1)
        wrong = [net for net in self._checks if nets[net] != (net in observed.seen)]
        flippable = self.cones.seen if flat else self.cones.top
        bit = {gate: 1 << index for index, gate in enumerate(flippable)}
        return [sum(bit.get(gate, 0) for gate in self._justify(net, nets)) for net in wrong[:SUPPORTS_TRIED]]

    def _justify(self, net: int, nets: list[int]) -> set[int]:
        gates, driver = self.netlist.gates, self._driver
        reached: set[int] = set()
        todo = [driver[net]]
        while todo:
            index = todo.pop()
            if index in reached:
                continue
            reached.add(index)
            gate = gates[index]
            follow = gate.inputs
            if gate.controlling is not None:
                deciding = [i for i in gate.inputs if nets[i] == gate.controlling]
                if deciding:
                    # A source costs nothing; else the gate that is nearest to the inputs.
                    follow = (min(deciding, key=lambda i: driver.get(i, -1)),)
            todo.extend(driver[i] for i in follow if i in driver)
        return reached

    def _search(self) -> CoreGuided:
        """Build the top-level CNF at the first need: candidates first, then the nets that are left."""
        if self._guided is not None:
            return self._guided
        gates, cnf = self.netlist.gates, self._cnf
        n = len(cnf.components)
        in_order = by_output(self.netlist, self.cones, self._checks)
        self._candidate = {gate: number for number, gate in enumerate(in_order, 1)}
        self._narrow = [
            tuple([self._candidate[gate] for gate in behind])
            for behind in few_behind(self.netlist, self.cones, self._checks, NARROW)
        ]
        candidate = {gates[gate].component: number for gate, number in self._candidate.items()}
        seen = {gates[index].component for index in self.cones.seen}
        clauses: list[list[int]] = []
        for clause in cnf.clauses:
            health = next(-literal for literal in clause if abs(literal) <= n)
            if health in candidate:
                clauses.append(list(clause))
            elif health in seen:
                clauses.append([literal for literal in clause if abs(literal) > n])
        frozen = [*candidate, *self._checks, *self._observed_sources]
        self._clock.check()
        if len(clauses) <= min(SIMPLIFIED_CLAUSES, self._clock.left_s / (2 * SIMPLIFIED_S)):
            # As pysat's Processor does, without its deep copy of what comes back. Nothing that replaces one
            # variable by another: the frozen ones must stay themselves.
            small = len(clauses) <= PROBED_CLAUSES
            with Cadical153(bootstrap_with=clauses) as simplifier:
                _, clauses = simplifier.process(decompose=False, probe=small, vivify=small, freeze=frozen)
        number = dict(candidate)
        for variable in frozen:
            number.setdefault(variable, len(number) + 1)
        for body in clauses:
            for literal in body:
                number.setdefault(abs(literal), len(number) + 1)
        renumbered = [[number[lit] if lit > 0 else -number[-lit] for lit in body] for body in clauses]
        for net in (*self._checks, *self._observed_sources):
            self._number[net], self._number[-net] = number[net], -number[net]
        self._guided = CoreGuided(renumbered, len(candidate), len(number), self._clock, self._solver)
        return self._guided

    # --- cones ------------------------------------------------------------------------------------

    def alternatives(self, observed: SignedObs, tops: Sequence[Top]) -> Iterator[tuple[tuple[int, ...], ...]]:
        """Yield for each top-level diagnosis what may stand in for each member, the member itself included.

        Only for minimum-cardinality diagnoses, and only where `can_simulate`.
        """
        expand = self._expand_singles if tops and len(tops[0]) == 1 else self._expand
        for start in range(0, len(tops), BATCH):
            self._clock.check()
            yield from expand(observed, tops[start : start + BATCH])

    def _expand_singles(self, observed: SignedObs, tops: Sequence[Top]) -> Iterator[tuple[tuple[int, ...]]]:
        """A gate stands in for a top that explains all alone exactly when it explains all alone too."""
        members = self.cones.members
        below = [gate for (top,) in tops for gate in members[top][:-1]]
        fits = (
            set(self._passes(flat=True).explaining_alone(*self._inputs(observed), below)) if below else set()
        )
        for (top,) in tops:
            yield ((top, *[gate for gate in members[top][:-1] if gate in fits]),)

    def _expand(self, observed: SignedObs, tops: Sequence[Top]) -> Iterator[tuple[tuple[int, ...], ...]]:
        lanes = len(tops)
        ones = (1 << lanes) - 1
        member_of: dict[int, int] = {}  # top-level gate -> the lanes (diagnoses) that it is a member of
        for lane, top in enumerate(tops):
            for gate in top:
                member_of[gate] = member_of.get(gate, 0) | 1 << lane
        replaced: dict[int, list[list[int]]] = {}  # top-level gate -> lane -> gates that can stand in
        if any(len(self.cones.members[gate]) > 1 for gate in member_of):
            nets = self._net_values(observed, [member_of.get(gate, 0) for gate in self.cones.top], ones)
            for gate, lanes_of_gate in member_of.items():
                if len(self.cones.members[gate]) > 1:
                    replaced[gate] = self._stand_ins(gate, lanes_of_gate, nets, lanes)
        for lane, top in enumerate(tops):
            yield tuple((gate, *replaced[gate][lane]) if gate in replaced else (gate,) for gate in top)

    def _stand_ins(self, top: int, wanted: int, nets: list[int], lanes: int) -> list[list[int]]:
        """Flip each gate of the cone in a block of lanes of its own; keep those that flip the top."""
        gates, cone = self.netlist.gates, self.cones.members[top]
        below = len(cone) - 1
        block = (1 << lanes) - 1
        copies = sum(1 << (lanes * index) for index in range(below))
        ones = block * copies
        inside: dict[int, int] = {}
        for index, member in enumerate(cone):
            gate = gates[member]
            arguments = [inside[net] if net in inside else nets[net] * copies for net in gate.inputs]
            value = self._function(gate.expression, len(arguments))(ones, *arguments)
            inside[gate.output] = value ^ (block << (lanes * index) if index < below else 0)
        flipped = ones & ~(inside[gates[top].output] ^ nets[gates[top].output] * copies) & wanted * copies
        found: list[list[int]] = [[] for _ in range(lanes)]
        for bit in bits(flipped):
            found[bit % lanes].append(cone[bit // lanes])
        return found

    def _function(self, expression: str, inputs: int) -> Callable[..., int]:
        function: Callable[..., int] | None = self._functions.get(expression)
        if function is None:
            names = [f"a{index}" for index in range(inputs)]
            source = f"def gate({', '.join(['M', *names])}): return {expression.format(*names)}"
            function = compiled(source, "gate")
            self._functions[expression] = function
        return function

    def close(self) -> None:
        """Free the solver."""
        if self._guided is not None:
            self._guided.close()
