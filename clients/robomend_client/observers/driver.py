"""The one thing that knows the order of events: it feeds observers, asks them, and tells what changes.

    samples ──► in their places ──► observers ──► verdicts ──► combined per atom ──► changes
                      ▲
               ticks of a fixed grid

Live and over a log it is the same code, so a recording that is replayed gives the same literals at the same
times. The rules that make it so:

- An observer is asked on a grid: at multiples of its period while samples come, and at the first multiple of
  GRID_NS that is not before the time it is due. An observer with period 0 is asked after each sample.
- All ticks up to a sample's time come before the sample. A late wake-up makes up for the ticks that it
  missed, with the samples in between in their places.
- Live, a sample's place is the time at which it was taken in (`now_ns`); its own stamp, which a feeder may
  have put on it, only says when it was made. In a log the two are the same.
- Time that nobody looked at (`lapse`: the computer slept, the agent was starved, the clock was set) is not
  silence of the robot. Observers that cannot bear it begin anew; what they said last stands until they have
  judged again, with its old evidence, at most for their settling time.
- In a log, a jump of time of more than JUMP_NS is believed once the next sample confirms it: a stamp from the
  future alone is left out and counted. Back, it means that the log begins again, or the simulation: all
  observers start anew. Live, stamps that are far from the clock are left out and counted.

Several observers may speak of one atom. Bad news wins: the atom holds if all who speak say so; of atoms in
`lenient` it is the other way round. Who does not know has no vote.

`settle(n, atoms)` has the observers of these atoms drop their samples and judge anew. The next change of
each of these atoms carries n, of either sign; None if there is nothing to see within the settling time.

An observer that raises is reset; its atoms are unknown until it speaks again, each place is told once, and
the others go on.
"""

from __future__ import annotations

import heapq
import logging
import traceback
from collections import Counter
from collections.abc import Callable, Collection, Iterable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

from robomend_client.literals import Atom, Literal
from robomend_client.observers.base import SECOND, Evidence, Observer, Patient, Verdict, ns

log = logging.getLogger(__name__)

GRID_NS = 10_000_000
"""Ticks of observers that are due; coarse enough that many of them share a wake-up."""

JUMP_NS = SECOND
"""How far a sample's stamp may be from the time before without being a jump."""

OLDEST_NS = 10 * SECOND
"""Live, a sample that was made longer ago than this comes from another clock, or too late to be of use."""

NEVER = 1 << 62


class Change(NamedTuple):
    """An atom has another value from now on, or was judged anew as it was told to be."""

    time_ns: int
    atom: Atom
    value: Literal | None  # None: unknown from now on
    since_ns: int | None = None
    onset_ns: int | None = None
    settled: int | None = None  # the n of the `settle` that this answers


@dataclass(frozen=True, slots=True)
class ObserverProblem:
    """Something that does not belong: told once for each source or place, and counted."""

    what: str  # "observer", "ahead", "behind", "jump"
    where: str
    message: str


class Listener:
    """What a driver does, for whoever writes it down; see recording.py."""

    def sample(self, source: str, time_ns: int, value: object, now_ns: int) -> None:
        """A sample was taken in."""

    def lapse(self, now_ns: int, until_ns: int) -> None:
        """Nobody looks until then."""

    def settle(self, now_ns: int, n: int, atoms: Collection[Atom]) -> None:
        """Observers were told to judge anew."""

    def restart(self, now_ns: int) -> None:
        """Time begins again, here."""


class Driver:
    """See the module."""

    def __init__(
        self,
        observers: Iterable[Observer],
        start_ns: int,
        *,
        lenient: Collection[Atom] = (),
        on_problem: Callable[[ObserverProblem], None] | None = None,
        listener: Listener | None = None,
    ) -> None:
        """
        Args:
            observers: asked in this order where they are due at the same time.
            start_ns: where time begins: now, or the first stamp of a log.
            lenient: atoms of which good news wins.
            on_problem: told once of each kind of problem; by default it goes to the log.
            listener: told of everything that is taken in.
        """
        self.now_ns = start_ns
        self.problems: Counter[tuple[str, str]] = Counter()
        self._seats = [_Seat(observer, number) for number, observer in enumerate(observers)]
        self._routes: dict[str, _Route] = {}
        self._speakers: dict[Atom, list[_Seat]] = {}
        self._standing: dict[Atom, Literal] = {}
        self._lenient = frozenset(lenient)
        self._settling: dict[Atom, int] = {}
        self._held: tuple[str, int, object] | None = None  # a sample of a log, far from the time before it
        self._on_problem = on_problem or _to_the_log
        self._listener = listener
        self._ticks: list[tuple[int, int]] = []
        self._next_ns = NEVER
        for seat in self._seats:
            for source in seat.observer.sources:
                self._routes.setdefault(source, _Route()).seats.append(seat)
            for atom in seat.observer.atoms:
                self._speakers.setdefault(atom, []).append(seat)
            self._reset(seat, start_ns)

    @property
    def sources(self) -> frozenset[str]:
        """What any of the observers wants to be fed with."""
        return frozenset(self._routes)

    @property
    def atoms(self) -> tuple[Atom, ...]:
        """All that any of them may speak of."""
        return tuple(self._speakers)

    def delays_s(self, atom: Atom) -> tuple[float, float]:
        """Return detection delay and settling time of what is said of `atom`."""
        speakers = [seat.observer for seat in self._speakers[atom]]
        return max(o.detection_s for o in speakers), max(o.settling_s for o in speakers)

    @property
    def next_ns(self) -> int | None:
        """When `advance` will have something to do, if no sample comes before; None: not by itself."""
        return None if self._next_ns == NEVER else self._next_ns

    # --- what happens ---------------------------------------------------------------------------------

    def sample(
        self, source: str, time_ns: int, value: object = None, now_ns: int | None = None
    ) -> Sequence[Change]:
        """Take in one sample; return what changes up to it.

        Args:
            source: where it comes from; one that no observer wants is ignored. time_ns: when it was made.
            value: what the observers of this source understand. now_ns: when it was taken in, live; None in
            a log, whose samples come in the order of their stamps.
        """
        route = self._routes.get(source)
        if route is None:
            return ()
        if now_ns is None:
            now_ns = self.now_ns
            ahead_ns = time_ns - now_ns
            if self._held is not None or not -JUMP_NS <= ahead_ns <= JUMP_NS:
                return self._far(source, time_ns, value)
            if ahead_ns > 0:
                now_ns = time_ns
        else:
            if now_ns < self.now_ns:
                now_ns = self.now_ns
            if time_ns > now_ns:
                if time_ns > now_ns + JUMP_NS:
                    self._leave_out("ahead", source, time_ns - now_ns)
                    return ()
                time_ns = now_ns
            elif time_ns < now_ns - OLDEST_NS:
                self._leave_out("behind", source, time_ns - now_ns)
                return ()
        return self._take(route, source, time_ns, value, now_ns)

    def advance(self, now_ns: int) -> Sequence[Change]:
        """Let time pass: by a timer, or at the end of a log."""
        changes: list[Change] = []
        if self._held is not None and self.now_ns <= self._held[1] <= now_ns:
            changes += self._release()
        changes += self._run(now_ns)
        self.now_ns = max(self.now_ns, now_ns)
        return changes

    def settle(self, n: int, atoms: Collection[Atom]) -> Sequence[Change]:
        """Have all observers of these atoms judge anew, by samples that are made from now on.

        The first verdict on each atom after that carries `n`. Atoms that nobody here observes are ignored.
        """
        ours = [atom for atom in atoms if atom in self._speakers]
        if self._listener is not None and ours:
            self._listener.settle(self.now_ns, n, ours)
        touched: dict[Atom, None] = {}
        for atom in ours:
            self._settling[atom] = n
            for seat in self._speakers[atom]:
                self._refresh(seat)  # what stands until then stands on its newest evidence
                self._reset(seat, self.now_ns, touched)
        return self._combine(touched, self.now_ns)

    def lapse(self, until_ns: int) -> Sequence[Change]:
        """Say that nobody has looked since the last event, nor will until `until_ns`: that is no silence."""
        if self._listener is not None:
            self._listener.lapse(self.now_ns, until_ns)
        lost_ns = until_ns - self.now_ns
        touched: dict[Atom, None] = {}
        for seat in self._seats:
            if seat.waiting or lost_ns > seat.patience_ns:
                self._refresh(seat)
                self._reset(seat, until_ns, touched)
            elif seat.tick_ns <= until_ns:
                self._schedule(seat, _after(until_ns, GRID_NS))
        return self._combine(touched, self.now_ns)

    def restart(self, now_ns: int) -> Sequence[Change]:
        """Begin anew at another time, before or after: all that was known is unknown from now on."""
        if self._listener is not None:
            self._listener.restart(now_ns)
        self._held = None
        self.now_ns = now_ns
        for route in self._routes.values():
            route.newest_ns = now_ns
        for seat in self._seats:
            seat.verdicts.clear()
            self._reset(seat, now_ns)
            seat.end_wait()
        return self._combine(dict.fromkeys(self._speakers), now_ns)

    def standing(self) -> list[Verdict]:
        """Return what holds now, with its present evidence: what a heartbeat says."""
        for seat in self._seats:
            self._refresh(seat)
        return [Verdict(literal, *self._evidence(atom, literal)) for atom, literal in self._standing.items()]

    # --- samples --------------------------------------------------------------------------------------

    def _take(self, route: _Route, source: str, time_ns: int, value: object, now_ns: int) -> Sequence[Change]:
        changes: Sequence[Change] = self._run(now_ns) if now_ns >= self._next_ns else ()
        self.now_ns = now_ns
        if time_ns >= route.newest_ns:
            route.newest_ns = time_ns
        else:
            time_ns = route.newest_ns  # overtaken within its source
        if self._listener is not None:
            self._listener.sample(source, time_ns, value, now_ns)
        for seat in route.seats:
            if time_ns < seat.floor_ns:
                continue  # from before the reset: what it tells is not young enough
            period_ns = seat.period_ns
            try:
                seat.feed(source, time_ns, value)
                if not period_ns:
                    said, due_ns = seat.check(now_ns), seat.due_ns()
                    if said is seat.said and not seat.waiting:
                        if due_ns is not None and not now_ns < seat.tick_ns <= due_ns:
                            self._plan(seat, due_ns, now_ns)
                        continue
            except Exception as error:  # noqa: BLE001  # anybody's observer may raise anything
                changes = [*changes, *self._failed(seat, error)]
                continue
            if not period_ns:
                changes = [*changes, *self._ask_now(seat)]
            elif not seat.fed:
                seat.fed = True
                tick_ns = (now_ns // period_ns + 1) * period_ns
                if tick_ns < seat.tick_ns:
                    self._schedule(seat, tick_ns)
        return changes

    def _far(self, source: str, time_ns: int, value: object) -> Sequence[Change]:
        """A sample of a log that is far from the time before, or the one that follows such a sample."""
        held, self._held = self._held, None
        changes: list[Change] = []
        if held is not None:
            confirmed = time_ns >= held[1] - JUMP_NS
            if held[1] < self.now_ns:  # a jump back: the next one must not lead ahead again
                confirmed = confirmed and time_ns < self.now_ns - JUMP_NS
            if confirmed:
                self._held = held
                changes += self._release()
            else:
                self._leave_out("jump", held[0], held[1] - self.now_ns)
        if self.now_ns - JUMP_NS <= time_ns <= self.now_ns + JUMP_NS:
            now_ns = max(time_ns, self.now_ns)
            return [*changes, *self._take(self._routes[source], source, time_ns, value, now_ns)]
        self._held = (source, time_ns, value)
        return changes

    def _release(self) -> Sequence[Change]:
        """Take in the sample that was held: its jump is real."""
        assert self._held is not None
        (source, time_ns, value), self._held = self._held, None
        changes: list[Change] = []
        if time_ns < self.now_ns - JUMP_NS:
            changes += self.restart(time_ns)
        now_ns = max(time_ns, self.now_ns)
        return [*changes, *self._take(self._routes[source], source, time_ns, value, now_ns)]

    def _leave_out(self, what: str, source: str, by_ns: int) -> None:
        way = "ahead of" if by_ns > 0 else "behind"
        than = "the samples before and after it" if what == "jump" else "this computer's clock"
        self._tell(
            what, source, f"a sample of {source} is {abs(by_ns) / SECOND:.3g} s {way} {than}: left out"
        )

    # --- ticks ----------------------------------------------------------------------------------------

    def _run(self, until_ns: int) -> Sequence[Change]:
        """Ask whoever is due up to `until_ns`, tick by tick."""
        if until_ns < self._next_ns:
            return ()
        changes: list[Change] = []
        ticks = self._ticks
        while ticks and ticks[0][0] <= until_ns:
            tick_ns = ticks[0][0]
            if tick_ns > self.now_ns:
                self.now_ns = tick_ns
            touched: dict[Atom, None] = {}
            # All of one tick before anything is combined: or an atom would flicker between its observers.
            while ticks and ticks[0][0] == tick_ns:
                seat = self._seats[heapq.heappop(ticks)[1]]
                if seat.tick_ns != tick_ns:
                    continue
                self._tick(seat, tick_ns, touched)
            self._set_next()
            if touched:
                changes += self._combine(touched, tick_ns)
        self._set_next()
        return changes

    def _tick(self, seat: _Seat, tick_ns: int, touched: dict[Atom, None]) -> None:
        """Ask an observer if it is due, or if samples came and this is a tick of its own grid."""
        if not seat.waiting and (not seat.fed or tick_ns % seat.period_ns):
            try:
                due_ns = seat.due_ns()
            except Exception as error:  # noqa: BLE001  # anybody's observer may raise anything
                self._failed(seat, error, touched)
                return
            if due_ns is None or due_ns > tick_ns:
                self._plan(seat, due_ns, tick_ns)  # samples have put it off since this tick was planned
                return
        self._ask(seat, tick_ns, touched)

    def _ask_now(self, seat: _Seat) -> Sequence[Change]:
        touched: dict[Atom, None] = {}
        self._ask(seat, self.now_ns, touched)
        return self._combine(touched, self.now_ns) if touched else ()

    def _ask(self, seat: _Seat, now_ns: int, touched: dict[Atom, None]) -> None:
        """Ask one observer; note the atoms on which its word may have changed, and when to ask again."""
        seat.fed = False
        try:
            said = seat.check(now_ns)
            if said is not seat.said or seat.waiting:
                seat.take(said, now_ns, touched)
            due_ns = seat.due_ns()
        except Exception as error:  # noqa: BLE001  # anybody's observer may raise anything
            self._failed(seat, error, touched)
            return
        self._plan(seat, due_ns, now_ns)

    def _plan(self, seat: _Seat, due_ns: int | None, now_ns: int) -> None:
        """Note when to look at an observer again; a time that it was due at, and is past, has had its
        answer.
        """
        tick_ns = NEVER if due_ns is None or due_ns <= now_ns else _after(due_ns - 1, GRID_NS)
        if seat.waiting:
            tick_ns = min(tick_ns, _after(max(seat.patient_until_ns - 1, now_ns), GRID_NS))
        if seat.fed:
            tick_ns = min(tick_ns, _after(now_ns, seat.period_ns))
        if not now_ns < seat.tick_ns <= tick_ns:  # one that is planned, and earlier, will do: it looks again
            self._schedule(seat, tick_ns)

    def _schedule(self, seat: _Seat, tick_ns: int) -> None:
        seat.tick_ns = tick_ns
        if tick_ns == NEVER:
            return
        heapq.heappush(self._ticks, (tick_ns, seat.number))
        if len(self._ticks) > 4 * len(self._seats) + 64:  # mostly of ticks that were overtaken
            self._ticks[:] = [(s.tick_ns, s.number) for s in self._seats if s.tick_ns != NEVER]
            heapq.heapify(self._ticks)
        self._set_next()

    def _set_next(self) -> None:
        self._next_ns = self._ticks[0][0] if self._ticks else NEVER

    def _reset(self, seat: _Seat, time_ns: int, touched: dict[Atom, None] | None = None) -> None:
        """Have an observer judge anew; what it said last stands until then."""
        seat.wait(time_ns)
        try:
            seat.observer.reset(time_ns)
        except Exception as error:  # noqa: BLE001  # anybody's observer may raise anything
            self._failed(seat, error, {} if touched is None else touched, again=False)
            return
        self._schedule(seat, _after(time_ns, GRID_NS))

    # --- verdicts -------------------------------------------------------------------------------------

    def _combine(self, touched: Iterable[Atom], now_ns: int) -> Sequence[Change]:
        """Return the changes among these atoms, by what all their observers say."""
        changes = []
        for atom in touched:
            speakers = self._speakers[atom]
            value = self._value(atom, speakers)
            n = self._settling.get(atom) if self._settling else None
            if n is not None and self._settled(atom, value, speakers):
                del self._settling[atom]
            else:
                n = None
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
                since_ns, onset_ns = self._evidence(atom, value)
                changes.append(Change(now_ns, atom, value, since_ns, onset_ns, n))
        return changes

    def _value(self, atom: Atom, speakers: list[_Seat]) -> Literal | None:
        if len(speakers) == 1:
            found = speakers[0].verdicts.get(atom)
            return None if found is None else found.literal
        wins = atom in self._lenient
        value = None
        for seat in speakers:
            found = seat.verdicts.get(atom)
            if found is not None:
                value = found.literal
                if value.positive is wins:
                    break
        return value

    def _settled(self, atom: Atom, value: Literal | None, speakers: list[_Seat]) -> bool:
        """Return whether the atom's value rests on nothing from before it was to be judged anew."""
        wins = atom in self._lenient
        for seat in speakers:
            if atom not in seat.waiting:
                found = seat.verdicts.get(atom)
                if found is not None and found.literal.positive is wins:
                    return True  # whatever the others will say
        return not any(atom in seat.waiting for seat in speakers)

    def _evidence(self, atom: Atom, value: Literal) -> Evidence:
        """Return what the combined verdict rests on: what decides alone by the youngest, what all say by
        all.
        """
        found = [
            verdict
            for seat in self._speakers[atom]
            if (verdict := seat.verdicts.get(atom)) is not None and verdict.literal.positive is value.positive
        ]
        alone = value.positive is (atom in self._lenient)
        since_ns = (max if alone else min)(verdict.since_ns for verdict in found)
        onsets = [verdict.onset_ns for verdict in found if verdict.onset_ns is not None]
        return Evidence(since_ns, min(onsets, default=None))

    def _refresh(self, seat: _Seat) -> None:
        """Bring the evidence of an observer's verdicts up to date; the verdicts themselves wait for their
        tick.
        """
        if not seat.verdicts:
            return
        try:
            for literal in seat.observer.check(self.now_ns):
                known = seat.verdicts.get(literal.atom)
                if (
                    known is not None
                    and known.literal.positive is literal.positive
                    and literal.atom not in seat.waiting
                ):
                    evidence = seat.observer.evidence(literal.atom, self.now_ns)
                    seat.verdicts[literal.atom] = Verdict(literal, *evidence)
        except Exception as error:  # noqa: BLE001  # it is told, and dealt with, at its next tick
            log.debug("%s: %s", seat.observer, error)

    # --- problems -------------------------------------------------------------------------------------

    def _failed(
        self,
        seat: _Seat,
        error: Exception,
        touched: dict[Atom, None] | None = None,
        again: bool = True,
    ) -> Sequence[Change]:
        """An observer raised: its atoms are unknown until it has judged anew."""
        frames = traceback.extract_tb(error.__traceback__)
        place = f"{frames[-1].filename}:{frames[-1].lineno}" if frames else "?"
        name = f"{type(seat.observer).__name__} of {', '.join(map(str, seat.observer.atoms[:3]))}"
        self._tell("observer", place, f"the {name} failed: {type(error).__name__}: {error} ({place})")
        mine: dict[Atom, None] = {} if touched is None else touched
        seat.verdicts.clear()
        if again:
            self._reset(seat, self.now_ns, mine)
            self._schedule(seat, _after(self.now_ns, SECOND))  # one that fails again and again costs little
        else:
            seat.end_wait()
            seat.tick_ns = NEVER
        mine.update(dict.fromkeys(seat.observer.atoms))
        return self._combine(mine, self.now_ns) if touched is None else ()

    def _tell(self, what: str, where: str, message: str) -> None:
        self.problems[what, where] += 1
        if self.problems[what, where] == 1 and len(self.problems) <= 1000:
            self._on_problem(ObserverProblem(what, where, message))


class _Route:
    """Who wants the samples of one source, and how far it has come."""

    __slots__ = ("newest_ns", "seats")

    def __init__(self) -> None:
        self.seats: list[_Seat] = []
        self.newest_ns = -NEVER


class _Seat:
    """One observer in its driver."""

    __slots__ = (
        "check",
        "due_ns",
        "fed",
        "feed",
        "floor_ns",
        "number",
        "observer",
        "patient_until_ns",
        "period_ns",
        "said",
        "tick_ns",
        "verdicts",
        "waiting",
    )  # fmt: skip

    def __init__(self, observer: Observer, number: int) -> None:
        self.observer = observer
        self.number = number
        self.feed, self.check, self.due_ns = observer.feed, observer.check, observer.due_ns
        self.period_ns = observer.period_ns
        self.fed = False
        self.tick_ns = NEVER
        self.floor_ns = -NEVER
        self.said: tuple[Literal, ...] | None = None  # the newest answer
        self.verdicts: dict[Atom, Verdict] = {}
        self.waiting: frozenset[Atom] = frozenset()  # atoms that were to be judged anew, and are not yet
        self.patient_until_ns = NEVER

    @property
    def patience_ns(self) -> int:
        """So long nobody may look: what waits meanwhile comes all at once, and changes no verdict."""
        observer = self.observer
        try:
            patience_s = observer.patience_s if isinstance(observer, Patient) else observer.detection_s
            return ns(min(patience_s, observer.detection_s / 2))
        except Exception:  # noqa: BLE001  # anybody's observer may raise anything: then it judges anew
            return -1

    def wait(self, time_ns: int) -> None:
        """It judges anew from `time_ns` on."""
        self.floor_ns = time_ns
        self.waiting = frozenset(self.observer.atoms)
        self.patient_until_ns = time_ns + ns(self.observer.settling_s) + GRID_NS
        self.said = None

    def end_wait(self) -> None:
        self.waiting = frozenset()

    def take(self, said: tuple[Literal, ...], now_ns: int, touched: dict[Atom, None]) -> None:
        """Take down what it says; what it does not say is unknown, or stands while it is waited for."""
        self.said = said
        old = self.verdicts
        evidence = self.observer.evidence
        new = {literal.atom: Verdict(literal, *evidence(literal.atom, now_ns)) for literal in said}
        if self.waiting:
            patient = now_ns < self.patient_until_ns
            for atom in self.observer.atoms:
                if atom not in self.waiting:
                    continue
                if atom in new or not patient:
                    self.waiting -= {atom}
                    touched[atom] = None
                elif atom in old:
                    new[atom] = old[atom]
        for atom, verdict in new.items():
            known = old.get(atom)
            if known is None or known.literal.positive is not verdict.literal.positive:
                touched[atom] = None
        touched.update((atom, None) for atom in old if atom not in new)
        self.verdicts = new


def _after(time_ns: int, period_ns: int) -> int:
    """Return the first multiple of `period_ns` after a time."""
    return (time_ns // period_ns + 1) * period_ns


def _to_the_log(problem: ObserverProblem) -> None:
    log.warning("%s", problem.message)
