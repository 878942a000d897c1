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

from collections.abc import Callable, Collection, Sequence

from robomend.diagnosis.oracle import Oracle
from robomend.diagnosis.witnesses import Witnesses

CALLS = 1_000
"""Questions to the solver, for the components of a conflict and again for its observations."""

FEW = 8
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
    chunk = len(doubtful) // 2 if len(doubtful) > FEW else 1
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
