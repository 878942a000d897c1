"""The clauses of a conflict's components, by themselves: small enough to be asked about hundreds of times.

Nothing follows from an abnormal component of a weak fault model, so whether some components can be healthy
together depends on their own clauses only. An `Extract` is these in a solver of their own, numbered from 1.

`Witnesses` tell from a model which components a conflict needs. A model in which the clauses of just one
component are broken is a witness: without it the others can be healthy. One value turned over in such a model
repairs those clauses and may break those of one other component, which is then needed too, and so on along a
chain of gates:

    a ──► NOT ──► b ──► NOT ──► c      c wrong: the second gate is needed
                  └─ turned over:      now b is wrong, c is right: the first gate is needed

Of hundreds of gates in the conflict of a circuit a few dozen are left to be asked the solver about.

Source: A. Belov, J. Marques-Silva. Accelerating MUS extraction with recursive model rotation. FMCAD 2011.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Sequence

from robomend.diagnosis.oracle import Deadline, Oracle
from robomend.model.cnf import Clause

CHECK_EVERY = 256
"""Values turned over between two looks at the clock."""


class Extract:
    """See the module. A context, so that the solver is freed."""

    def __init__(
        self, clauses: Iterable[Clause], components: Sequence[int], clock: Deadline, solver: str
    ) -> None:
        self._number = {variable: index for index, variable in enumerate(components, 1)}
        self.clauses: list[list[int]] = []
        number = self._number
        for clause in clauses:
            for literal in clause:
                number.setdefault(abs(literal), len(number) + 1)
            self.clauses.append([number[lit] if lit > 0 else -number[-lit] for lit in clause])
        self._original = list(number)
        self.oracle = Oracle(self.clauses, clock, solver)

    def __enter__(self) -> Extract:
        return self

    def __exit__(self, *exception: object) -> None:
        self.oracle.close()

    def known(self, literals: Iterable[int]) -> list[int]:
        """Return those of these literals that occur here, in the numbers of the extract."""
        number = self._number
        return [
            number[abs(literal)] if literal > 0 else -number[abs(literal)]
            for literal in literals
            if abs(literal) in number
        ]

    def original(self, literals: Iterable[int]) -> list[int]:
        """Return literals of the extract in the numbers of the model."""
        original = self._original
        return [original[lit - 1] if lit > 0 else -original[-lit - 1] for lit in literals]


class Witnesses:
    """See the module.

    Args:
        clauses: those of an extract, whose first variables are the health of `components` components.
        fixed: variables that were observed, or are supposed, so that none of them can be turned over.
        check: called now and then; may raise to end the work.
    """

    def __init__(
        self,
        clauses: Sequence[Sequence[int]],
        components: int,
        fixed: Collection[int],
        check: Callable[[], None],
    ) -> None:
        self._fixed = fixed
        self._check = check
        self._owners: list[frozenset[int]] = []  # of each clause
        self._bodies: list[list[int]] = []
        self._of: dict[int, list[int]] = {}  # variable -> the clauses that it occurs in
        for index, clause in enumerate(clauses):
            self._owners.append(frozenset([-lit for lit in clause if -components <= lit < 0]))
            body = [lit for lit in clause if not -components <= lit < 0]
            self._bodies.append(body)
            for literal in (*body, *self._owners[-1]):
                self._of.setdefault(abs(literal), []).append(index)

    def needed(self, model: Iterable[int], spared: Iterable[int], known: set[int]) -> None:
        """Add to the components known to be needed those that a model without some of them shows to be."""
        true = set(model)
        bodies = self._bodies
        clauses = {index for component in spared for index in self._of.get(component, ())}
        broken = {index for index in clauses if true.isdisjoint(bodies[index])}
        known |= self._any_of(broken)
        # Each step: a set of broken clauses, the literals left to turn over, and the one that led there.
        steps = [(broken, self._free(broken), 0)]
        turned = 0
        while steps:
            broken, left, led = steps[-1]
            if not left:
                steps.pop()
                if led:
                    true.remove(led)
                    true.add(-led)
                continue
            literal = left.pop()
            turned += 1
            if turned % CHECK_EVERY == 0:
                self._check()
            true.remove(-literal)
            true.add(literal)
            touched = self._of[abs(literal)]
            after = broken.difference(touched)
            after.update([index for index in touched if true.isdisjoint(bodies[index])])
            owners = self._any_of(after)
            if owners <= known:
                true.remove(literal)
                true.add(-literal)
            else:
                known |= owners
                steps.append((after, self._free(after), literal))

    def _free(self, broken: Iterable[int]) -> list[int]:
        """Return the literals that would repair one of these clauses and were not observed to be false."""
        literals = {literal for index in broken for literal in self._bodies[index]}
        return [literal for literal in literals if abs(literal) not in self._fixed]

    def _any_of(self, broken: Iterable[int]) -> frozenset[int]:
        """Return the components each of which alone, being abnormal, excuses all of these clauses."""
        common: frozenset[int] | None = None
        for index in broken:
            common = self._owners[index] if common is None else common & self._owners[index]
            if not common:
                break
        return common or frozenset()
