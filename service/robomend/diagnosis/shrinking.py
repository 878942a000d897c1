"""Smaller and smaller parts of a contradiction, down to a minimal one, within a bound on the questions asked.

Halves are left out first, then quarters, and so on down to single literals: what is not needed goes in few
questions, and when the bound is reached what was gained so far is kept. A refutation may use even less than
it was asked about, so its core is what goes on. At single literals each one that was tried is needed: needed
in a set, it is needed in every part of the set.

Sources:
    U. Junker. QuickXplain: preferred explanations and relaxations for over-constrained problems. AAAI 2004.
    A. Zeller, R. Hildebrandt. Simplifying and isolating failure-inducing input. TSE 28(2), 2002 (halves
    first). J. Marques-Silva. Minimal unsatisfiability: models, algorithms and applications. ISMVL 2010
    (cores).
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Sequence

from robomend.diagnosis.oracle import Deadline, Oracle
from robomend.model.cnf import Clause

CHECK_EVERY = 256
"""Values turned over between two looks at the clock."""


class Extract:
    """The clauses of a conflict's components, by themselves: small enough for hundreds of questions.

    Nothing follows from an abnormal component of a weak fault model, so whether some components can be
    healthy together depends on their own clauses only. An `Extract` is these in a solver of their own,
    numbered from 1.

    `Witnesses` tell from a model which components a conflict needs. A model in which the clauses of just one
    component are broken is a witness: without it the others can be healthy. One value turned over in such a
    model repairs those clauses and may break those of one other component, which is then needed too, and so
    on along a chain of gates:

        a ──► NOT ──► b ──► NOT ──► c      c wrong: the second gate is needed
                      └─ turned over:      now b is wrong, c is right: the first gate is needed

    Of hundreds of gates in the conflict of a circuit a few dozen are left to be asked the solver about.

    Source: A. Belov, J. Marques-Silva. Accelerating MUS extraction with recursive model rotation. FMCAD 2011.

    A context, so that the solver is freed.
    """

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


CALLS = 1_000
"""Questions to the solver, for the components of a conflict and again for its observations."""

TRIED_SINGLY = 8
"""Up to so many literals are tried one by one at once."""

Refute = Callable[[list[int]], Collection[int] | None]
"""Takes literals; returns those of a refutation, or None: they are consistent."""


def shrunk(
    literals: Sequence[int], refute: Refute, calls: int, needed: Collection[int] = ()
) -> tuple[list[int], bool]:
    """Return a part of contradictory literals that is still contradictory, and whether it is minimal.

    Args:
        refute: asked at most `calls` times.
        needed: literals that are known to be needed, which are not tried; `refute` may add to them.
    """
    kept = [literal for literal in literals if literal in needed]
    doubtful = [literal for literal in literals if literal not in needed]
    chunk = len(doubtful) // 2 if len(doubtful) > TRIED_SINGLY else 1
    while doubtful:
        index = 0
        while index < len(doubtful):
            if any(literal in needed for literal in doubtful[index : index + chunk]):
                index += chunk
                continue
            if not calls:
                return kept + doubtful, False
            calls -= 1
            core = refute(kept + doubtful[:index] + doubtful[index + chunk :])
            if core is None:
                index += chunk
            else:
                before = [literal for literal in doubtful[:index] if literal in core]
                doubtful = before + [literal for literal in doubtful[index + chunk :] if literal in core]
                index = len(before)
        if chunk == 1:
            break
        chunk = max(1, min(chunk, len(doubtful)) // 2)
    return kept + doubtful, True


def minimised(
    oracle: Oracle,
    components: list[int],
    observations: list[int],
    background: list[int],
    needed: set[int],
    witnesses: Witnesses | None = None,
    *,
    components_only: bool = False,
    calls: int | None = None,
) -> tuple[list[int], list[int], bool]:
    """Return a minimal conflict inside these: components, observations, and whether the former are minimal.

    Components are left out with all of `background` assumed, then, unless `components_only`, observations for
    those that are left; in at most so many `calls` of the solver each (None: CALLS).

    Raises:
        OutOfTime.
    """
    suspects = frozenset(components)
    calls = CALLS if calls is None else calls
    minimal = True
    if len(components) > 1:

        def refute_components(some: list[int]) -> list[int] | None:
            nonlocal observations
            if oracle.sat(background + some):
                if witnesses is not None:
                    witnesses.needed(oracle.model(), suspects.difference(some), needed)
                return None
            core = oracle.core() or []
            observations = [literal for literal in core if literal not in suspects]
            return [literal for literal in core if literal in suspects]

        components, minimal = shrunk(components, refute_components, calls, needed)

    if components_only:
        return components, observations, minimal

    def refute(some: list[int]) -> list[int] | None:
        return None if oracle.sat(components + some) else oracle.core() or []

    observations, _ = shrunk(observations, refute, calls)
    return components, observations, minimal
