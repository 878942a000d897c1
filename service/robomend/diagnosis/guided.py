"""Hitting sets of a growing family of conflicts: the cheapest first, or any minimal one fast.

`hitting.py` searches depth-first and is the fastest for the few small diagnoses of a robot. It grows with the
number of sets below the answer, though, so that diagnoses of seven gates, or weights instead of sizes, need
another way. Here each component is a variable, each conflict a clause, each diagnosis a blocking clause:

    AnyHittingSets        a model, made minimal: quick, in no particular order
    CheapestHittingSets   in order of cost, core-guided: suppose that nothing is chosen; each core says
                          that some weight must be paid, so pay it, and let a totalizer say what more
                          would cost (OLL)

Both return minimal hitting sets. A minimal hitting set of known conflicts that is consistent is a minimal
diagnosis: each proper subset misses one of those conflicts.

Weights are integers here; `ranking.by_probability` makes them of priors. Stratification: the dear
components are supposed unchosen first and the cheap ones later, so that the first cores carry much weight.

Sources:
    A. Morgado, C. Dodaro, J. Marques-Silva. Core-guided MaxSAT with soft cardinality constraints. CP 2014.
    C. Ansotegui, M. L. Bonet, J. Gabas, J. Levy. Improving SAT-based weighted MaxSAT solvers. CP 2012.
    E. Moreno-Centeno, R. Karp. The implicit hitting set approach. OR 61(2), 2013.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from pysat.card import ITotalizer

from robomend.diagnosis.masks import bits
from robomend.diagnosis.oracle import Deadline, Oracle


def made_minimal(mask: int, conflicts: Sequence[int]) -> int:
    """Return a minimal hitting set inside one that hits all `conflicts`."""
    for bit in bits(mask):
        without = mask & ~(1 << bit)
        if all(conflict & without for conflict in conflicts):
            mask = without
    return mask


class AnyHittingSets:
    """Minimal hitting sets in no particular order; bit i is component i.

    A model is made minimal by asking the solver to spare one more component, again and again. Leaving out
    by hand what the conflicts do not need is cheaper but keeps to the neighbourhood of the model, and then
    needs up to 20 times as many conflicts until all diagnoses are found.

    A component that is in all conflicts comes before any set of several: no solver is asked for it, and where
    one fault explains all, its neighbours in the first conflict are done with before there are wide ones.
    """

    def __init__(self, clock: Deadline) -> None:
        self.conflicts: list[int] = []
        self._oracle = Oracle([], clock)
        self._known = 0  # the components that a conflict has named: the solver has seen no others
        self._alone = -1  # those that are in all conflicts and were not blocked

    def hit(self, conflict: int) -> None:
        """Every further set must contain one of these components."""
        self._known |= conflict
        self._alone &= conflict
        self.conflicts.append(conflict)
        self._oracle.add([bit + 1 for bit in bits(conflict)])

    def block(self, diagnosis: int) -> None:
        """No further set may contain all of these components."""
        if diagnosis.bit_count() < 2:
            self._alone &= ~diagnosis
        self._oracle.add([-(bit + 1) for bit in bits(diagnosis)])

    def next(self) -> int | None:
        """Return a minimal hitting set that contains no blocked one, or None: there is no other.

        Raises:
            OutOfTime: the clock ran out or was stopped.
        """
        if self.conflicts and self._alone:
            return self._alone & -self._alone
        if not self._oracle.sat([]):
            return None
        chosen = self._chosen()
        for bit in bits(chosen):
            if chosen >> bit & 1:
                spared = [-(other + 1) for other in bits(self._known & ~chosen)]
                if self._oracle.sat([*spared, -(bit + 1)]):
                    chosen = self._chosen()
        return chosen

    def _chosen(self) -> int:
        model = self._oracle.model()
        return sum(1 << bit for bit in bits(self._known) if model[bit] > 0)

    def close(self) -> None:
        """Free the solver."""
        self._oracle.close()


@dataclass(slots=True)
class _Sum:
    """The outputs of a totalizer; the one at `bound` is supposed false: at most `bound` inputs are true."""

    totalizer: ITotalizer
    bound: int


class CheapestHittingSets:
    """Minimal hitting sets in order of cost; bit i is component i and costs `weights[i]` ≥ 0."""

    def __init__(self, weights: Sequence[int], clock: Deadline) -> None:
        self.conflicts: list[int] = []
        self.cost = 0  # no further hitting set is cheaper
        self._weights = weights
        self._oracle = Oracle([], clock)
        self._known = 0
        self._top = len(weights)  # the highest variable in use
        self._left: dict[int, int] = {}  # literal that is supposed true -> what it still costs to give it up
        self._sums: dict[int, _Sum] = {}  # such a literal that is an output -> its totalizer

    def hit(self, conflict: int) -> None:
        """Every further set must contain one of these components."""
        for bit in bits(conflict & ~self._known):
            self._oracle.set_phases([-(bit + 1)])
            if self._weights[bit]:
                self._left[-(bit + 1)] = self._weights[bit]
        self._known |= conflict
        self.conflicts.append(conflict)
        self._oracle.add([bit + 1 for bit in bits(conflict)])

    def block(self, diagnosis: int) -> None:
        """No further set may contain all of these components."""
        self._oracle.add([-(bit + 1) for bit in bits(diagnosis)])

    def next(self) -> int | None:
        """Return a cheapest minimal hitting set that contains no blocked one, or None: there is no other.

        Its cost is `self.cost`, which never falls from call to call.

        Raises:
            OutOfTime: the clock ran out or was stopped; the object may go on later.
        """
        stratum = max(self._left.values(), default=0)
        while True:
            supposed = [literal for literal, weight in self._left.items() if weight >= stratum]
            if self._oracle.sat(supposed):
                cheaper = [weight for weight in self._left.values() if weight < stratum]
                if not cheaper:
                    return self._chosen()
                stratum = min(max(cheaper), max(stratum // 2, min(cheaper)))
                continue
            core = self._oracle.core() or []
            if not core:
                return None
            self._pay(core)

    def _chosen(self) -> int:
        count = len(self._weights)
        model = self._oracle.model()[:count]
        return made_minimal(sum(1 << (number - 1) for number in model if number > 0), self.conflicts)

    def _pay(self, core: list[int]) -> None:
        """One literal of the core must be given up: its least weight is lost; a sum bounds the rest."""
        price = min(self._left[literal] for literal in core)
        self.cost += price
        for literal in core:
            self._left[literal] -= price
            if not self._left[literal]:
                del self._left[literal]
            if literal in self._sums:
                self._raise_bound(literal, price)
        if len(core) == 1:
            self._oracle.add([-core[0]])
            return
        self._oracle.add([-literal for literal in core])
        totalizer = ITotalizer([-literal for literal in core], ubound=1, top_id=self._top)
        self._top = max(self._top, totalizer.top_id)
        for clause in totalizer.cnf.clauses:
            self._oracle.add(clause)
        self._suppose(_Sum(totalizer, 1), price)

    def _raise_bound(self, literal: int, price: int) -> None:
        """The bound of a sum fell; giving up one more input will cost as much again."""
        total = self._sums[literal]
        if total.bound + 1 < len(total.totalizer.lits):
            self._suppose(_Sum(total.totalizer, total.bound + 1), price)

    def _suppose(self, total: _Sum, price: int) -> None:
        totalizer = total.totalizer
        if len(totalizer.rhs) <= total.bound:
            totalizer.increase(ubound=total.bound, top_id=self._top)
            self._top = max(self._top, totalizer.top_id)
            for clause in totalizer.cnf.clauses[-totalizer.nof_new :] if totalizer.nof_new else ():
                self._oracle.add(clause)
        literal = -totalizer.rhs[total.bound]
        self._left[literal] = self._left.get(literal, 0) + price
        self._sums[literal] = total

    def close(self) -> None:
        """Free the solver and the totalizers."""
        for total in {id(total.totalizer): total for total in self._sums.values()}.values():
            total.totalizer.delete()
        self._oracle.close()
