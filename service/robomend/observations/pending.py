"""Verdicts that may be about to change: what an act should wait for if they could change it.
And what an act itself has made uncertain.

An observer needs time to notice. When `not ok(scan)` comes, `ok(path)` may still be the verdict of a window
from before the fault, or another topic may have stopped whose silence nobody has noticed yet. So each verdict
is pending until its observer had its detection time, from the newest onset of a symptom on; of symptoms that
follow from each other along a chain of topics the one that fell first counts. And what has just
been started is silent until it has begun: its symptoms are pending for as long as starting may take, or until
it was heard once. A fault that went by itself is over bit by bit: what rests on something that is back may be
back, too, and its observer has not judged yet. So may be what rests on what a host says that was cut off and
is heard again.

Who repeats itself and has not been heard since a symptom began vouches for nothing after it: its host may be
cut off, and what it said last is from before. It has the time in which it usually speaks again, twice. Who
speaks on change only is silent by design and vouches until it says otherwise: that is everyone whose literals
have no lifetime, unless it was heard to say the same again and again.

Pure: times are integer nanoseconds by the service's clock.
"""

from __future__ import annotations

from collections import OrderedDict, deque
from collections.abc import Callable, Collection, Iterable, Mapping
from dataclasses import dataclass
from enum import Enum
from math import inf

from robomend.entry import Entry
from robomend_client.literals import Atom

# --- what an act has made uncertain: atoms of which there is no evidence yet from after its answer.
#
#     act ──answer──► n, and the atoms it influences ──► unconfirmed ──► evidence from after it ──► confirmed
#
# A producer that is replaced within its observer's window never changes its verdict: `ok(scan)` of the
# killed driver stands while its successor is mute. So evidence older than the answer, of either sign,
# neither confirms an effect nor starts an act. The answer counts, not the sending: a slow stop lets the old
# process speak on.
#
# Evidence from after it is, in this order:
#
# - a report that answers `settle` number n, or a later one: the observer dropped its samples after it heard
#   of n. That is causal, whatever the clocks say;
# - a report that rests on nothing older than the answer (`since`), by the service's clock. Of the facts that
#   the act itself brings about (on, running) the sending counts: the process may run before the answer is
#   here;
# - of a source that speaks on change only (its literals have no lifetime): that nothing else was heard for as
#   long as its observers may need. This confirms, but only so far: see `Confirmed.BY_SILENCE`.

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


SLACK_NS = 300_000_000
"""For what is on its way."""


AGAIN = 4
"""Times that a source without lifetimes must have repeated itself, to count as one that does."""

GAPS = 16
"""Pauses of a source that are looked at; the longest but one is usual for it: once it may be cut off."""

LEAST_GAPS = 3

AT_ONCE_NS = 50_000_000
"""Batches that come so close to each other are one report."""

MOST_SOURCES = 64


@dataclass(slots=True)
class _Source:
    last_ns: int
    arrived_ns: int  # when it last came through, whenever that was said
    gaps: deque[int]
    again: int = 0
    lives_ns: int = 0
    interrupted: tuple[int, int] | None = None  # when it was silent for unusually long, the last time


class LastHeard:
    """The sources of one robot: when each was heard last, and how often it usually is."""

    __slots__ = ("_sources",)

    def __init__(self) -> None:
        self._sources: OrderedDict[str, _Source] = OrderedDict()

    def hear(
        self, source: str, said_ns: int, *, again: bool, lives_ns: int, arrived_ns: int | None = None
    ) -> None:
        """A source spoke.

        Args:
            again: it said something that was known already.
            lives_ns: the lifetime that it gave; 0: none.
            arrived_ns: what is said while the way is cut off may come through later, all at once.
        """
        one, now_ns = self._sources.get(source), said_ns if arrived_ns is None else arrived_ns
        if one is None:
            one = self._sources[source] = _Source(said_ns, now_ns, deque(maxlen=GAPS))
            while len(self._sources) > MOST_SOURCES:
                self._sources.popitem(last=False)
        known = one.gaps and self.usual_ns(source) is not None
        usual_ns = sorted(one.gaps)[-2:][0] if known else inf
        if now_ns - one.arrived_ns > 2 * usual_ns + SLACK_NS:
            one.interrupted = (one.arrived_ns, now_ns)
        one.arrived_ns = max(now_ns, one.arrived_ns)
        gap_ns = said_ns - one.last_ns
        if gap_ns > AT_ONCE_NS:
            one.gaps.append(gap_ns)
            one.last_ns = said_ns
        one.again += again
        one.lives_ns = lives_ns

    def usual_ns(self, source: str) -> int | None:
        """Return for how long a source is silent at most, usually; None: it speaks on change, or nobody knows
        yet.
        """
        one = self._sources.get(source)
        if one is None or not (one.lives_ns or one.again >= AGAIN):
            return None
        if len(one.gaps) < LEAST_GAPS:
            return one.lives_ns or None  # by then it has to speak again
        return sorted(one.gaps)[-2]

    def silent_since(self, source: str, onset_ns: int) -> bool:
        """Return whether a source that repeats itself has not been heard after this."""
        one = self._sources.get(source)
        return one is not None and one.last_ns < onset_ns and self.usual_ns(source) is not None

    def interruption(self, source: str) -> tuple[int, int] | None:
        """Return when a source was silent for unusually long, the last time: from when, and until when."""
        one = self._sources.get(source)
        return None if one is None else one.interrupted


def newest_onset(entries: Iterable[Entry]) -> int | None:
    """Return when the latest of the symptoms began, as far as is known; None without symptoms."""
    onsets = [entry.began_ns for entry in entries if not entry.positive]
    return max(onsets, default=None)


def first_fallen(
    symptoms: Collection[Entry], needed: Callable[[Collection[str]], Mapping[str, Collection[str]]]
) -> list[Entry]:
    """Return the symptoms without those of topics that fell after a topic which they rest on.

    Such a one needs no cause of its own. Whatever else may have made the first one fall, fell before it.

    Args:
        needed: names -> for each of them the topics that it rests on.
    """
    fell = {entry.atom: entry.onset_ns for entry in symptoms if entry.onset_ns is not None}
    needs = needed({name for atom in fell for name in atom.args}) if len(fell) > 1 else {}

    def follows(entry: Entry) -> bool:
        onset_ns = fell.get(entry.atom)
        if onset_ns is None:
            return False
        topics = {topic for name in entry.atom.args for topic in needs.get(name, ())}
        return any(fell.get(Atom("ok", (topic,)), onset_ns) < onset_ns for topic in topics)

    return [entry for entry in symptoms if not follows(entry)]


def pending(
    atoms: Collection[Atom],
    onset_ns: int,
    delay_ns: Callable[[Atom], int],
    now_ns: int,
    slack_ns: int = SLACK_NS,
) -> dict[Atom, int]:
    """Return those of the atoms whose observer may still be about to notice, with until when.

    `atoms`: what is known to hold or not known at all. `delay_ns`: an observer's detection time. `slack_ns`:
    how long what it says may be on its way.
    """
    until = {atom: onset_ns + delay_ns(atom) + slack_ns for atom in atoms}
    return {atom: end for atom, end in until.items() if end > now_ns}


def starting(
    known: Collection[Entry],
    began_ns: Mapping[str, int],
    start_up_ns: Callable[[str], tuple[int, int]],
    influences: Callable[[str], Collection[str]],
    publishes: Callable[[str], Collection[str]],
    good_ns: Callable[[Entry], Collection[int]],
    now_ns: int,
    unseen: Collection[str] = (),
) -> dict[Atom, int]:
    """Return those of the symptoms that may be due to something that has just been started, with until when.

    Args:
        known: what is observed; what does not hold of it are the symptoms.
        began_ns: component -> since when it is on, or runs.
        start_up_ns: component -> how long it may take from then until what is said of its own topics shows
            that, and until what is said of what rests on them does.
        influences: component -> the names of what rests on it.
        publishes: component -> the topics that are its own, or its drivers'.
        good_ns: what is known -> times since when it is known to have held all along, until it fell if it
            has.
        unseen: components that nobody saw begin: they were first heard of as they are, and may have been so
            for long. Whatever rests on them and was good since then is not silent because they start.
    """
    symptoms = [entry for entry in known if not entry.positive]
    found: dict[Atom, int] = {}
    for component, began in began_ns.items():
        own_ns, theirs_ns = start_up_ns(component)
        if began + max(own_ns, theirs_ns) <= now_ns:
            continue
        names, own = frozenset(influences(component)), frozenset(publishes(component))
        theirs = [entry for entry in known if own.intersection(entry.atom.args)]
        up_ns = began if component in unseen else _up_ns(theirs, began, good_ns)
        for entry in symptoms:
            atom = entry.atom
            if not names.intersection(atom.args) or component in atom.args:
                continue
            if not theirs and component not in unseen:  # nobody observes it: what rests on it shows it
                up_ns = min((rose for rose in good_ns(entry) if rose > began + GUARD_NS), default=None)
            if up_ns is None or entry.onset_ns is None or entry.onset_ns < up_ns:
                end = began + (theirs_ns if own.isdisjoint(atom.args) else own_ns)
                if end > now_ns:
                    found[atom] = max(end, found.get(atom, 0))
    return found


def returning(
    symptoms: Collection[Entry],
    risen_ns: Mapping[str, int],
    needed: Callable[[Collection[str]], Mapping[str, Collection[str]]],
    settling_ns: Callable[[Atom], int],
    now_ns: int,
) -> dict[Atom, int]:
    """Return those of the symptoms that may be over, as what they rest on has come back, with until when.

    Args:
        symptoms: what does not hold.
        risen_ns: topic that is good -> since when it is.
        needed: names -> for each of them the topics that it rests on.
        settling_ns: what an observer needs to judge anew.
    """
    times = {entry.atom: settling_ns(entry.atom) + SLACK_NS for entry in symptoms}
    slowest_ns = max(times.values(), default=0)
    risen = {topic: since for topic, since in risen_ns.items() if since + slowest_ns > now_ns}
    if not risen:
        return {}
    needs = needed({name for atom in times for name in atom.args})
    found: dict[Atom, int] = {}
    for entry in symptoms:
        inputs = {topic for name in entry.atom.args for topic in needs.get(name, ())} & risen.keys()
        # What fell silent after its input was back, did not wait for it.
        back = [risen[topic] for topic in inputs if entry.onset_ns is None or entry.onset_ns < risen[topic]]
        if back and max(back) + times[entry.atom] > now_ns:
            found[entry.atom] = max(back) + times[entry.atom]
    return found


def _up_ns(own: Collection[Entry], began_ns: int, good_ns: Callable[[Entry], Collection[int]]) -> int | None:
    """Return from when on something that has been started was surely up; None: it may not have been.

    It was up once all that is observed of its own topics had been good since it began. What rests on them
    and was good after that is not silent because it starts. What fell silent before, as it had lost its
    input, may be; so a topic that is good again counts from when it was. Of one that fell silent anew that is
    when it was good before, or else its last sample.
    """
    up_ns: int | None = None
    for entry in own:
        times = [time_ns + GUARD_NS for time_ns in good_ns(entry) if time_ns > began_ns + GUARD_NS]
        onset_ns = 0 if entry.positive else entry.onset_ns or 0
        if onset_ns > began_ns + GUARD_NS:
            times.append(onset_ns - SLACK_NS)
        if not times:
            return None
        up_ns = max(min(times), up_ns or 0)
    return up_ns
