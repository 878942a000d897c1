"""What is asked of an engine, and what it answers. Every answer says whether it is complete.

`Engine` is the whole interface: one object per model, kept warm, asked with sets of literals. An engine that
cannot honour an option raises OptionRefused; running out of size, count or time is an answer (`stopped_by`).
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass, field
from typing import Literal as OneOf
from typing import Protocol

from robomend_client.literals import Literal

Minimal = OneOf["cardinality", "subset"]
Order = OneOf["size", "probability"]
StoppedBy = OneOf["limit", "size", "time"]


@dataclass(frozen=True, slots=True)
class Options:
    """How far to search. The defaults are those of HTTP and the command line."""

    minimal: Minimal = "subset"
    max_size: int | None = None
    limit: int | None = 100  # None: a million, so that the memory is bounded; see `factored`
    timeout_s: float | None = 5.0
    order: Order = "size"
    # Conflicts with their rules and observations: enough to show why each member of each diagnosis is blamed,
    # or all minimal ones.
    conflicts: bool | OneOf["all"] = True
    # As products, with the exact count: of circuits those of minimal cardinality only, as top-level
    # diagnoses × replaceable cones; of other models the alternatives of each part that is independent of the
    # others.
    factored: bool = False
    healthy: frozenset[str] = frozenset()  # what-if: assumed healthy …
    abnormal: frozenset[str] = frozenset()  # … or abnormal

    def __hash__(self) -> int:
        return hash((self.minimal, self.max_size, self.limit))  # by what differs between robots, and no more


@dataclass(frozen=True, slots=True)
class Diagnosis:
    """A minimal set of abnormal components; empty: OBS is what a healthy system would show."""

    bad: tuple[str, ...]  # in the order of COMPS
    probability: float | None = None  # posterior among the diagnoses found; None without priors
    # Abnormal component -> fault mode, where the model has modes.
    modes: Mapping[str, str] = field(default_factory=dict)
    resolves: tuple[int, ...] = ()  # indices into DiagnosisResult.conflicts


@dataclass(frozen=True, slots=True)
class Conflict:
    """Components that cannot all be healthy, given the observations; minimal in both."""

    components: tuple[str, ...]
    observations: tuple[Literal, ...]
    rules: tuple[str, ...]
    text: str  # a sentence
    unmet: Literal | None = None  # the observation that was not expected: what an abnormal component explains
    minimal: bool = True  # False: time or a bound did not allow to make sure that each component is needed


@dataclass(frozen=True, slots=True)
class Factor:
    """One factor of a product: a diagnosis takes one of `alternatives`, or all members of one of `sets`."""

    component: str  # the first of them; in a circuit the top of the cone, which is always among them
    alternatives: tuple[str, ...]
    sets: tuple[tuple[str, ...], ...] = ()

    @property
    def always(self) -> frozenset[str]:
        """What is in each choice."""
        return frozenset.intersection(*map(frozenset, self.choices))

    @property
    def choices(self) -> tuple[tuple[str, ...], ...]:
        """Single components and sets alike."""
        return (*((component,) for component in self.alternatives), *self.sets)


@dataclass(frozen=True, slots=True)
class DiagnosisResult:
    """The answer of an engine. `good` of a diagnosis is COMPS without its `bad`."""

    components: tuple[str, ...]
    diagnoses: tuple[Diagnosis, ...]  # in order of size (or probability, as asked)
    complete: bool
    stopped_by: StoppedBy | None
    conflicts: tuple[Conflict, ...]
    elapsed_s: float  # the diagnosis alone, without compilation
    unused: tuple[Literal, ...] = ()  # observations that no rule mentions
    # A row is a product of factors, and the rows have no diagnosis in common. What is here without being
    # asked for is whole: every diagnosis, whatever the limit left out of the list.
    factored: tuple[tuple[Factor, ...], ...] = ()
    count: int | None = None  # exact number of diagnoses asked for, where known; the list may be shorter
    # Upper bound on the prior mass that was not enumerated; None without priors.
    unexplored: float | None = None
    cleared: Mapping[str, str] = field(default_factory=dict)  # healthy suspect -> why it is cleared
    # False: there was no time, or no room, for all that the diagnoses rest on.
    conflicts_complete: bool = True
    # Bounds of the size of the smallest diagnosis, None where they are not known. A search for minimum
    # cardinality that ran out of time gives the smallest that it has: `smallest_proved` is false.
    size_at_least: int | None = None
    size_at_most: int | None = None
    smallest_proved: bool = True
    conflicts_all: bool = False  # True: these are all minimal conflicts that there are

    @property
    def healthy(self) -> bool:
        """OBS is what a healthy system would show."""
        return healthy(diagnosis.bad for diagnosis in self.diagnoses)

    @property
    def certain(self) -> frozenset[str]:
        """Components that every diagnosis blames which is listed or in the factored form."""
        blamed = [frozenset(diagnosis.bad) for diagnosis in self.diagnoses]
        blamed += [frozenset(name for factor in row for name in factor.always) for row in self.factored]
        return frozenset.intersection(*blamed) if blamed else frozenset()

    def good(self, diagnosis: Diagnosis) -> tuple[str, ...]:
        """Return COMPS without the diagnosis, in the order of COMPS."""
        bad = frozenset(diagnosis.bad)
        return tuple(component for component in self.components if component not in bad)


def healthy(bad_sets: Iterable[Collection[str]]) -> bool:
    """Return whether diagnoses that blame these say that all is well: whether one of them blames nothing.

    Decided here only, for results and for their JSON.
    """
    return any(not bad for bad in bad_sets)


class Engine(Protocol):
    """One engine for one model. Not thread-safe: one call at a time; `interrupt` may come from any thread."""

    name: str

    def diagnose(self, observations: Iterable[Literal], options: Options = ...) -> DiagnosisResult:
        """Return the minimal diagnoses of SD ∪ observations.

        Raises:
            ContradictoryModel: no model even with every component abnormal.
            OptionRefused: this engine cannot honour one of the options.
        """
        ...

    def consistent(self, observations: Iterable[Literal]) -> bool:
        """Return whether SD ∪ observations ∪ {all healthy} is consistent: the cheap check."""
        ...

    def interrupt(self) -> None:
        """Make a running `diagnose` stop soon with what it has, stopped_by "time"."""
        ...

    def close(self) -> None:
        """Free the solver."""
        ...
