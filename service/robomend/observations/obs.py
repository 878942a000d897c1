"""OBS: what is known of one robot now, and the update OBS ⊕ o by a newer observation.

One entry per atom. A literal replaces its opposite; the trends inc, dec and const of a value exclude each
other, so asserting one asserts the negations of the others. Entries are ordered by time stamp, per atom:
what arrives late and is older changes nothing, with equal stamps the last arrival wins. So the result does
not depend on the order of arrival where the stamps differ.

A lifetime makes an entry stale, and stale is unknown: it leaves `literals`, but keeps its place in time, so
that a still older message cannot bring an old truth back. Richer sentences are assertions that hold until
withdrawn by name.

Nothing here reads a clock: callers pass times in integer nanoseconds, from one clock. Whoever accepts
stamps from robots bounds how far ahead they may be, as an entry from the future outlives everything older.

Source: section IV-C of the paper; time, lifetimes and trends are ours.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import replace

from robomend.entry import Entry
from robomend.errors import ObservationError
from robomend.model.clauses import Assertion
from robomend.model.vocabulary import SYMMETRIC, TRENDS
from robomend_client.literals import Atom, Literal

MAX_ATOMS = 20_000
"""Atoms that OBS of one robot may hold; beyond the declared ones only `unknown: keep` makes new ones."""

MAX_ASSERTIONS = 200
FOREVER = 2**63 - 1

IMPLYING = frozenset((*TRENDS, *SYMMETRIC))
"""Predicates of which a literal may say more than itself, or in other words: see `consequences`."""


class Obs:
    """The observations of one robot. Not thread-safe; small, as a service holds a thousand."""

    __slots__ = (
        "_assertions",
        "_by_atom",
        "_computed_ns",
        "_held",
        "_known",
        "_literals",
        "_mortal",
        "_signature",
        "_valid_ns",
    )

    def __init__(self, entries: Iterable[Entry] = (), assertions: Iterable[Assertion] = ()) -> None:
        """Rebuild OBS from `entries()` and `assertions`, as they were stored."""
        self._by_atom: dict[Atom, Entry] = {entry.literal.atom: entry for entry in entries}
        # The literals of all entries: each is hashed when it comes, not at each question.
        self._held: set[Literal] = {entry.literal for entry in self._by_atom.values()}
        self._assertions: dict[str, Assertion] = {a.name: a for a in assertions}
        # Whether any entry may have a lifetime: most robots have none, and need not be looked through.
        self._mortal = any(entry.expires_ns is not None for entry in self._by_atom.values())
        # What `literals` said last, and from when until when that is right.
        self._literals: tuple[Literal, ...] | None = None
        self._known: frozenset[Literal] | None = None
        self._signature: frozenset[object] | None = None
        self._computed_ns = 0
        self._valid_ns = FOREVER

    def update(self, observed: Iterable[Entry]) -> tuple[Entry, ...]:
        """Take in observations, all or none, and return the entries that changed what is known.

        A repetition of what is known already renews time and lifetime, and is not returned. The trends
        denied by a new trend are.

        Raises:
            ObservationError: OBS would grow beyond MAX_ATOMS.
        """
        new: list[Entry] = []
        for given in observed:
            if given.literal.atom.predicate in IMPLYING:
                new += consequences(given)
            else:
                new.append(given)
        by_atom = self._by_atom
        if len(by_atom) + len(new) > MAX_ATOMS:
            atoms = {entry.literal.atom for entry in new}
            if len(by_atom.keys() | atoms) > MAX_ATOMS:
                raise ObservationError(f"OBS would hold more than {MAX_ATOMS} atoms", str(new[0].literal))
        changed: dict[Atom, Entry] = {}
        for entry in new:
            literal = entry.literal
            atom = literal.atom
            old = by_atom.get(atom)
            if old is not None and entry.time_ns < old.time_ns:
                continue
            by_atom[atom] = entry
            if entry.expires_ns is not None:
                self._mortal = True
            if old is None or old.literal != literal:
                if old is not None:
                    self._held.discard(old.literal)
                self._held.add(literal)
                changed[atom] = entry
            # `_computed_ns`: somebody may have been told already that the old entry is stale.
            elif atom in changed or not old.fresh(max(entry.time_ns, self._computed_ns)):
                changed[atom] = entry
            elif entry.expires_ns is not None and entry.expires_ns < self._valid_ns:
                self._valid_ns = entry.expires_ns
        if changed:
            self._forget()
        return tuple(changed.values())

    def literals(self, now_ns: int) -> tuple[Literal, ...]:
        """Return what is known at that time: the literals whose lifetime has not run out."""
        if self._literals is None or not self._computed_ns <= now_ns < self._valid_ns:
            entries = self._by_atom.values()
            if self._mortal:
                self._literals = tuple([entry.literal for entry in entries if entry.fresh(now_ns)])
            else:
                self._literals = tuple([entry.literal for entry in entries])
            self._computed_ns = now_ns
            self._valid_ns = self._soonest(now_ns) or FOREVER
            self._signature = self._known = None
        return self._literals

    def known_literals(self, now_ns: int) -> frozenset[Literal]:
        """Return `literals` as a set, which costs little where nothing is stale."""
        if self._mortal:
            literals = self.literals(now_ns)
            if self._known is None:
                self._known = frozenset(self._held if len(literals) == len(self._held) else literals)
        elif self._known is None:
            self._known = frozenset(self._held)
        return self._known

    def signature(self, now_ns: int) -> frozenset[object]:
        """Return a hashable value that is equal exactly when the same is known; cheap while nothing
        changes."""
        literals = self.literals(now_ns)
        if self._signature is None:
            self._signature = frozenset((*literals, *self._assertions.values()))
        return self._signature

    @property
    def mortal(self) -> bool:
        """Whether any entry may have a lifetime."""
        return self._mortal

    def next_expiry_ns(self, now_ns: int) -> int | None:
        """Return when the next entry becomes stale, None if none will."""
        if self._literals is not None and self._computed_ns <= now_ns and self._valid_ns == FOREVER:
            return None  # the common case, without looking at each entry
        return self._soonest(now_ns)

    def _soonest(self, now_ns: int) -> int | None:
        if not self._mortal:
            return None
        times = (entry.expires_ns for entry in self._by_atom.values())
        return min((time for time in times if time is not None and time > now_ns), default=None)

    def get(self, atom: Atom) -> Entry | None:
        """Return the entry of an atom, fresh or stale."""
        return self._by_atom.get(atom)

    def known(self, atom: Atom, now_ns: int) -> bool | None:
        """Return whether the atom holds at that time, None if that is unknown."""
        entry = self._by_atom.get(atom)
        return None if entry is None or not entry.fresh(now_ns) else entry.literal.positive

    def entries(self) -> tuple[Entry, ...]:
        """Return every entry, stale ones included: what a store keeps."""
        return tuple(self._by_atom.values())

    def forget(self, atoms: Iterable[Atom]) -> None:
        """Drop entries altogether, e.g. of an observer that is gone."""
        for atom in atoms:
            gone = self._by_atom.pop(atom, None)
            if gone is not None:
                self._held.discard(gone.literal)
        self._forget()

    @property
    def assertions(self) -> Mapping[str, Assertion]:
        """Name -> assertion, in the order in which they were made."""
        return dict(self._assertions)

    def add(self, assertion: Assertion) -> None:
        """Add an assertion, or replace the one of its name.

        Raises:
            ObservationError: there are MAX_ASSERTIONS already.
        """
        if assertion.name not in self._assertions and len(self._assertions) >= MAX_ASSERTIONS:
            raise ObservationError(
                f"there are {MAX_ASSERTIONS} assertions already: withdraw one", assertion.text
            )
        self._assertions[assertion.name] = assertion
        self._signature = None

    def withdraw(self, name: str) -> bool:
        """Remove an assertion; return whether there was one of that name."""
        self._signature = None
        return self._assertions.pop(name, None) is not None

    def __len__(self) -> int:
        return len(self._by_atom)

    def _forget(self) -> None:
        self._literals = self._known = None
        self._signature = None
        self._valid_ns = FOREVER


def consequences(entry: Entry) -> tuple[Entry, ...]:
    """Return the entry in canonical form, with the trends that it excludes."""
    literal = entry.literal
    predicate, args = literal.atom.predicate, literal.atom.args
    if predicate in SYMMETRIC and len(args) == 2 and args[1] < args[0]:
        swapped = Literal(Atom(predicate, (args[1], args[0])), literal.positive)
        return (replace(entry, literal=swapped),)
    if predicate not in TRENDS or not literal.positive or len(args) != 1:
        return (entry,)
    denied = (Literal(Atom(trend, args), False) for trend in TRENDS if trend != predicate)
    return (entry, *(replace(entry, literal=no) for no in denied))
