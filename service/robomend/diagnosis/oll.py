"""Minimum-cardinality diagnoses by a core-guided search (OLL) on a persistent solver.

Suppose that every candidate is healthy. Each unsatisfiable core says that at least one of its members is
not, so pay for one and allow one; a totalizer over the core says what a second would cost:

    suppose all healthy ──► sat? no ──► core: pay 1, stop supposing its members ──► sat? …
                              │ yes
                              ▼
        cost of the model = paid?  no ──► totalizers over the cores, suppose "at most one of each", again
                              │ yes
                              ▼
        minimum; block it, keep the suppositions, ask again: the other diagnoses of this size

The payments are a lower bound and the model's own cost an upper one, so most searches end before the first
totalizer. Cores are taken as they come: making them smaller costs more calls than it saves (measured: 5-20 ×
on ISCAS-85).

The solver outlives the search. What a search adds is either implied definitions or guarded by a literal that
is dropped afterwards; when such leftovers outweigh the model, the solver is built anew.

Sources:
    A. Morgado, C. Dodaro, J. Marques-Silva. Core-guided MaxSAT with soft cardinality constraints. CP 2014.
    A. Ignatiev, A. Morgado, J. Marques-Silva. RC2: an efficient MaxSAT solver. JSAT 11, 2019.
"""

from __future__ import annotations

from collections.abc import Generator, Iterator, Sequence

from pysat.card import ITotalizer

from robomend.diagnosis.oracle import Deadline, Oracle
from robomend.model.cnf import Clause

RESET_CLAUSES = 500
"""Leftover clauses that are tolerated, or twice the model's own if those are more: they slow each question
down, and a solver is built in the time of one or two. With 20,000, c499 and c1355 took twice as long."""


class MinimumTooLarge(Exception):
    """The minimum is larger than the size that was asked for."""


class CoreGuided:
    """A persistent search over one set of clauses and candidates.

    Args:
        clauses: variables 1 … candidates are the health of the candidates, true when healthy.
        candidates: how many there are.
        variables: the highest variable.
    """

    def __init__(
        self,
        clauses: Sequence[Clause] | Sequence[list[int]],
        candidates: int,
        variables: int,
        clock: Deadline,
        solver: str,
    ) -> None:
        self._clauses = clauses
        self.candidates = candidates
        self._variables = variables
        self._clock = clock
        self._name = solver
        self._oracle: Oracle | None = None
        self.top = variables
        self._leftover = 0

    def minimum(
        self,
        assumptions: list[int],
        at_least: int = 0,
        at_most: int | None = None,
        fixed: frozenset[int] = frozenset(),
        incumbent: list[int] | None = None,
    ) -> Generator[list[int], None, None]:
        """Yield the minimum-cardinality diagnoses as lists of abnormal candidates, one after the other.

        Nothing is yielded when there is none at all.

        Args:
            assumptions: OBS.
            at_least: a lower bound that is known already.
            at_most: give up when the minimum is known to be larger.
            fixed: candidates whose health the assumptions fix already; they are neither supposed nor counted.
            incumbent: a diagnosis that is known already. It is yielded, alone, as soon as so much is paid
                that there can be nothing smaller.

        Raises:
            MinimumTooLarge: the minimum is larger than `at_most`.
            OutOfTime: what was yielded before stays true.
        """
        search = _CoreSearch(self._fresh_or_warm(), self, assumptions, (at_least, at_most), fixed)
        try:
            yield from search.run(incumbent)
        finally:
            self._leftover += search.retire()

    def new_variable(self) -> int:
        """Return a variable that nothing else uses."""
        self.top += 1
        return self.top

    def _fresh_or_warm(self) -> Oracle:
        if self._oracle is not None and self._leftover > max(RESET_CLAUSES, 2 * len(self._clauses)):
            self.close()
        if self._oracle is None:
            self._oracle = Oracle(self._clauses, self._clock, self._name)
            self.top = self._variables
            self._leftover = 0
        return self._oracle

    def close(self) -> None:
        """Free the solver."""
        if self._oracle is not None:
            self._oracle.close()
            self._oracle = None


class _CoreSearch:
    """One search: the suppositions, what was paid, the totalizers."""

    def __init__(
        self,
        oracle: Oracle,
        owner: CoreGuided,
        assumptions: list[int],
        bounds: tuple[int, int | None],
        fixed: frozenset[int],
    ) -> None:
        self._oracle = oracle
        self._owner = owner
        self._assumptions = assumptions
        self._at_least, self._at_most = bounds
        self._candidates = [c for c in range(1, owner.candidates + 1) if c not in fixed]
        self._supposed: dict[int, tuple[ITotalizer, int] | None] = dict.fromkeys(self._candidates)
        self._totalizers: list[ITotalizer] = []
        self._paid = 0
        self._added = 0
        self._guard = 0

    def run(self, incumbent: list[int] | None) -> Iterator[list[int]]:
        """Yield the minimum, then, if it is not the incumbent, the others of its size."""
        pending: list[list[int]] = []
        found: list[int] = []
        while True:
            while not self._oracle.sat([*self._assumptions, *self._supposed]):
                core = self._pay()
                if not core:
                    return
                if self._at_most is not None and self._paid > self._at_most:
                    raise MinimumTooLarge
                if incumbent is not None and self._paid >= len(incumbent):
                    yield incumbent
                    return
                pending.append(core)
            found = self._abnormal()
            if len(found) <= max(self._paid, self._at_least):
                break  # the model costs no more than must be paid
            if incumbent is not None and len(found) < len(incumbent):
                incumbent = found
            self._relax(pending)
            pending = []
        if self._at_most is not None and len(found) > self._at_most:
            raise MinimumTooLarge
        yield found
        if not found:
            return
        # With all cores relaxed, what the suppositions allow costs what was paid. Once they are satisfiable
        # again, paid = size and each model is another minimum; a core beyond that says that there is none.
        self._relax(pending)
        size = len(found)
        self._guard = self._owner.new_variable()
        while True:
            self._oracle.add([-self._guard, *found])  # one of them is healthy
            self._added += 1
            while not self._oracle.sat([*self._assumptions, self._guard, *self._supposed]):
                core = self._pay()
                if not core or self._paid > size:
                    return
                self._relax([core])
            found = self._abnormal()
            yield found

    def _abnormal(self) -> list[int]:
        model = self._oracle.model() or []
        return [candidate for candidate in self._candidates if model[candidate - 1] < 0]

    def _pay(self) -> list[int]:
        """Take the core of the last answer out of the suppositions, and pay for one of its members."""
        core = [literal for literal in self._oracle.core() or () if literal in self._supposed]
        for literal in core:
            totalizer = self._supposed.pop(literal)
            if totalizer is not None:
                self._allow_one_more(*totalizer)
        self._paid += 1
        return core

    def _allow_one_more(self, totalizer: ITotalizer, allowed: int) -> None:
        """The core says that more than `allowed` of its inputs are abnormal: suppose at most one more."""
        if allowed + 1 >= len(totalizer.lits):
            return
        if allowed + 1 >= len(totalizer.rhs):
            totalizer.increase(ubound=allowed + 1, top_id=self._owner.top)
            self._owner.top = max(self._owner.top, totalizer.top_id)
            if totalizer.nof_new:
                self._define(totalizer.cnf.clauses[-totalizer.nof_new :])
        self._supposed[-totalizer.rhs[allowed + 1]] = (totalizer, allowed + 1)

    def _relax(self, cores: list[list[int]]) -> None:
        """Count the abnormal members of each core, and suppose that there is only one."""
        for core in cores:
            if len(core) == 1:
                continue
            totalizer = ITotalizer(lits=[-literal for literal in core], ubound=1, top_id=self._owner.top)
            self._owner.top = max(self._owner.top, totalizer.top_id)
            self._define(totalizer.cnf.clauses)
            self._supposed[-totalizer.rhs[1]] = (totalizer, 1)
            self._totalizers.append(totalizer)

    def _define(self, clauses: list[list[int]]) -> None:
        for clause in clauses:
            self._oracle.add(clause)
        self._added += len(clauses)

    def retire(self) -> int:
        """Drop the guard and the totalizers' memory; return how many clauses stay behind in the solver."""
        if self._guard:
            self._oracle.add([-self._guard])
        for totalizer in self._totalizers:
            totalizer.delete()
        return self._added
