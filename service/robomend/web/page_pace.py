"""How soon open pages may ask again: all of them together are a small load, however many there are.

A page asks at once when an event concerns it after a quiet while. From then on each answer tells it how long
to wait: with few pages not at all, with many as long as it takes that all of them come to `PER_S`. A robot's
changes do not wait behind the people who watch.
"""

from __future__ import annotations

PER_S = 20.0
"""Parts of pages made in a second, of all pages together: about a tenth of a core."""


class PagePace:
    """A queue of which only the length is known: each answer is given the next place in it."""

    def __init__(self) -> None:
        self._free_at_s = 0.0

    def again_s(self, now_s: float) -> float:
        """Return how long the page that is answered now is to wait before it asks again, seconds."""
        self._free_at_s = max(self._free_at_s, now_s) + 1 / PER_S
        return self._free_at_s - now_s
