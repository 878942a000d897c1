"""What a search hands to the engine, and the events that end it.

    LimitReached      raised by answer.add when enough were found           stopped_by "limit"
    MinimumTooLarge   raised by the search: larger ones exist (core_guided.py)      stopped_by "size"
    OutOfTime         raised by the oracle or the clock                     stopped_by "time"
    NoDiagnosis       raised by the search: nothing explains OBS            ContradictoryModel; in what-if,
    none

What a search found before the event stays true, because it was found in order of size.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

from robomend.diagnosis.conflicts import Known
from robomend.diagnosis.derivations import Derivation
from robomend.diagnosis.oracle import Deadline
from robomend.diagnosis.result import Factor

Bad = tuple[int, ...]
"""A diagnosis in numbers: the health variables of the abnormal components, ascending."""

Row = tuple[tuple[Bad, ...], ...]
"""A product of factors: a diagnosis takes one alternative of each."""

MAX_DIAGNOSES = 1_000_000
"""Where no limit is given, this one holds: some 300 MB of result. The factored form counts on without it."""

MAX_MEMBERS = 4_000_000
"""Of all diagnoses listed together: large ones fill the memory sooner."""

BATCH = 1_024
"""Diagnoses between two looks at the clock and at MAX_MEMBERS."""

TELLING_S = 4e-6
TELLING_MEMBER_S = 0.15e-6
"""What it takes to make a result of a diagnosis, and of each member: left over at the deadline for that."""


class LimitReached(Exception):
    """As many diagnoses as asked for were found."""


class NoDiagnosis(Exception):
    """SD ∪ OBS, with what is supposed, has no model however many components are abnormal."""


@dataclass(slots=True)
class SearchState:
    """What a search has found so far."""

    limit: int
    clock: Deadline
    found: list[Bad] = field(default_factory=list)
    modes: dict[Bad, Mapping[str, str]] = field(default_factory=dict)
    # Conflicts met on the way; they need not be minimal under all of OBS.
    known: list[Known] = field(default_factory=list)
    # Where none is found yet: no diagnosis is smaller than this, and one that is known, whether or not it is
    # minimal.
    at_least: int = 0
    best: Bad | None = None
    cores: list[list[int]] = field(default_factory=list)  # the solver's, over health and what was seen
    # All minimal conflicts, perhaps with others that contain some; None: the search met those of `known`
    # only.
    derived: list[Derivation] | None = None
    minimal: list[int] = field(default_factory=list)  # their masks, less those known to contain another
    # Factored: products that have no diagnosis in common.
    rows: list[Row] = field(default_factory=list)
    count: int | None = None  # exact, where the search knows more than it lists
    _members: int = 0

    def add(self, bad: Bad) -> None:
        """Take the next minimal diagnosis.

        One more than the limit is looked for, so that `complete` is known; not with a limit of 1, which asks
        for any one diagnosis as soon as possible.

        Raises:
            LimitReached: there is no room for it, or it is the one that was asked for.
            OutOfTime: the time that is left is needed to tell of those found.
        """
        found = self.found
        if len(found) >= self.limit:
            raise LimitReached
        self._members += len(bad)
        if len(found) % BATCH == BATCH - 1:
            if self._members > MAX_MEMBERS:
                raise LimitReached
            self.clock.reserve(len(found) * TELLING_S + self._members * TELLING_MEMBER_S)
        found.append(bad)
        if self.limit == 1 and bad:
            raise LimitReached


def by_size(bad: Bad) -> tuple[int, Bad]:
    """Return what diagnoses are sorted by; those of one size by their components, as in COMPS."""
    return len(bad), bad


def listed_as_rows(found: Sequence[Bad]) -> list[Row]:
    """Return diagnoses that are no products as rows: each by itself."""
    return [tuple(((variable,),) for variable in bad) for bad in found]


def factors(row: Row, names: Sequence[str]) -> tuple[Factor, ...]:
    """Return a row in the names of the components."""
    told = []
    for alternatives in row:
        single = tuple([names[bad[0] - 1] for bad in alternatives if len(bad) == 1])
        sets = tuple([tuple([names[v - 1] for v in bad]) for bad in alternatives if len(bad) != 1])
        told.append(Factor(names[alternatives[0][0] - 1], single, sets))
    return tuple(told)
