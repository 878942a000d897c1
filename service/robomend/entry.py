"""An entry of OBS: one literal, who saw it, when, and until when it may be believed.

OBS holds it, the history and the store keep it, as it is. Times are integer nanoseconds since the epoch.
"""

from __future__ import annotations

from dataclasses import dataclass

from robomend_client.literals import Atom, Literal


@dataclass(frozen=True, slots=True)
class Entry:
    """See the module."""

    literal: Literal
    source: str
    time_ns: int
    expires_ns: int | None = None  # from then on unknown

    @property
    def atom(self) -> Atom:
        return self.literal.atom

    @property
    def positive(self) -> bool:
        return self.literal.positive

    def fresh(self, now_ns: int) -> bool:
        """Return whether the lifetime has not run out."""
        return self.expires_ns is None or now_ns < self.expires_ns
