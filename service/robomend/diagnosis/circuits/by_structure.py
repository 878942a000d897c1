"""Diagnoses of a circuit by its structure, with nothing supposed; exact, and each search hands over to the
next.

1 or 2 gates           flips.py: every single and double fault, simulated bit-parallel
minimum cardinality    toplevel.py: core-guided over gates without dominator, then their cones; if one is
                       enough, from the small one on that simulation finds
subset-minimal         by_solver.py: size by size on the whole circuit, from the minimum on
"""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Iterable, Iterator, Sequence
from contextlib import closing
from itertools import product
from math import prod

from robomend.diagnosis.by_solver import BySolver
from robomend.diagnosis.circuits.netlist import Netlist
from robomend.diagnosis.circuits.toplevel import Top, TopLevel
from robomend.diagnosis.circuits.traces import Walk
from robomend.diagnosis.consistency import Consistency
from robomend.diagnosis.observed import NOTHING_SUPPOSED, SignedObs
from robomend.diagnosis.oracle import OutOfTime
from robomend.diagnosis.result import Options
from robomend.diagnosis.search import Bad, SearchState

SENSOR_SETS = 4
"""Sets of observed nets whose cones and passes are kept."""


class ByStructure:
    """See the module."""

    def __init__(self, consistency: Consistency, netlist: Netlist, by_solver: BySolver) -> None:
        self._consistency = consistency
        self._cnf = consistency.cnf
        self._clock = consistency.clock
        self._netlist = netlist
        self._by_solver = by_solver
        self._top_levels: OrderedDict[frozenset[int], TopLevel] = OrderedDict()

    def _top_level(self, observed: SignedObs) -> TopLevel:
        sensors = frozenset(map(abs, observed.numbers))
        top_level = self._top_levels.get(sensors)
        if top_level is None:
            if len(self._top_levels) >= SENSOR_SETS:
                self._top_levels.popitem(last=False)[1].close()
            top_level = TopLevel(self._cnf, self._netlist, sensors, self._clock, self._consistency.solver)
            self._top_levels[sensors] = top_level
        else:
            self._top_levels.move_to_end(sensors)
        return top_level

    def prepare(self, observed: SignedObs) -> None:
        """Compile all that questions about these sensors need."""
        self._top_level(observed).prepare()

    def walk(self, observed: SignedObs, abnormal: Sequence[Iterable[int]]) -> Walk:
        """Simulate with these components abnormal, each set in its own lane, to find conflicts outside."""
        return self._top_level(observed).traces().walk(observed, abnormal)

    def minimum(self, observed: SignedObs, options: Options, answer: SearchState) -> None:
        """List the minimum-cardinality diagnoses."""
        self._clock.check()
        top_level = self._top_level(observed)
        if options.limit == 1 and not options.factored:
            try:
                with closing(top_level.minimum(observed, True, options.max_size)) as tops:
                    for top in tops:
                        answer.add(self._bad(top))
            finally:
                self._bounds(top_level, answer)
            return
        total = 0
        first = 1 if options.limit == 1 else 64
        late = None if options.factored else answer
        for batch, rows in self._minima(top_level, observed, options.max_size, first, late):
            for top, row in zip(batch, rows, strict=True):
                if options.factored:
                    total += self._add_row(top_level, top, row, observed, answer)
                    continue
                for choice in self._choices(top, row, observed, top_level):
                    answer.add(self._bad(choice))
        answer.count = total if options.factored else None

    def _minima(
        self,
        top_level: TopLevel,
        observed: SignedObs,
        at_most: int | None,
        first: int,
        late: SearchState | None,
    ) -> Iterator[tuple[list[Top], Iterator[tuple[tuple[int, ...], ...]]]]:
        """Yield top-level diagnoses in batches, and what may stand in for each member.

        Args:
            late: takes those of the last batch, as they are, when the time is up.
        """
        try:
            with closing(top_level.minimum(observed, False, at_most)) as tops:
                for batch, whole in _batches(tops, first):
                    if whole:
                        yield batch, self._alternatives(top_level, observed, batch)
                    elif late is not None:
                        for top in batch:
                            late.add(self._bad(top))
        finally:
            if late is not None:
                self._bounds(top_level, late)

    def _bounds(self, top_level: TopLevel, answer: SearchState) -> None:
        """Note what the search knows of the smallest diagnosis, if it has not found it."""
        answer.at_least = max(answer.at_least, top_level.at_least)
        best = top_level.best
        if best is not None and (answer.best is None or len(best) < len(answer.best)):
            answer.best = self._bad(best)

    def _alternatives(
        self, top_level: TopLevel, observed: SignedObs, tops: Sequence[Top]
    ) -> Iterator[tuple[tuple[int, ...], ...]]:
        """Yield what may stand in for each member of each top-level diagnosis, if the others stay."""
        if top_level.can_simulate:
            yield from top_level.alternatives(observed, tops)
            return
        for top in tops:
            row = []
            for member in top:
                others = [gate for gate in top if gate != member]
                cone = [gate for gate in reversed(top_level.cones.members[member]) if gate != member]
                fits = [gate for gate in cone if self._explains([*others, gate], observed)]
                row.append((member, *fits))
            yield tuple(row)

    def _choices(
        self, top: Top, row: Sequence[Sequence[int]], observed: SignedObs, top_level: TopLevel
    ) -> Iterator[tuple[int, ...]]:
        """Yield the diagnoses behind a row.

        They are the product, except where unobserved inputs leave the values between the cones open: then
        two stand-ins may each fit, but not together.
        """
        for choice in product(*row):
            replaced = sum(gate != member for gate, member in zip(choice, top, strict=True))
            if replaced < 2 or top_level.determined or self._explains(choice, observed):
                yield choice

    def _add_row(
        self,
        top_level: TopLevel,
        top: Top,
        row: Sequence[Sequence[int]],
        observed: SignedObs,
        answer: SearchState,
    ) -> int:
        """Add a top-level diagnosis with its factors; return how many diagnoses it stands for."""
        count = prod(len(alternatives) for alternatives in row)
        if not top_level.determined and sum(len(alternatives) > 1 for alternatives in row) > 1:
            choices = list(self._choices(top, row, observed, top_level))
            if len(choices) < count:  # not a product: each is a row of its own
                for choice in choices:
                    answer.rows.append(tuple(((self._component(gate),),) for gate in choice))
                    answer.add(self._bad(choice))
                return len(choices)
        answer.rows.append(tuple(tuple((self._component(gate),) for gate in gates) for gates in row))
        answer.add(self._bad(top))
        return count

    def subset_minimal(self, observed: SignedObs, options: Options, answer: SearchState) -> None:
        """List the subset-minimal diagnoses by size: simulated, then the minimum, then layer by layer."""
        self._clock.check()
        top_level = self._top_level(observed)
        known: list[Bad] = []
        size = 0
        if top_level.can_simulate:
            if top_level.all_healthy(observed):
                answer.add(())
                return
            smaller: set[int] = set()
            for size in (1, 2):
                if options.max_size is not None and size > options.max_size:
                    break
                for top in top_level.small_subset_minimal(observed, size, smaller):
                    bad = self._bad(top)
                    known.append(bad)
                    answer.add(bad)
                    if size == 1:
                        smaller.add(top[0])
            size = 3 if options.max_size is None else min(3, options.max_size + 1)
        if not known:
            for batch, rows in self._minima(top_level, observed, options.max_size, 64, answer):
                for top, row in zip(batch, rows, strict=True):
                    for choice in self._choices(top, row, observed, top_level):
                        known.append(self._bad(choice))
                        answer.add(known[-1])
            size = len(known[0]) + 1
            if size == 1:
                return
        self._by_solver.layers(observed, NOTHING_SUPPOSED, options, answer, known, size)

    def _explains(self, gates: Sequence[int], observed: SignedObs) -> bool:
        """Ask the solver whether OBS is consistent when these gates are abnormal."""
        return self._consistency.explains(map(self._component, gates), observed.numbers)

    def _component(self, gate: int) -> int:
        return self._netlist.gates[gate].component

    def _bad(self, gates: Sequence[int]) -> Bad:
        return tuple(sorted(map(self._component, gates)))

    def close(self) -> None:
        """Free the solvers."""
        for top_level in self._top_levels.values():
            top_level.close()
        self._top_levels.clear()


def _batches(tops: Iterator[Top], size: int) -> Iterator[tuple[list[Top], bool]]:
    """Yield the top-level diagnoses in lists that grow, so that not many more are fetched than are wanted.

    With each whether there was time for all of it; if not, OutOfTime follows.
    """
    batch: list[Top] = []
    try:
        for top in tops:
            batch.append(top)
            if len(batch) >= size:
                yield batch, True
                size, batch = min(4 * size, 1_024), []
    except OutOfTime:
        yield batch, False
        raise
    if batch:
        yield batch, True
