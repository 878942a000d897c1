"""An entry of OBS: one literal, who saw it, when, what that rests on, and until when it may be believed.

OBS holds it, the history and the store keep it, as it is. Times are integer nanoseconds since the epoch.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, NamedTuple

from robomend_client.literals import Atom, Literal
from robomend_client.readings import Reading

CONTRADICTED_NS = 0
"""The end of the lifetime of what sources contradict each other about: it is unknown, whatever the time."""


@dataclass(frozen=True, slots=True)
class Entry:
    """See the module."""

    literal: Literal
    source: str
    time_ns: int  # of the report, by the source's clock: it orders the entries of an atom
    expires_ns: int | None = None  # from then on unknown
    since_ns: int | None = None  # the beginning of what the verdict rests on, by the service's clock
    onset_ns: int | None = None  # since when it is so, by the service's clock: the last sample before it was
    settled: int | None = None  # the number of the `settle` that the source answered with this
    reading: Reading | None = None  # what was measured; no rule reads it
    by_source: tuple[LastWord, ...] = field(default=(), compare=False)
    """Of what OBS holds, where several sources speak of the atom: the last word of each."""
    deaf: bool = False  # that it is silent is said by who never heard it: no change was seen

    @property
    def atom(self) -> Atom:
        return self.literal.atom

    @property
    def positive(self) -> bool:
        return self.literal.positive

    @property
    def began_ns(self) -> int:
        """Since when it is so, as far as that is known; at the latest since its report."""
        return self.onset_ns or self.since_ns or self.time_ns

    @property
    def contradicted(self) -> bool:
        """Whether OBS holds neither sign, as its sources contradict each other."""
        return self.expires_ns == CONTRADICTED_NS and bool(self.by_source)

    def fresh(self, now_ns: int) -> bool:
        """Return whether the lifetime has not run out."""
        return self.expires_ns is None or now_ns < self.expires_ns

    def measured(self) -> dict[str, Any] | None:
        """Return its reading as answers, events and records have it, with all of it as one text."""
        return None if self.reading is None else {**self.reading.as_json(), "text": str(self.reading)}


class LastWord(NamedTuple):
    """The last word of one source on an atom of which several speak."""

    entry: Entry
    before_ns: int | None = None  # the time of its report before that
