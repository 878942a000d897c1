"""OBS: what is known of one robot now, and the update OBS ⊕ o by a newer observation.

One entry per atom. A literal replaces its opposite; the trends inc, dec and const of a value exclude each
other, so asserting one asserts the negations of the others. Entries are ordered by time stamp, per atom:
what arrives late and is older changes nothing, with equal stamps the last arrival wins. So the result does
not depend on the order of arrival where the stamps differ.

**Several sources of one atom.** Of each the last word is kept, with `since`, the beginning of the newest
evidence, and `from`, the beginning of the first evidence of saying so (the onset):

    A: ok        from ├────────────────────────────┤ since ┄┄ said, alive until its lifetime is over
    B: not ok              from ├──────────────────┤ since ┄┄ said, alive …

- A source is alive that repeats itself: as long as the lifetime of its word lasts, or, where it gives none,
  for three times as long as it needed from one report to the next. What a source said once (a person, a POST
  by hand) overrides what was said before, and counts until another speaks.
- Of two that are alive and say the opposite, a word gives way to one that began after all of its evidence
  (since < from of the other): the other saw a change that this source cannot have seen yet. It does not count
  again for being repeated with evidence from before.
- Who reports silence and never heard the topic (`deaf`) has seen no change: nobody gives way to that, and it
  is no news beside a word whose lifetime is not over.
- Where neither gives way, each has seen the opposite while the other stood by its own: they contradict each
  other. The atom is unknown then (`Entry.contradicted`), unless a `Belief` decides.

The order in which the words of sources arrive does not matter.

A lifetime makes an entry stale, and stale is unknown: it leaves `literals`, but keeps its place in time, so
that a still older message cannot bring an old truth back. Richer sentences are assertions that hold until
withdrawn by name.

Nothing here reads a clock: callers pass times in integer nanoseconds, from one clock. Whoever accepts
stamps from robots bounds how far ahead they may be, as an entry from the future outlives everything older.

Source: section IV-C of the paper; time, lifetimes and trends are ours.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from typing import NamedTuple

from robomend.entry import CONTRADICTED_NS, Entry, LastWord
from robomend.errors import ObservationError
from robomend.model.clauses import Assertion
from robomend.model.vocabulary import SYMMETRIC, TRENDS
from robomend_client.literals import Atom, Literal

MAX_ATOMS = 20_000
"""Atoms that OBS of one robot may hold; beyond the declared ones only `unknown: keep` makes new ones."""

MAX_ASSERTIONS = 200
FOREVER = 2**63 - 1

MAX_SOURCES = 8
"""Of one atom, whose last words are kept: the newest ones."""

KEPT_NS = 60 * 10**9
"""How long the word of a source that is not alive any more is kept, to see whether it repeats itself."""

REPEATS, MOST_GAP_NS = 3, 20 * 10**9
"""A source without lifetimes is alive for so many of its gaps between two reports, if they are no longer than
that; with a lifetime, they may be as long as it is."""

IMPLYING = frozenset((*TRENDS, *SYMMETRIC))
"""Predicates of which a literal may say more than itself, or in other words: see `consequences`."""


class Belief(NamedTuple):
    """Who is believed where sources contradict each other; by default nobody."""

    sources: tuple[str, ...] = ()  # the first of them that takes part
    bad_wins: bool = False  # else what does not hold


NOBODY = Belief()


class Retracted(NamedTuple):
    """What OBS holds after sources have withdrawn their words."""

    changed: list[Entry]  # something else than before
    renewed: list[Entry]  # the same, by the words of the others
    gone: list[Atom]  # nothing


class Contradiction(NamedTuple):
    """Sources that contradict each other about an atom."""

    atom: Atom
    holds: tuple[Entry, ...]  # what those say that report it
    fails: tuple[Entry, ...]  # … and its opposite
    believed: Entry | None


class Obs:
    """The observations of one robot. Not thread-safe; small, as a service holds a thousand."""

    __slots__ = (
        "_assertions",
        "_before",
        "_belief",
        "_by_atom",
        "_computed_ns",
        "_held",
        "_known",
        "_literals",
        "_mortal",
        "_several",
        "_signature",
        "_valid_ns",
    )

    def __init__(
        self,
        entries: Iterable[Entry] = (),
        assertions: Iterable[Assertion] = (),
        belief: Belief = NOBODY,
    ) -> None:
        """Rebuild OBS from `entries()` and `assertions`, as they were stored."""
        self._belief = belief
        self._by_atom: dict[Atom, Entry] = {
            entry.literal.atom: held(entry.by_source, belief) if entry.by_source else entry
            for entry in entries
        }
        # When the one source of an atom spoke before, by its clock.
        self._before: dict[Atom, int] = {}
        # Atoms of which several sources speak: few, as a rule none.
        self._several = {atom for atom, entry in self._by_atom.items() if entry.by_source}
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
        before = self._before
        for entry in new:
            literal = entry.literal
            atom = literal.atom
            old = by_atom.get(atom)
            torn = False  # whether it is, or was, contradicted
            if old is not None:
                if old.by_source or old.source != entry.source:
                    entry = self._weighed(old, entry)  # what OBS holds of its atom now
                    literal = entry.literal
                    torn = old.contradicted or entry.contradicted
                elif entry.time_ns > old.time_ns:
                    before[atom] = old.time_ns
                elif entry.time_ns < old.time_ns:
                    before[atom] = max(entry.time_ns, before.get(atom, 0))
                    continue
            by_atom[atom] = entry
            if entry.expires_ns is not None:
                self._mortal = True
            if old is None or old.literal != literal:
                if old is not None:
                    self._held.discard(old.literal)
                self._held.add(literal)
                news = not torn or old is None or old.contradicted is not entry.contradicted
            elif torn:
                news = old.contradicted is not entry.contradicted
            else:
                # `_computed_ns`: somebody may have been told already that the old entry is stale.
                news = not old.fresh(max(entry.time_ns, self._computed_ns))
                if not news and entry.expires_ns is not None and entry.expires_ns < self._valid_ns:
                    self._valid_ns = entry.expires_ns
            if news or atom in changed:
                changed[atom] = entry
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

    def word(self, atom: Atom, source: str) -> Entry | None:
        """Return the last word of a source on an atom; what OBS holds of it where the source has none."""
        entry = self._by_atom.get(atom)
        if entry is not None:
            for word in entry.by_source:
                if word.entry.source == source:
                    return word.entry
        return entry

    def contradictions(self, now_ns: int) -> list[Contradiction]:
        """Return about which atoms sources that are alive contradict each other, in the atoms' order."""
        found = []
        for atom in sorted(self._several):
            words = [w for w in self._by_atom[atom].by_source if (until_ns(w) or 0) > now_ns]
            stand = standing(words) if words else []
            if opposed(stand):
                holds, fails = (tuple(e for e in stand if e.positive is sign) for sign in (True, False))
                found.append(Contradiction(atom, holds, fails, believed(stand, self._belief)))
        return found

    def doubted(self, now_ns: int) -> dict[Atom, int]:
        """Return the atoms of which a source that is alive says the opposite of what OBS holds, by older
        evidence: it may be about to agree, or to contradict. With until when its word lives.
        """
        found = {}
        for atom in self._several:
            entry = self._by_atom[atom]
            ends = [
                end
                for word in entry.by_source
                if word.entry.positive is not entry.positive and (end := until_ns(word) or 0) > now_ns
            ]
            if ends and entry.fresh(now_ns) and entry.expires_ns is not None:
                found[atom] = max(ends)
        return found

    @property
    def several(self) -> bool:
        """Whether there is an atom of which several sources speak."""
        return bool(self._several)

    def several_of(self, reported: Iterable[Entry]) -> set[Atom]:
        """Return those of the atoms of which several sources speak; what a trend denies is among them."""
        if not self._several:
            return set()
        return {entry.atom for given in reported for entry in consequences(given)} & self._several

    def sources(self) -> frozenset[str]:
        """Return who is known to speak."""
        words = (word.entry for atom in self._several for word in self._by_atom[atom].by_source)
        return frozenset(entry.source for entry in (*self._by_atom.values(), *words))

    def retract(self, said: Iterable[tuple[Atom, str]]) -> Retracted:
        """Sources say that they know nothing of atoms any more: the words of others that are alive stay."""
        found = Retracted([], [], [])
        for atom, source in said:
            old = self._by_atom.get(atom)
            if old is None:
                continue
            words = [word for word in old.by_source if word.entry.source != source]
            if old.source == source:
                words = [
                    word
                    for word in words
                    if max(until_ns(word) or 0, word.entry.expires_ns or 0) > old.time_ns
                ]
                if not words:
                    found.gone.append(atom)
                    continue
            if len(words) == len(old.by_source):
                continue
            new = held(words, self._belief)
            self._held.discard(old.literal)
            self._held.add(new.literal)
            self._by_atom[atom] = new
            if not new.by_source:
                self._several.discard(atom)
            same = new.literal == old.literal or new.contradicted
            (found.renewed if same and new.contradicted is old.contradicted else found.changed).append(new)
        self.forget(found.gone)
        return found

    def entries(self) -> tuple[Entry, ...]:
        """Return every entry, stale ones included: what a store keeps."""
        return tuple(self._by_atom.values())

    def forget(self, atoms: Iterable[Atom]) -> None:
        """Drop entries altogether, e.g. of an observer that is gone."""
        for atom in atoms:
            gone = self._by_atom.pop(atom, None)
            self._several.discard(atom)
            self._before.pop(atom, None)
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

    def _weighed(self, old: Entry, entry: Entry) -> Entry:
        """Return what OBS holds of an atom of which several sources speak, after the word of one of them."""
        alone = LastWord(old, self._before.pop(old.atom, None))
        words = {word.entry.source: word for word in old.by_source or (alone,)}
        before = words.pop(entry.source, None)
        if before is None:
            word = LastWord(entry)
        elif entry.time_ns >= before.entry.time_ns:
            moved = entry.time_ns > before.entry.time_ns
            word = LastWord(entry, before.entry.time_ns if moved else before.before_ns)
        else:  # late: at most it shows how often the source speaks
            word = before._replace(before_ns=max(entry.time_ns, before.before_ns or 0))
        words[entry.source] = word
        kept = _kept(words.values())
        new = held(kept, self._belief)
        if new.by_source:
            self._several.add(new.atom)
        else:
            self._several.discard(new.atom)
            if kept[0].before_ns is not None:
                self._before[new.atom] = kept[0].before_ns
        return new

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


# --- several sources of one atom; see the module


def held(words: Sequence[LastWord], belief: Belief) -> Entry:
    """Return what OBS holds of an atom by these words, of which there is at least one."""
    if len(words) == 1:
        return words[0].entry
    stand = standing(words)
    newest = max(reversed(stand), key=lambda entry: entry.time_ns)
    if not opposed(stand):
        return replace(newest, by_source=tuple(words))
    chosen = believed(stand, belief)
    if chosen is None:
        return replace(newest, expires_ns=CONTRADICTED_NS, by_source=tuple(words))
    return replace(chosen, by_source=tuple(words))


def standing(words: Sequence[LastWord]) -> list[Entry]:
    """Return the words that count: none gives way to another of them."""
    newest = max(reversed(words), key=lambda word: word.entry.time_ns)  # of equal stamps the last arrival
    if until_ns(newest) is None:
        return [newest.entry]
    at_ns = newest.entry.time_ns
    ends = (((w.entry.expires_ns if newest.entry.deaf else None) or until_ns(w) or 0, w) for w in words)
    alive = [word.entry for end_ns, word in ends if word is newest or end_ns > at_ns]
    return [entry for entry in alive if not any(_gives_way(entry, other) for other in alive)]


def opposed(stand: Sequence[Entry]) -> bool:
    """Return whether words that count contradict each other."""
    return len({entry.positive for entry in stand}) > 1


def believed(stand: Sequence[Entry], belief: Belief) -> Entry | None:
    """Return the word that is believed of those that contradict each other; None: nobody's."""
    for source in belief.sources:
        for entry in stand:
            if entry.source == source:
                return entry
    bad = [entry for entry in stand if not entry.positive] if belief.bad_wins else []
    return max(bad, key=lambda entry: entry.time_ns, default=None)


def until_ns(word: LastWord) -> int | None:
    """Return until when the source of a word is alive; None: it does not repeat itself."""
    entry = word.entry
    if word.before_ns is None:
        return entry.expires_ns if entry.deaf else None
    gap_ns = entry.time_ns - word.before_ns
    if entry.expires_ns is None:
        return entry.time_ns + REPEATS * gap_ns if gap_ns <= MOST_GAP_NS else None
    return entry.expires_ns if gap_ns <= max(MOST_GAP_NS, entry.expires_ns - entry.time_ns) else None


def _gives_way(entry: Entry, other: Entry) -> bool:
    """Return whether a word does not count beside another; the one with the youngest evidence always does."""
    return other.positive is not entry.positive and not other.deaf and _from_ns(other) > _since_ns(entry)


def _from_ns(entry: Entry) -> int:
    """Return the beginning of the first evidence for what a source says."""
    if entry.onset_ns is not None:
        return entry.onset_ns
    return entry.time_ns if entry.since_ns is None else entry.since_ns


def _since_ns(entry: Entry) -> int:
    """Return the beginning of the newest evidence for what a source says."""
    return max(_from_ns(entry), entry.time_ns if entry.since_ns is None else entry.since_ns)


def _kept(words: Iterable[LastWord]) -> list[LastWord]:
    """Return the words that may still count, in the order of their arrival."""
    found = list(words)
    newest_ns = max(word.entry.time_ns for word in found)
    kept = [
        word
        for word in found
        if word.entry.time_ns > newest_ns - KEPT_NS or (word.entry.expires_ns or 0) > newest_ns
    ]
    if len(kept) > MAX_SOURCES:
        oldest = sorted(kept, key=lambda word: word.entry.time_ns)[: len(kept) - MAX_SOURCES]
        kept = [word for word in kept if word not in oldest]
    return kept
