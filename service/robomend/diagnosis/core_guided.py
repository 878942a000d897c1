"""Minimum-cardinality diagnoses by a core-guided search on a persistent solver.

Suppose that every candidate is healthy. Each unsatisfiable core says that at least one of its members is
not, so pay for one and *relax* the core: suppose that no second one is (PMRES):

    suppose all healthy ──► easy core? pay 1, stop supposing its members ──► easy core? …
                              │ no
                              ▼
        relax these cores, ask in earnest ──► core: pay 1, relax it, again
                              │ sat
                              ▼
        minimum; block it, keep the suppositions, ask again: the other diagnoses of this size

A core is relaxed by a tree over it: a node knows whether a member below it is abnormal, and it is supposed
that not both of its branches have one. So many nodes break this as there are abnormal members, less one.

Cores that are known beforehand (`cores`) cost nothing, and as long as others come by propagation alone, they
cost some 20 µs each; neither are relaxed yet: where a diagnosis is known (`incumbent`), half of the questions
need no more. The first answer that is not such a core ends this. Then each core is relaxed, so that what
the suppositions allow costs what was paid, and the first model is a minimum. Models on the way would be
dear: most of a model is deciding what does not matter.

Cores are taken as they come: making them smaller costs more calls than it saves (measured: 5-20 × on
ISCAS-85). The solver outlives the search. What a search adds is guarded by a literal that is off from its end
on: the clauses say nothing then, and vanish soon, with what was learnt from them, and the variables of the
trees serve the next search. Left behind, they would have to be decided in each later model, which took as
long as all the rest of it.

Sources:
    N. Narodytska, F. Bacchus. Maximum satisfiability using core-guided MaxSAT resolution. AAAI 2014 (there
        the tree is a chain).
    A. Ignatiev, A. Morgado, J. Marques-Silva. RC2: an efficient MaxSAT solver. JSAT 11, 2019.
"""

from __future__ import annotations

from collections.abc import Generator, Iterable, Iterator, Sequence

from robomend.diagnosis.oracle import Deadline, Oracle
from robomend.model.cnf import Clause

RESET_SEARCHES = 1_000
"""Searches after which the solver is built anew: each leaves a variable behind."""

DROPPED_TOGETHER = 8
"""Searches whose clauses go at once: the solver looks through all that it has, which takes a tenth of an
answer. Until then their guards are assumed to be off."""

CORES_KEPT = 100

EASY_CONFLICTS = 10
EASY_PROPAGATIONS = 0.9
"""Of an easy core, the latter for each variable of the model: beyond it, most are decisions."""


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
        self.all_supposed: dict[int, None] = dict.fromkeys(range(1, candidates + 1))
        self.variables = variables
        self._clock = clock
        self._name = solver
        self._oracle: Oracle | None = None
        self._top = variables
        self._searches = 0
        self._running = 0
        self._pool: list[int] = []  # variables of the trees
        self._lent = 0  # so many of them are in use
        # The last search's cores with what they rest on, those that speak of nothing but the model.
        self.met: list[list[int]] = []
        self.paid = 0  # by the last search: no diagnosis has fewer members
        self.best: list[int] | None = None  # the smallest that it has come upon, which may not be the minimum
        self._over: list[int] = []  # as they are assumed: guards of searches whose clauses are still there

    def minimum(
        self,
        assumptions: list[int],
        at_least: int = 0,
        at_most: int | None = None,
        fixed: frozenset[int] = frozenset(),
        incumbent: list[int] | None = None,
        cores: Iterable[Sequence[int]] = (),
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
            cores: candidates of which one at least is abnormal, as is known already. Those that share a
                member with an earlier one are left to the search.

        Raises:
            MinimumTooLarge: the minimum is larger than `at_most`.
            OutOfTime: what was yielded before stays true.
        """
        search = _CoreSearch(
            self._fresh_or_warm(), self, [*self._over, *assumptions], (at_least, at_most), fixed
        )
        self._running += 1
        self.met = search.met
        search.best = incumbent
        try:
            yield from search.run(incumbent, cores)
        finally:
            self.paid, self.best = max(at_least, search.paid), search.best
            search.retire()
            self._running -= 1
            if not self._running:
                self._lent = 0

    def new_guard(self) -> int:
        """Return a variable that was never used, to hold the clauses of one search."""
        self._searches += 1
        self._top += 1
        return self._top

    def new_variables(self, count: int) -> Iterator[int]:
        """Return variables that no clause of a search that runs has met."""
        first, self._lent = self._lent, self._lent + count
        while len(self._pool) < self._lent:
            self._top += 1
            self._pool.append(self._top)
        return iter(self._pool[first : self._lent])

    def retired(self, guard: int, oracle: Oracle) -> None:
        """Note that a search is over; its clauses are dropped with those of some others.

        Args:
            oracle: where they are; perhaps it was closed.
        """
        if oracle is not self._oracle:
            return
        self._over.append(-guard)
        if len(self._over) == DROPPED_TOGETHER:
            oracle.add_all([(literal,) for literal in self._over])
            self._over.clear()

    def _fresh_or_warm(self) -> Oracle:
        if self._oracle is not None and self._searches > RESET_SEARCHES and not self._running:
            self.close()
        if self._oracle is None:
            self._oracle = Oracle(self._clauses, self._clock, self._name)
            self._top = self.variables
            self._searches = 0
            self._pool.clear()
            self._over.clear()
            self._lent = 0
        return self._oracle

    def close(self) -> None:
        """Free the solver."""
        if self._oracle is not None:
            self._oracle.close()
            self._oracle = None


class _CoreSearch:
    """One search: the suppositions, and what was paid."""

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
        self._fixed = fixed
        self._supposed = owner.all_supposed.copy()  # in the order in which the solver is told
        for candidate in fixed:
            del self._supposed[candidate]
        self.paid = 0
        self.best: list[int] | None = None
        self._guard = 0
        self.met: list[list[int]] = []

    def run(self, incumbent: list[int] | None, cores: Iterable[Sequence[int]]) -> Iterator[list[int]]:
        """Yield the minimum, then, if it is not the incumbent, the others of its size."""
        pending: list[Sequence[int]] = []  # cores that are not relaxed
        known = iter(cores)
        easy = True
        while True:
            core = next(filter(self._all_supposed, known), None)
            sat: bool | None = False
            if core is None:
                sat = self._easily_sat() if easy else self._oracle.sat([*self._assumptions, *self._supposed])
            if sat is False:
                core = self._pay(core or self._failed())
                if not core:
                    return
                if self._at_most is not None and self.paid > self._at_most:
                    raise MinimumTooLarge
                if incumbent is not None and self.paid >= len(incumbent):
                    yield incumbent
                    return
                if easy:
                    pending.append(core)
                else:
                    self._relax(core)
                continue
            if sat:
                found = self._abnormal()
                if self.best is None or len(found) < len(self.best):
                    self.best = found
                if not easy or len(found) <= max(self.paid, self._at_least):
                    break  # the model costs no more than must be paid
                if incumbent is not None and len(found) < len(incumbent):
                    incumbent = found
            easy = False
            while pending:
                self._relax(pending.pop())
        if self._at_most is not None and len(found) > self._at_most:
            raise MinimumTooLarge
        yield found
        if not found:
            return
        # With all cores relaxed, what the suppositions allow costs what was paid. Once they are satisfiable
        # again, paid = size and each model is another minimum; a core beyond that says that there is none.
        for core in pending:
            self._relax(core)
        size = len(found)
        guard = self._guarded()
        while True:
            self._oracle.add([-guard, *found])  # one of them is healthy
            while not self._oracle.sat([*self._assumptions, *self._supposed]):
                core = self._pay(self._failed())
                if not core or self.paid > size:
                    return
                self._relax(core)
            found = self._abnormal()
            yield found

    def _easily_sat(self) -> bool | None:
        propagations = int(EASY_PROPAGATIONS * self._owner.variables)
        return self._oracle.quickly([*self._assumptions, *self._supposed], EASY_CONFLICTS, propagations)

    def _abnormal(self) -> list[int]:
        model = self._oracle.model() or []
        abnormal = [-literal for literal in model[: self._owner.candidates] if literal < 0]
        return [one for one in abnormal if one not in self._fixed] if self._fixed else abnormal

    def _all_supposed(self, core: Iterable[int]) -> bool:
        return all(map(self._supposed.__contains__, core))

    def _failed(self) -> list[int]:
        """Return the suppositions of which the last answer says that not all can hold."""
        core = self._oracle.core() or []
        last = self._owner.variables
        if len(self.met) < CORES_KEPT and core and max(core) <= last and min(core) >= -last:
            self.met.append(core)
        return [literal for literal in core if literal in self._supposed]

    def _pay(self, core: Sequence[int]) -> Sequence[int]:
        """Take the core out of the suppositions, and pay for one of its members."""
        for literal in core:
            del self._supposed[literal]
        self.paid += 1
        return core

    def _guarded(self) -> int:
        """Return the literal that holds the clauses of this search; it is supposed from the first one on."""
        if not self._guard:
            self._guard = self._owner.new_guard()
            self._assumptions = [self._guard, *self._assumptions]
        return self._guard

    def _relax(self, core: Sequence[int]) -> None:
        """Suppose that no second member of the core is abnormal, one supposition less than it has members."""
        if len(core) < 2:
            return
        off, supposed = -self._guarded(), self._supposed
        new = self._owner.new_variables(2 * len(core) - 3)  # two a node, but the root needs one
        level: Sequence[int] = core  # literals: a member is healthy, or all below a node are
        clauses: list[tuple[int, ...]] = []
        while len(level) > 2:
            above = [level[-1]] if len(level) % 2 else []
            for one, other, both, either in zip(level[::2], level[1::2], new, new, strict=False):
                clauses += (one, other, both, off), (one, either, off), (other, either, off)
                supposed[-both] = None
                above.append(-either)
            level = above
        both = next(new)
        clauses.append((*level, both, off))
        supposed[-both] = None
        self._oracle.add_all(clauses)

    def retire(self) -> None:
        """Let the clauses of this search, and what was learnt from them, be dropped."""
        if self._guard:
            self._owner.retired(self._guard, self._oracle)
