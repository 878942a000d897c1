"""The default engine: SAT with one persistent solver a model and observations as assumptions.

Which search answers depends on the model and the question; all are exact, and each hands over to the next:

    a circuit, nothing supposed    circuits/by_structure.py    simulation, top-level diagnoses, cones
    any other circuit              by_solver.py                core-guided, then size by size
    any other model                by_conflicts.py             conflicts and hitting sets, part by part

Cone reasoning needs a weak fault model whose clauses are those of a circuit; where they are not (fault
modes, AB in a premise, rules that are no gates, components supposed healthy or abnormal), it is off by
itself.

What a circuit's structure takes to be found pays off after many questions. Those for one diagnosis of minimum
cardinality go to a solver of all clauses, kept warm, until they have taken so much time there that the
structure adds little: however many are asked, all of them take at most 1.3 times what they take there. One
that takes long there goes on by the structure, and whoever knows that many will come can have it at once
(`prepare`). Where finding it would take much of the time
that is left, any question goes to the solver: it has the smallest diagnoses sooner.

`limit` diagnoses are always the smallest ones: order of size is part of the answer, so that no faster,
unordered enumeration takes its place. Where there is no bound on the size, the time-out is what ends it.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from functools import cached_property
from time import thread_time

from robomend.diagnosis.base import BaseEngine, refuse_order_of_probability
from robomend.diagnosis.by_conflicts import ByConflicts
from robomend.diagnosis.by_solver import BySolver
from robomend.diagnosis.circuits.by_structure import ByStructure
from robomend.diagnosis.circuits.netlist import recover
from robomend.diagnosis.circuits.traces import Walk
from robomend.diagnosis.observed import NOTHING_SUPPOSED, SignedObs, Supposed
from robomend.diagnosis.oracle import OutOfTime
from robomend.diagnosis.result import Options
from robomend.diagnosis.search import SearchState
from robomend.model.cnf import HealthCnf
from robomend_client.literals import Literal

MAX_GATES = 200_000

STRUCTURE_S = 1e-3
STRUCTURE_GATE_S = 40e-6
"""What the structure takes, and for each gate, of the thread's own time."""

PAYS_AFTER = 3.3
"""Times as much was spent on the whole circuit when the structure is looked for: 30 % is the most it adds."""

AT_ONCE = 0.25
"""Of that, a question without the structure takes at most: times on the whole circuit have a long tail."""

HURRIED_GATE_S = 200e-6
"""With less time than this for each gate the structure is not looked for; to find it and to compile what
searches it takes a quarter of that."""


class SatEngine(BaseEngine):
    """See the module. One call at a time; `interrupt` may come from any thread."""

    name = "sat"

    def __init__(self, cnf: HealthCnf, *, solver: str | None = None) -> None:
        super().__init__(cnf, solver=solver)
        consistency = self._consistency
        self._by_solver = BySolver(consistency, None if solver is None else self.solver)
        self._by_conflicts = ByConflicts(consistency, self._conflicts, self._by_solver)
        self._spent_s = 0.0  # on questions that went to the solver for want of the structure

    @cached_property
    def _by_structure(self) -> ByStructure | None:
        """The search of a circuit, None where the clauses are not those of one."""
        small_enough = self.cnf.circuit and len(self.cnf.components) <= MAX_GATES
        netlist = recover(self.cnf, self._clock.check) if small_enough else None
        return None if netlist is None else ByStructure(self._consistency, netlist, self._by_solver)

    def _refuse(self, options: Options) -> None:
        if options.order == "probability":
            refuse_order_of_probability(self.cnf, options)

    def _search(self, observed: SignedObs, what_if: Supposed, options: Options, answer: SearchState) -> None:
        if options.order == "probability":
            self._by_conflicts.most_probable_first(observed, what_if, options, answer)
        elif not self.cnf.circuit:
            self._by_conflicts.list_all(observed, what_if, options, answer)
        elif self._at_once(observed, what_if, options, answer):
            return
        elif what_if is not NOTHING_SUPPOSED or self._hurried() or self._by_structure is None:
            self._by_solver.go_on(observed, what_if, options, answer, [], 0)
        elif options.minimal == "cardinality":
            self._by_structure.minimum(observed, options, answer)
        else:
            self._by_structure.subset_minimal(observed, options, answer)

    def prepare(self, observations: Iterable[Literal]) -> None:
        """Find a circuit's structure now, as it looks from these sensors: many questions will follow.

        Of other models nothing is to be found.
        """
        observed = self._reader.read(tuple(observations))
        self._clock.start(None)
        if self.cnf.circuit and self._by_structure is not None:
            self._by_structure.prepare(observed)

    def _at_once(self, observed: SignedObs, what_if: Supposed, options: Options, answer: SearchState) -> bool:
        """Answer on the whole circuit while the structure does not pay; return whether that was done."""
        if "_by_structure" in self.__dict__ or self._hurried():
            return False
        if options.limit != 1 or options.minimal == "subset" or options.factored:
            return False
        structure_s = STRUCTURE_S + STRUCTURE_GATE_S * len(self.cnf.components)
        if self._spent_s > PAYS_AFTER * structure_s:
            return False
        began = thread_time()
        try:
            with self._clock.at_most(AT_ONCE * structure_s):
                self._by_solver.go_on(observed, what_if, options, answer, [], 0)
        except OutOfTime:
            self._clock.check()
            return False
        finally:
            self._spent_s += thread_time() - began
        return True

    def _walk(self, observed: SignedObs, what_if: Supposed, abnormal: Sequence[Iterable[int]]) -> Walk | None:
        """Simulate where the structure was found for the search."""
        structure = self.__dict__.get("_by_structure")
        if structure is None or what_if is not NOTHING_SUPPOSED:
            return None
        found: Walk = structure.walk(observed, abnormal)  # the base class does not know what it is
        return found

    def _hurried(self) -> bool:
        """Whether finding the structure would take a quarter of the time that is left, or more."""
        found = "_by_structure" in self.__dict__
        return not found and self._clock.left_s < HURRIED_GATE_S * len(self.cnf.components)

    def close(self) -> None:
        """Free the solvers."""
        super().close()
        self._by_solver.close()
        if (by_structure := self.__dict__.pop("_by_structure", None)) is not None:
            by_structure.close()
