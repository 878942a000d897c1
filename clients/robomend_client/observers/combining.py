"""Several observers that speak of one atom, as one value.

    voices     ok   unknown   not ok          bad news wins: not ok
                       └ has no vote          of lenient atoms good news wins: ok

The atom holds if all who speak say so; of atoms in `lenient` it is the other way round. What decides alone
rests on the youngest evidence of it, what all must say on all of it.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Sequence
from typing import NamedTuple

from robomend_client.literals import Atom, Literal
from robomend_client.observers.base import Evidence, Verdict
from robomend_client.observers.observer_state import ObserverState
from robomend_client.readings import Reading


class Change(NamedTuple):
    """An atom has another value from now on, or was judged anew as it was told to be."""

    time_ns: int
    atom: Atom
    value: Literal | None  # None: unknown from now on
    since_ns: int | None = None
    onset_ns: int | None = None
    settled: int | None = None  # the n of the `settle` that this answers
    reading: Reading | None = None  # what was measured


class Combined:
    """What the observers of each atom say together, and who has been told to settle it."""

    def __init__(self, states: Iterable[ObserverState], lenient: Collection[Atom]) -> None:
        self._speakers: dict[Atom, list[ObserverState]] = {}
        for state in states:
            for atom in state.observer.atoms:
                self._speakers.setdefault(atom, []).append(state)
        self._lenient = frozenset(lenient)
        self._standing: dict[Atom, Literal] = {}
        self._settling: dict[Atom, int] = {}
        self._unseen: set[Atom] = set()  # those of which it was told that there is nothing to see so far

    @property
    def atoms(self) -> tuple[Atom, ...]:
        """All that anybody may speak of."""
        return tuple(self._speakers)

    def speakers(self, atom: Atom) -> Sequence[ObserverState]:
        """Return who may speak of an atom; nobody of one that nobody observes."""
        return self._speakers.get(atom, ())

    def settle(self, n: int, atom: Atom) -> None:
        """The next verdict on the atom that rests on nothing from before carries `n`.

        So does that there is nothing to see, until it is; that alone tells nobody how the atom is.
        """
        self._settling[atom] = n
        self._unseen.discard(atom)

    def standing(self) -> list[Verdict]:
        """Return what holds, with the evidence that its observers gave last."""
        return [Verdict(literal, *self._evidence(atom, literal)) for atom, literal in self._standing.items()]

    def changes(self, touched: Iterable[Atom], now_ns: int) -> Sequence[Change]:
        """Return the changes among these atoms, by what all their observers say."""
        changes = []
        for atom in touched:
            speakers = self._speakers[atom]
            value = self._value(atom, speakers)
            n = self._answer(atom, value, speakers) if self._settling else None
            before = self._standing.get(atom)
            if value is before and n is None:
                continue
            if value is not None and value == before and n is None:
                continue
            if value is None:
                self._standing.pop(atom, None)
                changes.append(Change(now_ns, atom, None, settled=n))
            else:
                self._standing[atom] = value
                since_ns, onset_ns, reading = self._evidence(atom, value)
                changes.append(Change(now_ns, atom, value, since_ns, onset_ns, n, reading))
        return changes

    def _value(self, atom: Atom, speakers: Sequence[ObserverState]) -> Literal | None:
        if len(speakers) == 1:
            found = speakers[0].verdicts.get(atom)
            return None if found is None else found.literal
        wins = atom in self._lenient
        value = None
        for state in speakers:
            found = state.verdicts.get(atom)
            if found is not None:
                value = found.literal
                if value.positive is wins:
                    break
        return value

    def _settled(self, atom: Atom, speakers: Sequence[ObserverState]) -> bool:
        """Return whether the atom's value rests on nothing from before it was to be judged anew."""
        wins = atom in self._lenient
        for state in speakers:
            if atom not in state.waiting:
                found = state.verdicts.get(atom)
                if found is not None and found.literal.positive is wins:
                    return True  # whatever the others will say
        return not any(atom in state.waiting for state in speakers)

    def _answer(self, atom: Atom, value: Literal | None, speakers: Sequence[ObserverState]) -> int | None:
        """Return the number of the `settle` that this value answers, or None."""
        n = self._settling.get(atom)
        if n is None or not self._settled(atom, speakers) or (value is None and atom in self._unseen):
            return None
        if value is None:
            self._unseen.add(atom)
        else:
            del self._settling[atom]
            self._unseen.discard(atom)
        return n

    def _evidence(self, atom: Atom, value: Literal) -> Evidence:
        """Return what a combined verdict rests on: of what decides alone, the youngest; else all.

        Its reading is that of the youngest that has one.
        """
        found = [
            verdict
            for state in self._speakers[atom]
            if (verdict := state.verdicts.get(atom)) is not None
            and verdict.literal.positive is value.positive
        ]
        alone = value.positive is (atom in self._lenient)
        since_ns = (max if alone else min)(verdict.since_ns for verdict in found)
        onsets = [verdict.onset_ns for verdict in found if verdict.onset_ns is not None]
        read = [verdict for verdict in found if verdict.reading is not None]
        reading = max(read, key=lambda verdict: verdict.since_ns).reading if read else None
        return Evidence(since_ns, min(onsets, default=None), reading)
