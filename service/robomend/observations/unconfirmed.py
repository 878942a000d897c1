"""What an act has made uncertain: atoms of which there is no evidence yet from after its answer.

    act ──answer──► n, and the atoms it influences ──► unconfirmed ──► evidence from after it ──► confirmed

A producer that is replaced within its observer's window never changes its verdict: `ok(scan)` of the killed
driver stands while its successor is mute. So evidence older than the answer, of either sign, neither confirms
an effect nor starts an act. The answer counts, not the sending: a slow stop lets the old process speak on.

Evidence from after it is, in this order:

- a report that answers `settle` number n, or a later one: the observer dropped its samples after it heard of
  n. That is causal, whatever the clocks say;
- a report that rests on nothing older than the answer (`since`), by the service's clock. Of the facts that
  the act itself brings about (on, running) the sending counts: the process may run before the answer is here;
- of a source that speaks on change only (its literals have no lifetime): that nothing else was heard for as
  long as its observers may need. This confirms, but only so far: see `Confirmed.BY_SILENCE`.

Pure: whoever calls brings the times.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from enum import Enum

from robomend.entry import Entry
from robomend_client.literals import Atom

GUARD_NS = 50_000_000
"""How well the clocks of a source and of the service are matched, where clocks decide."""


@dataclass(frozen=True, slots=True)
class Act:
    """What made an atom uncertain."""

    n: int  # the settle number
    from_ns: int  # evidence must be younger, by the service's clock: the act's answer, of a fact its sending


class Confirmed(Enum):
    """How well an atom is confirmed."""

    NOT = "not"
    BY_SILENCE = "by-silence"  # its source would have spoken by now, if it still speaks at all
    SEEN = "seen"


class Unconfirmed:
    """The uncertain atoms of one robot. Small: what its latest acts influence."""

    __slots__ = ("_acts",)

    def __init__(self) -> None:
        self._acts: dict[Atom, Act] = {}

    def __bool__(self) -> bool:
        return bool(self._acts)

    def __contains__(self, atom: object) -> bool:
        return atom in self._acts

    @property
    def acts(self) -> Mapping[Atom, Act]:
        """Uncertain atom -> the latest act that made it so."""
        return self._acts

    def touch(self, atoms: Iterable[Atom], act: Act) -> None:
        """An act has answered: what was known of these atoms is no evidence any more."""
        for atom in atoms:
            self._acts[atom] = act

    def hear(self, entries: Iterable[Entry]) -> bool:
        """Take note of what was reported; return whether anything became certain by it."""
        if not self._acts:
            return False
        seen = False
        for entry in entries:
            act = self._acts.get(entry.atom)
            if act is not None and confirms(entry, act):
                del self._acts[entry.atom]
                seen = True
        return seen

    def how(self, entry: Entry, delay_ns: int, now_ns: int) -> Confirmed:
        """Return how well an entry of OBS is confirmed at this time; `delay_ns`: what its observer may need
        from a change to its verdict.
        """
        act = self._acts.get(entry.atom)
        if act is None:
            return Confirmed.SEEN
        if entry.expires_ns is None and now_ns >= act.from_ns + delay_ns:
            return Confirmed.BY_SILENCE
        return Confirmed.NOT

    def forget(self, atoms: Iterable[Atom]) -> None:
        """Nobody speaks of these any more."""
        for atom in atoms:
            self._acts.pop(atom, None)

    def clear(self) -> None:
        self._acts.clear()


def confirms(entry: Entry, act: Act) -> bool:
    """Return whether a report is evidence from after an act."""
    if entry.settled is not None and entry.settled >= act.n:
        return True
    return entry.since_ns is not None and entry.since_ns > act.from_ns + GUARD_NS
