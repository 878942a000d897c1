"""The default engine: SAT with one persistent solver a model and observations as assumptions.

Which search answers depends on the model and the question; all are exact, and each hands over to the next:

    a circuit, nothing supposed                              flips.py    faults of 1 or 2 gates, simulated
        minimum cardinality    toplevel.py, oll.py           top-level diagnoses, then their cones
        subset-minimal         layered.py                    from size 3 on, the whole circuit
    any other model            hitting.py                    conflicts and hitting sets over bit masks
        conflicts too wide     oll.py, layered.py            minimum cardinality; subset-minimal by size
    order of probability       ranking.py, guided.py         hitting sets in order of weight

Cone reasoning needs a weak fault model whose clauses are those of a circuit; where they are not (fault
modes, AB in a premise, rules that are no gates, components supposed healthy or abnormal), it is off by
itself.

`limit` diagnoses are always the smallest ones: order of size is part of the answer, so that no faster,
unordered enumeration takes its place. Where there is no bound on the size, the time-out is what ends it.
"""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable, Iterator, Sequence
from contextlib import closing
from functools import cached_property
from itertools import product
from math import prod

from robomend.diagnosis.base import Bad, BaseEngine, NoDiagnosis, SearchState, refuse_order_of_probability
from robomend.diagnosis.circuits.netlist import Netlist, recover
from robomend.diagnosis.circuits.toplevel import Top, TopLevel
from robomend.diagnosis.conflicts import Known
from robomend.diagnosis.hitting import HittingSets, TooManyNodes
from robomend.diagnosis.layered import Layered
from robomend.diagnosis.masks import mask_of, members, outside
from robomend.diagnosis.observed import NOTHING_SUPPOSED, SignedObs, Supposed
from robomend.diagnosis.oll import CoreGuided, MinimumTooLarge
from robomend.diagnosis.ranking import by_probability
from robomend.diagnosis.result import Options
from robomend.model.cnf import HealthCnf

SENSOR_SETS = 4
"""Sets of observed nets whose cones and passes are kept."""

MAX_GATES = 200_000
NODE_BUDGET = 20_000
"""Nodes of a hitting-set search before a SAT search takes over."""

WIDE_CONFLICT = 60
"""The hitting-set tree branches this much at most; wider conflicts go to a SAT search."""


class SatEngine(BaseEngine):
    """See the module. One call at a time; `interrupt` may come from any thread."""

    name = "sat"

    def __init__(self, cnf: HealthCnf, *, solver: str | None = None) -> None:
        super().__init__(cnf, solver=solver)
        self._asked_solver = None if solver is None else self.solver
        small_enough = cnf.circuit and len(cnf.components) <= MAX_GATES
        self._netlist: Netlist | None = recover(cnf) if small_enough else None
        self._top_levels: OrderedDict[frozenset[int], TopLevel] = OrderedDict()
        if self._netlist is None:
            _ = self._oracle  # built with the model, not in the first call

    def _refuse(self, options: Options) -> None:
        if options.order == "probability":
            refuse_order_of_probability(self.cnf, options)

    def _search(self, observed: SignedObs, what_if: Supposed, options: Options, answer: SearchState) -> None:
        if options.order == "probability":
            self._by_probability(observed, what_if, options, answer)
        elif self._netlist is not None and what_if is NOTHING_SUPPOSED:
            if options.minimal == "cardinality":
                self._circuit_minimum(observed, options, answer)
            else:
                self._circuit_subset_minimal(observed, options, answer)
        elif self.cnf.circuit:
            self._by_solver(observed, what_if, options, answer, [], 0)
        else:
            self._by_conflicts(observed, what_if, options, answer)

    # --- circuits ---------------------------------------------------------------------------------

    def _top_level(self, observed: SignedObs) -> tuple[TopLevel, dict[int, bool]]:
        values = {abs(number): number > 0 for number in observed.numbers}
        sensors = frozenset(values)
        top_level = self._top_levels.get(sensors)
        if top_level is None:
            assert self._netlist is not None
            if len(self._top_levels) >= SENSOR_SETS:
                self._top_levels.popitem(last=False)[1].close()
            top_level = TopLevel(self.cnf, self._netlist, sensors, self._clock, self.solver)
            self._top_levels[sensors] = top_level
        else:
            self._top_levels.move_to_end(sensors)
        return top_level, values

    def _circuit_minimum(self, observed: SignedObs, options: Options, answer: SearchState) -> None:
        self._clock.check()
        top_level, values = self._top_level(observed)
        first_only = options.limit == 1 and not options.factored
        with closing(top_level.minimum(values, first_only, options.max_size)) as tops:
            if first_only:
                for top in tops:
                    answer.add(self._bad(top))
                return
            total = 0
            for batch in _batches(tops, 1 if options.limit == 1 else 64):
                rows = self._alternatives(top_level, observed, values, batch)
                for top, row in zip(batch, rows, strict=True):
                    if options.factored:
                        total += self._add_row(top_level, top, row, observed, answer)
                        continue
                    for choice in self._choices(top, row, observed, top_level):
                        answer.add(self._bad(choice))
        answer.count = total if options.factored else None

    def _alternatives(
        self, top_level: TopLevel, observed: SignedObs, values: dict[int, bool], tops: Sequence[Top]
    ) -> Iterator[tuple[tuple[int, ...], ...]]:
        """Yield what may stand in for each member of each top-level diagnosis, if the others stay."""
        if top_level.can_simulate:
            yield from top_level.alternatives(values, tops)
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
            if replaced < 2 or top_level.can_simulate or self._explains(choice, observed):
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
        if not top_level.can_simulate and sum(len(alternatives) > 1 for alternatives in row) > 1:
            choices = list(self._choices(top, row, observed, top_level))
            if len(choices) < count:  # not a product: each is a row of its own
                for choice in choices:
                    answer.rows.append(tuple((self._component(gate),) for gate in choice))
                    answer.add(self._bad(choice))
                return len(choices)
        answer.rows.append(tuple(tuple(self._component(gate) for gate in gates) for gates in row))
        answer.add(self._bad(top))
        return count

    def _circuit_subset_minimal(self, observed: SignedObs, options: Options, answer: SearchState) -> None:
        self._clock.check()
        top_level, values = self._top_level(observed)
        known: list[Bad] = []
        size = 0
        if top_level.can_simulate:
            if top_level.all_healthy(values):
                answer.add(())
                return
            smaller: set[int] = set()
            for size in (1, 2):
                if options.max_size is not None and size > options.max_size:
                    break
                for top in top_level.small_subset_minimal(values, size, smaller):
                    bad = self._bad(top)
                    known.append(bad)
                    answer.add(bad)
                    if size == 1:
                        smaller.add(top[0])
            size = 3 if options.max_size is None else min(3, options.max_size + 1)
        self._layers(observed, NOTHING_SUPPOSED, options, answer, known, size)

    def _explains(self, gates: Sequence[int], observed: SignedObs) -> bool:
        """Ask the solver whether OBS is consistent when these gates are abnormal."""
        healthy = outside(self._health, mask_of(map(self._component, gates)))
        return self._oracle.sat([*healthy, *observed.numbers])

    def _component(self, gate: int) -> int:
        assert self._netlist is not None
        return self._netlist.gates[gate].component

    def _bad(self, gates: Sequence[int]) -> Bad:
        return tuple(sorted(map(self._component, gates)))

    # --- any model, by conflicts ------------------------------------------------------------------

    def _by_conflicts(
        self, observed: SignedObs, what_if: Supposed, options: Options, answer: SearchState
    ) -> None:
        forced = mask_of(what_if.abnormal)
        forced_size = len(what_if.abnormal)
        find_conflict = self._conflict_finder(observed, what_if, answer, WIDE_CONFLICT)
        search = HittingSets(find_conflict, NODE_BUDGET)
        known: list[Bad] = []
        size = 0
        try:
            while options.max_size is None or size + forced_size <= options.max_size:
                for mask in search.of_size(size):
                    bad = members(mask | forced)
                    known.append(bad)
                    answer.add(bad)
                if search.exhausted or (options.minimal == "cardinality" and known):
                    return
                size = max(size + 1, search.at_least)
            if search.any_more(len(self._health)):
                raise MinimumTooLarge
        except TooManyNodes:
            self._by_solver(observed, what_if, options, answer, known, size + forced_size)

    def _by_probability(
        self, observed: SignedObs, what_if: Supposed, options: Options, answer: SearchState
    ) -> None:
        forced = mask_of(what_if.abnormal)
        find_conflict = self._conflict_finder(observed, what_if, answer, widest=len(self._health))
        left_out = False
        order = by_probability(find_conflict, self.cnf.components, self.cnf.priors, self._clock)
        for mask in order:
            bad = members(mask | forced)
            if options.max_size is not None and len(bad) > options.max_size:
                left_out = True
            else:
                answer.add(bad)
        if left_out:
            raise MinimumTooLarge

    def _conflict_finder(
        self, observed: SignedObs, what_if: Supposed, answer: SearchState, widest: int
    ) -> Callable[[int], int | None]:
        """Return the question that hitting-set searches ask: a conflict outside these components, or None.

        Raises (the question):
            TooManyNodes: a conflict is wider than `widest`.
            NoDiagnosis: a conflict has no component.
        """
        forced = mask_of(what_if.abnormal)
        oracle, health = self._oracle, self._health
        tail = [*observed.numbers, *(-variable for variable in what_if.abnormal)]
        plain = what_if is NOTHING_SUPPOSED
        conflicts, known = self._conflicts, answer.known
        library = conflicts.applicable(observed) if plain else []

        def find_conflict(mask: int) -> int | None:
            for one in known:
                if not one.mask & mask:
                    return one.mask
            for one in library:
                if not one.mask & mask:
                    known.append(one)
                    return one.mask
            mask |= forced
            # OBS first: what was seen is then no consequence of health, so that cores stay near the fault
            if oracle.sat(tail + outside(health, mask)):
                if self.cnf.modes:
                    bad = members(mask)
                    answer.modes[bad] = self._modes_of(bad, oracle.model() or ())
                return None
            conflict: Known = conflicts.shrink(oracle, oracle.core() or (), observed, what_if)
            if not conflict.mask:
                raise NoDiagnosis
            if plain:
                conflicts.keep(conflict)
            known.append(conflict)
            if conflict.mask.bit_count() > widest:
                raise TooManyNodes
            return conflict.mask

        return find_conflict

    # --- any model, by SAT ------------------------------------------------------------------------

    @cached_property
    def _guided(self) -> CoreGuided:
        cnf = self.cnf
        return CoreGuided(cnf.clauses, len(cnf.components), cnf.variables, self._clock, self.solver)

    @cached_property
    def _layered(self) -> Layered:
        cnf = self.cnf
        return Layered(cnf.clauses, len(cnf.components), cnf.variables, self._clock, self._asked_solver)

    def _by_solver(
        self,
        observed: SignedObs,
        what_if: Supposed,
        options: Options,
        answer: SearchState,
        known: list[Bad],
        size: int,
    ) -> None:
        """Go on from the diagnoses known, all of those below `size` and perhaps some of that size."""
        assumptions = [*observed.numbers, *what_if.numbers]
        forced = len(what_if.abnormal)
        room = None if options.max_size is None else options.max_size - forced
        if room is not None and room < 0:
            raise MinimumTooLarge
        minima = self._guided.minimum(
            assumptions, max(0, size - forced), room, what_if.healthy | what_if.abnormal
        )
        if options.minimal == "cardinality":
            any_at_all = False
            already = set(known)
            with closing(minima):
                for found in minima:
                    any_at_all = True
                    bad = tuple(sorted([*found, *what_if.abnormal]))
                    if bad not in already:
                        self._note_modes(bad, assumptions, answer)
                        answer.add(bad)
            if not any_at_all:
                raise NoDiagnosis
            return
        if not known:
            with closing(minima):
                first = next(minima, None)
            if first is None:
                raise NoDiagnosis
            size = len(first) + forced
        self._layers(observed, what_if, options, answer, known, size)

    def _layers(
        self,
        observed: SignedObs,
        what_if: Supposed,
        options: Options,
        answer: SearchState,
        known: list[Bad],
        size: int,
    ) -> None:
        """Enumerate by size from `size` on."""
        assumptions = [*observed.numbers, *what_if.numbers]
        blocked: list[Sequence[int]] = list(known)
        with self._layered.search(assumptions, blocked) as search:
            while options.max_size is None or size <= options.max_size:
                for abnormal, model in search.of_size(size):
                    bad = tuple(abnormal)
                    blocked.append(bad)
                    if self.cnf.modes:
                        answer.modes[bad] = self._modes_of(bad, model)
                    answer.add(bad)
                if not self._any_more(assumptions, blocked):
                    return
                size += 1
        if self._any_more(assumptions, blocked):
            raise MinimumTooLarge

    def _note_modes(self, bad: Bad, assumptions: list[int], answer: SearchState) -> None:
        if not self.cnf.modes:
            return
        healthy = [variable for variable in self._health if variable not in bad]
        if self._oracle.sat([*healthy, *assumptions]):
            answer.modes[bad] = self._modes_of(bad, self._oracle.model() or ())

    def close(self) -> None:
        """Free the solvers."""
        super().close()
        for top_level in self._top_levels.values():
            top_level.close()
        self._top_levels.clear()
        for name in ("_guided", "_layered"):
            if name in self.__dict__:
                self.__dict__.pop(name).close()


def _batches(tops: Iterator[Top], size: int) -> Iterator[list[Top]]:
    """Yield the top-level diagnoses in lists that grow, so that not many more are fetched than are wanted."""
    batch: list[Top] = []
    for top in tops:
        batch.append(top)
        if len(batch) >= size:
            yield batch
            size, batch = min(4 * size, 1_024), []
    if batch:
        yield batch
