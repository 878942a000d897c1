"""Diagnoses of any model by SAT: core-guided to the minimum, then size by size.

It takes over where conflicts are too many or too wide for a search of hitting sets, and where a circuit is no
netlist. The minimum comes first (core_guided.py), all of its size if they are wanted; larger subset-minimal
diagnoses follow size by size (Layered), until the solver says that there is none besides those found.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import closing
from functools import cached_property

from pysat.card import ITotalizer

from robomend.diagnosis.consistency import Consistency
from robomend.diagnosis.core_guided import CoreGuided, MinimumTooLarge
from robomend.diagnosis.observed import SignedObs, Supposed
from robomend.diagnosis.oracle import Deadline, Oracle
from robomend.diagnosis.result import Options
from robomend.diagnosis.search import Bad, NoDiagnosis, SearchState
from robomend.model.cnf import Clause

# --- subset-minimal diagnoses in order of size: a solver is asked for at most k abnormal ones, k = 0, 1, 2, …
#
# Each model found is blocked together with its supersets. With all smaller diagnoses blocked, a model with
# at most k abnormal components has exactly k, and is minimal.
#
# The bound k is one native constraint of a MiniCard-type solver over the health literals and some spare
# ones:
#
#     at most K of { ab(c1), …, ab(cn), spare1, …, spareK }        suppose K - k spares: at most k remain
#
# so that changing k is a change of assumptions. Other solvers get a totalizer instead.
#
# Source: M. Liffiton, J. Maglalang. A cardinality solver: more expressive constraints for free. SAT 2012
# (MiniCard).

NATIVE = ("minicard", "gluecard3", "gluecard4")
FIRST_BOUND = 4
RESET_CLAUSES = 20_000
"""Retired blocking clauses that are tolerated before the solver is built anew."""


class Layered:
    """A persistent solver for one model; variables 1 … components are the health."""

    def __init__(
        self, clauses: Sequence[Clause], components: int, variables: int, clock: Deadline, solver: str | None
    ) -> None:
        self._clauses = clauses
        self._components = components
        self._variables = variables
        self._clock = clock
        self._name = solver or "minicard"
        self._oracle: Oracle | None = None
        self._bound = -1
        self._spares: list[int] = []
        self._totalizer: ITotalizer | None = None
        self._top = variables
        self._retired = 0

    def search(self, assumptions: list[int], known: Sequence[Sequence[int]]) -> LayeredSearch:
        """Begin a search; `known` diagnoses (lists of abnormal health variables) are blocked at once."""
        if self._retired > max(RESET_CLAUSES, len(self._clauses)):
            self.close()
        self.oracle(0)
        return LayeredSearch(self, assumptions, known)

    def oracle(self, size: int) -> Oracle:
        """Return the solver, with a bound of at least this size in place: a new one where that needs it."""
        if self._oracle is not None and (size <= self._bound or self._name not in NATIVE):
            if size > self._bound:
                self._raise_totalizer(size)
            return self._oracle
        if self._oracle is not None:
            self.close()
        self._oracle = Oracle(self._clauses, self._clock, self._name)
        self._top = self._variables
        self._bound = min(self._components, max(FIRST_BOUND, 2 * size))
        abnormal = [-variable for variable in range(1, self._components + 1)]
        if self._name in NATIVE:
            self._spares = [self.new_variable() for _ in range(self._bound)]
            self._oracle.at_most([*abnormal, *self._spares], self._bound)
        else:
            self._totalizer = ITotalizer(lits=abnormal, ubound=self._bound, top_id=self._top)
            self._top = max(self._top, self._totalizer.top_id)
            for clause in self._totalizer.cnf.clauses:
                self._oracle.add(clause)
        return self._oracle

    def at_most(self, size: int) -> list[int]:
        """Return the assumptions that allow at most so many abnormal components."""
        if size >= self._components:
            return []
        if self._totalizer is not None:
            return [-self._totalizer.rhs[size]]
        return self._spares[: self._bound - size]

    def _raise_totalizer(self, size: int) -> None:
        totalizer, oracle = self._totalizer, self._oracle
        if totalizer is None or oracle is None or self._bound >= self._components:
            return
        self._bound = min(self._components, 2 * size)
        totalizer.increase(ubound=self._bound, top_id=self._top)
        self._top = max(self._top, totalizer.top_id)
        if totalizer.nof_new:
            for clause in totalizer.cnf.clauses[-totalizer.nof_new :]:
                oracle.add(clause)

    def new_variable(self) -> int:
        """Return a variable that nothing else uses."""
        self._top += 1
        return self._top

    @property
    def components(self) -> int:
        """How many components there are."""
        return self._components

    def retire(self, guard: int, clauses: int) -> None:
        """Drop the clauses behind a guard."""
        if self._oracle is not None:
            self._oracle.add([-guard])
            self._retired += clauses

    def close(self) -> None:
        """Free the solver."""
        if self._oracle is not None:
            self._oracle.close()
            self._oracle = None
        if self._totalizer is not None:
            self._totalizer.delete()
            self._totalizer = None
        self._bound = -1
        self._retired = 0


class LayeredSearch:
    """One search. Use as a context, so that its blocking clauses are dropped."""

    def __init__(self, owner: Layered, assumptions: list[int], known: Sequence[Sequence[int]]) -> None:
        self._owner = owner
        self._assumptions = assumptions
        self._blocked: list[Sequence[int]] = list(known)
        self._oracle = owner.oracle(0)
        self._guard = 0
        self._install()

    def __enter__(self) -> LayeredSearch:
        return self

    def __exit__(self, *exception: object) -> None:
        self._owner.retire(self._guard, len(self._blocked))

    def _install(self) -> None:
        self._guard = self._owner.new_variable()
        for diagnosis in self._blocked:
            self._oracle.add([-self._guard, *diagnosis])

    def of_size(self, size: int) -> Iterator[tuple[list[int], list[int]]]:
        """Yield (abnormal health variables, model) of each minimal diagnosis of this size.

        Call with the smallest size first.

        Raises:
            OutOfTime: what was yielded before stays true.
        """
        owner = self._owner
        oracle = owner.oracle(size)
        if oracle is not self._oracle:  # a larger bound needed a new solver
            self._oracle = oracle
            self._install()
        while oracle.sat([*self._assumptions, self._guard, *owner.at_most(size)]):
            model = oracle.model() or []
            abnormal = [-literal for literal in model[: owner.components] if literal < 0]
            self._blocked.append(abnormal)
            oracle.add([-self._guard, *abnormal])
            yield abnormal, model


class BySolver:
    """See the module.

    Args:
        asked_solver: the solver for sizes, None: the best for that.
    """

    def __init__(self, consistency: Consistency, asked_solver: str | None) -> None:
        self._consistency = consistency
        self._cnf = consistency.cnf
        self._clock = consistency.clock
        self._asked_solver = asked_solver

    @cached_property
    def _guided(self) -> CoreGuided:
        cnf = self._cnf
        return CoreGuided(
            cnf.clauses, len(cnf.components), cnf.variables, self._clock, self._consistency.solver
        )

    @cached_property
    def _layered(self) -> Layered:
        cnf = self._cnf
        return Layered(cnf.clauses, len(cnf.components), cnf.variables, self._clock, self._asked_solver)

    def go_on(
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
        if room is not None:
            if not known and not self._consistency.any_more(assumptions, known):
                raise NoDiagnosis  # nor are there larger ones
            if room < 0:
                raise MinimumTooLarge
        minima = self._guided.minimum(
            assumptions, max(0, size - forced), room, what_if.healthy | what_if.abnormal
        )
        if options.minimal == "cardinality" or not known:
            already = set(known)
            with closing(minima):
                try:
                    for found in minima:
                        bad = tuple(sorted([*found, *what_if.abnormal]))
                        if bad not in already:
                            if self._cnf.modes:
                                answer.modes[bad] = self._consistency.modes_behind(bad, assumptions)
                            answer.add(bad)
                            known.append(bad)
                finally:
                    answer.cores = self._guided.met
                    answer.at_least = max(answer.at_least, self._guided.paid + forced)
                    if (best := self._guided.best) is not None:
                        answer.best = tuple(sorted([*best, *what_if.abnormal]))
            if not known:
                raise NoDiagnosis
            if options.minimal == "cardinality":
                return
            size = len(known[0]) + 1
        self.layers(observed, what_if, options, answer, known, size)

    def layers(
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
                    if self._cnf.modes:
                        answer.modes[bad] = self._consistency.modes_of(bad, model)
                    answer.add(bad)
                if not self._consistency.any_more(assumptions, blocked):
                    return
                size += 1
        if self._consistency.any_more(assumptions, blocked):
            raise MinimumTooLarge

    def close(self) -> None:
        """Free the solvers."""
        for name in ("_guided", "_layered"):
            if name in self.__dict__:
                self.__dict__.pop(name).close()
