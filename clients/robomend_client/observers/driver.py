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
- Live, a sample's place is the time at which it was taken in (`now_ns`), or came, where it waited to be read;
  its own stamp, which a feeder may have put on it, only says when it was made. In a log the two are the same.
- Time that nobody looked at (`lapse`: the computer slept, the agent was starved, the clock was set) is not
  silence of the robot. Observers that cannot bear it begin anew; what they said last stands until they have
  judged again, with its old evidence, at most for their settling time. Where lapses keep them from judging
  again and again, that time is from the first of them; then their atoms are unknown. After a lapse of three
  settling times they are unknown at once.
- So it is with what a feed did not look at (`Contact`): only that source's observers judge anew. While nobody
  looks (LOST) none of them is asked, and after a second their atoms are unknown.
- While the computer is starved (`starved`: the agent is woken late again and again), what others do is late,
  too. Observers of that (`Doubts`) do not call it bad then, where they did not before, but unknown.
- In a log, a jump of time of more than JUMP_NS is believed once the next sample confirms it: a stamp from the
  future alone is left out and counted. Back, it means that the log begins again, or the simulation: all
  observers start anew. Live, stamps that are far from the clock are left out and counted.

Where several observers speak of one atom, combining.py says what holds; observer_state.py has what is kept of
each observer, and whose turn it is, problems.py what is told of those that fail.

`settle(n, atoms)` has the observers of these atoms drop their samples and judge anew. The next change of
each of these atoms carries n, of either sign; None if there is nothing to see within the settling time.

A number that is none (NaN, infinite) is left out, counted, and told once for each source.

An observer that raises is reset; its atoms are unknown until it speaks again, each place is told once, and
the others go on.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from typing import Any

from robomend_client.literals import Atom
from robomend_client.observers.base import (
    SECOND,
    Contact,
    Doubts,
    Listener,
    NoNumber,
    Observer,
    Publishers,
    SeesPublishers,
    Verdict,
    WrongKind,
)
from robomend_client.observers.combining import Change, Combined
from robomend_client.observers.observer_state import GRID_NS, NEVER, ObserverState, Ticks, after
from robomend_client.observers.problems import ObserverProblem, ObserverProblems

log = logging.getLogger(__name__)

JUMP_NS, BACK_NS = SECOND, -SECOND
"""How far a sample's stamp may be from the time before without being a jump, ahead and back."""

OLDEST_NS = 10 * SECOND
"""Live, a sample that was made longer ago than this comes from another clock, or too late to be of use."""


class Driver:
    """See the module."""

    def __init__(
        self,
        observers: Iterable[Observer],
        start_ns: int,
        *,
        lenient: Collection[Atom] = (),
        on_problem: Callable[[ObserverProblem], None] | None = None,
        listeners: Collection[Listener] = (),
    ) -> None:
        """
        Args:
            observers: asked in this order where they are due at the same time.
            start_ns: where time begins: now, or the first stamp of a log.
            lenient: atoms of which good news wins.
            on_problem: told once of each kind of problem; by default it goes to the log.
            listeners: told of everything that is taken in.
        """
        self.now_ns = start_ns
        self.problems = ObserverProblems(on_problem)
        self._states = [ObserverState(observer, number) for number, observer in enumerate(observers)]
        self._combined = Combined(self._states, lenient)
        self._ticks = Ticks(self._states)
        self._routes: dict[str, _Route] = {}
        # What came at one time of a log that is far from the time before it: one sample of each source.
        self._held: list[tuple[str, int, object]] = []
        self._listeners = tuple(listeners)
        self._hearing = [one.sample for one in listeners if type(one).sample is not Listener.sample]
        for state in self._states:
            for source in state.observer.sources:
                self._routes.setdefault(source, _Route()).states.append(state)
            self._reset(state, start_ns)

    @property
    def sources(self) -> frozenset[str]:
        """What any of the observers wants to be fed with."""
        return frozenset(self._routes)

    @property
    def atoms(self) -> tuple[Atom, ...]:
        """All that any of them may speak of."""
        return self._combined.atoms

    def delays_s(self, atom: Atom) -> tuple[float, float]:
        """Return detection delay and settling time of what is said of `atom`."""
        speakers = [state.observer for state in self._combined.speakers(atom)]
        return max(o.detection_s for o in speakers), max(o.settling_s for o in speakers)

    @property
    def next_ns(self) -> int | None:
        """When `advance` will have something to do, if no sample comes before; None: not by itself."""
        return None if self._ticks.next_ns == NEVER else self._ticks.next_ns

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
        try:
            route = self._routes[source]
        except KeyError:
            return ()
        if value is not None:
            if type(value) is Contact:
                return self.look(source, value, time_ns if now_ns is None else now_ns)
            if type(value) is Publishers:
                return self.publishers(source, value.nodes, time_ns if now_ns is None else now_ns)
        if now_ns is None:
            now_ns = self.now_ns
            ahead_ns = time_ns - now_ns
            if ahead_ns > JUMP_NS or ahead_ns < BACK_NS or self._held:
                return self._far(source, time_ns, value)
            if ahead_ns > 0:
                now_ns = time_ns
        else:
            if now_ns < self.now_ns:
                now_ns = self.now_ns
            if time_ns > now_ns:
                if time_ns > now_ns + JUMP_NS:
                    self.problems.left_out("ahead", source, time_ns - now_ns)
                    return ()
                time_ns = now_ns
            elif time_ns < now_ns - OLDEST_NS:
                self.problems.left_out("behind", source, time_ns - now_ns)
                return ()
        changes: Sequence[Change] = self._run(now_ns) if now_ns >= self._ticks.next_ns else ()
        self.now_ns = now_ns
        if time_ns >= route.newest_ns:
            route.newest_ns = time_ns
        else:
            time_ns = route.newest_ns  # overtaken within its source
        for hear in self._hearing:
            hear(source, time_ns, value, now_ns)
        if route.lost_ns is not None and time_ns >= route.lost_ns:
            changes = [*changes, *self._looked(route, source, Contact.BACK)]
        for state in route.states:
            if (time_ns < state.floor_ns and not state.latched) or state.blind:
                continue  # from before the reset: what it tells is not young enough
            try:
                state.feed(source, time_ns, value)
                if state.fed:
                    continue  # it has its turn
                period_ns = state.period_ns
                if not period_ns:
                    said, due_ns = state.check(now_ns), state.due_ns()
                    if said is state.said and not state.waiting:
                        if due_ns is not None and due_ns < state.tick_ns:
                            self._ticks.plan(state, due_ns, now_ns)
                        continue
            except NoNumber:
                self.problems.no_number(source)
                continue
            except Exception as error:  # noqa: BLE001  # anybody's observer may raise anything
                changes = [*changes, *self._failed(state, error, source=source)]
                continue
            if not period_ns:
                changes = [*changes, *self._ask_now(state)]
            else:
                state.fed = True
                tick_ns = (now_ns // period_ns + 1) * period_ns
                if tick_ns < state.tick_ns:
                    self._ticks.schedule(state, tick_ns)
        return changes

    def quiet(self, samples: Samples, gap_ns: int, until_ns: int) -> bool:
        """Take in a stretch of a log at once if no verdict changes in it; else nothing is taken in: False.

        Args:
            samples: by their sources; of each none is before another.
            gap_ns: the longest time without any of them, from now on.
            until_ns: the newest of them.
        """
        if self._held or gap_ns > JUMP_NS:
            return False
        if any(
            int(samples[one][0][0]) < self._routes[one].newest_ns for one in samples if one in self._routes
        ):
            return False
        taking = steady(self._states, samples, self.now_ns, until_ns)
        if taking is None:
            return False
        self.now_ns = until_ns
        for source, route in self._routes.items():
            if source in samples:
                route.newest_ns = int(samples[source][0][-1])
        for state, take in taking:
            take()
            self._ticks.plan(state, state.due_ns(), until_ns)
        return True

    def advance(self, now_ns: int) -> Sequence[Change]:
        """Let time pass: by a timer, or at the end of a log."""
        changes: list[Change] = []
        if self._held:
            if self.now_ns <= self._held[0][1] <= now_ns:
                changes += self._release()
            else:  # nothing has confirmed it
                self._leave_out()
        changes += self._run(now_ns)
        self.now_ns = max(self.now_ns, now_ns)
        return changes

    def settle(self, n: int, atoms: Collection[Atom]) -> Sequence[Change]:
        """Have all observers of these atoms judge anew, by samples that are made from now on.

        The first verdict on each atom after that carries `n`. Atoms that nobody here observes are ignored.
        """
        ours = [atom for atom in atoms if self._combined.speakers(atom)]
        for listener in self._listeners if ours else ():
            listener.settle(self.now_ns, n, ours)
        touched: dict[Atom, None] = {}
        for atom in ours:
            self._combined.settle(n, atom)
            for state in self._combined.speakers(atom):
                self._refresh(state)  # what stands until then stands on its newest evidence
                self._reset(state, max(self.now_ns, state.floor_ns), touched)  # in a lapse, from its end on
        return self._combined.changes(touched, self.now_ns)

    def lapse(self, until_ns: int) -> Sequence[Change]:
        """Say that nobody has looked since the last event, nor will until `until_ns`: that is no silence."""
        for listener in self._listeners:
            listener.lapse(self.now_ns, until_ns)
        lost_ns = until_ns - self.now_ns
        touched: dict[Atom, None] = {}
        for state in self._states:
            if (state.waiting and not state.bears_lapses) or lost_ns > state.patience_ns:
                self._refresh(state)
                self._reset(state, until_ns, touched, lapsed_ns=self.now_ns)
            elif state.tick_ns <= until_ns:
                self._ticks.schedule(state, after(until_ns, GRID_NS))
        return self._combined.changes(touched, self.now_ns)

    def starved(self, yes: bool, now_ns: int) -> Sequence[Change]:
        """Say that this computer has more to do than it can from now on, or no more: what is late may be late
        for that.
        """
        changes = self.advance(now_ns)
        for listener in self._listeners:
            listener.starved(self.now_ns, yes)
        for state in self._states:
            if isinstance(state.observer, Doubts):
                state.observer.starved(yes, self.now_ns)
                state.said = None
                self._ticks.plan(state, None if state.blind else state.due_ns(), self.now_ns)
        return changes

    def look(self, source: str, sight: Contact, now_ns: int) -> Sequence[Change]:
        """Say that nobody looks at a source from now on, or that somebody does again."""
        route = self._routes.get(source)
        if route is None or (sight is Contact.LOST and route.lost_ns is not None):
            return ()
        changes = self.advance(now_ns)
        for listener in self._listeners:
            listener.sight(self.now_ns, source, sight)
        return [*changes, *self._looked(route, source, sight)]

    def publishers(self, source: str, nodes: Sequence[str], now_ns: int) -> Sequence[Change]:
        """Say which nodes publish a source: told beside a verdict on its rate; of some it is the verdict."""
        route = self._routes.get(source)
        if route is None:
            return ()
        changes = self.advance(now_ns)
        for listener in self._listeners:
            listener.publishers(self.now_ns, source, nodes)
        for state in route.states:
            if isinstance(state.observer, SeesPublishers):
                state.observer.published_by(nodes, self.now_ns)
                if not state.period_ns:
                    changes = [*changes, *self._ask_now(state)]
        return changes

    def restart(self, now_ns: int) -> Sequence[Change]:
        """Begin anew at another time, before or after: all that was known is unknown from now on."""
        for listener in self._listeners:
            listener.restart(now_ns)
        self._held = []
        self.now_ns = now_ns
        for route in self._routes.values():
            route.newest_ns = now_ns
        for state in self._states:
            state.verdicts.clear()
            self._reset(state, now_ns)
            state.end_wait()
        return self._combined.changes(dict.fromkeys(self._combined.atoms), now_ns)

    def standing(self) -> list[Verdict]:
        """Return what holds now, with its present evidence: what a heartbeat says."""
        for state in self._states:
            self._refresh(state)
        return self._combined.standing()

    # --- samples --------------------------------------------------------------------------------------

    def _far(self, source: str, time_ns: int, value: object) -> Sequence[Change]:
        """A sample of a log that is far from the time before, or the one that follows such a sample."""
        changes: list[Change] = []
        if self._held:
            held_ns = self._held[0][1]
            if time_ns == held_ns and all(source != other for other, _, _ in self._held):
                self._held.append(
                    (source, time_ns, value)
                )  # of one message, it may be: that confirms nothing
                return ()
            confirmed = time_ns >= held_ns - JUMP_NS
            if held_ns < self.now_ns:  # a jump back: the next one must not lead ahead again
                confirmed = confirmed and time_ns < self.now_ns - JUMP_NS
            if confirmed:
                changes += self._release()
            else:
                self._leave_out()
        if self.now_ns - JUMP_NS <= time_ns <= self.now_ns + JUMP_NS:
            return [*changes, *self.sample(source, time_ns, value, max(time_ns, self.now_ns))]
        self._held = [(source, time_ns, value)]
        return changes

    def _leave_out(self) -> None:
        """Leave out what was held: nothing confirms its jump."""
        held, self._held = self._held, []
        for source, time_ns, _ in held:
            self.problems.left_out("jump", source, time_ns - self.now_ns)

    def _release(self) -> Sequence[Change]:
        """Take in what was held: its jump is real."""
        held, self._held = self._held, []
        changes: list[Change] = []
        for source, time_ns, value in held:
            if time_ns < self.now_ns - JUMP_NS:
                changes += self.restart(time_ns)
            changes += self.sample(source, time_ns, value, max(time_ns, self.now_ns))
        return changes

    def _looked(self, route: _Route, source: str, sight: Contact) -> Sequence[Change]:
        """Have the observers of a source judge anew, once somebody looks at all that they need."""
        touched: dict[Atom, None] = {}
        route.lost_ns = self.now_ns if sight is Contact.LOST else None
        for state in route.states:
            if sight is Contact.LOST:
                self._refresh(state)  # what stands until then stands on its newest evidence
                state.blind.add(source)
            else:
                state.blind.discard(source)
            # Not from before the end of a lapse: what comes until then has waited.
            self._reset(state, max(self.now_ns, state.floor_ns), touched, lapsed_ns=self.now_ns)
        return self._combined.changes(touched, self.now_ns)

    # --- ticks ----------------------------------------------------------------------------------------

    def _run(self, until_ns: int) -> Sequence[Change]:
        """Ask whoever is due up to `until_ns`, tick by tick."""
        changes: Sequence[Change] = ()
        touched: dict[Atom, None] = {}
        ticks = self._ticks
        tick_ns = ticks.next_ns
        while tick_ns <= until_ns and tick_ns != NEVER:
            if tick_ns > self.now_ns:
                self.now_ns = tick_ns
            state = ticks.pop()
            if state is not None:
                try:
                    if not state.waiting and (not state.fed or tick_ns % state.period_ns):
                        due_ns = None if state.blind else state.due_ns()
                        asked = due_ns is not None and due_ns <= tick_ns
                    else:
                        asked = True  # samples came, and this is a tick of its own grid
                except Exception as error:  # noqa: BLE001  # anybody's observer may raise anything
                    self._failed(state, error, touched)
                else:
                    if asked:
                        self._ask(state, tick_ns, touched)
                    else:
                        ticks.plan(state, due_ns, tick_ns)  # samples have put it off since it was planned
            next_ns = ticks.next_ns
            # All of one tick before anything is combined: or an atom would flicker between its observers.
            if touched and next_ns != tick_ns:
                changes = [*changes, *self._combined.changes(touched, tick_ns)]
                touched.clear()
            tick_ns = next_ns
        return changes

    def _ask_now(self, state: ObserverState) -> Sequence[Change]:
        touched: dict[Atom, None] = {}
        self._ask(state, self.now_ns, touched)
        return self._combined.changes(touched, self.now_ns) if touched else ()

    def _ask(self, state: ObserverState, now_ns: int, touched: dict[Atom, None]) -> None:
        """Ask one observer; note the atoms on which its word may have changed, and when to ask again."""
        state.fed = False
        try:
            said = () if state.blind else state.check(now_ns)
            if said is not state.said or state.waiting:
                state.take(said, now_ns, touched)
            due_ns = None if state.blind else state.due_ns()
        except Exception as error:  # noqa: BLE001  # anybody's observer may raise anything
            self._failed(state, error, touched)
            return
        self._ticks.plan(state, due_ns, now_ns)

    def _reset(
        self,
        state: ObserverState,
        time_ns: int,
        touched: dict[Atom, None] | None = None,
        lapsed_ns: int | None = None,
    ) -> None:
        """Have an observer judge anew; what it said last stands until then."""
        state.wait(time_ns, lapsed_ns)
        try:
            state.observer.reset(time_ns)
        except Exception as error:  # noqa: BLE001  # anybody's observer may raise anything
            self._failed(state, error, {} if touched is None else touched, again=False)
            return
        self._ticks.schedule(state, after(time_ns, GRID_NS))

    def _refresh(self, state: ObserverState) -> None:
        try:
            state.refresh(self.now_ns)
        except Exception as error:  # noqa: BLE001  # it is told, and dealt with, at its next tick
            log.debug("%s: %s", state.observer, error)

    def _failed(
        self,
        state: ObserverState,
        error: Exception,
        touched: dict[Atom, None] | None = None,
        again: bool = True,
        source: str = "",
    ) -> Sequence[Change]:
        """An observer raised: its atoms are unknown until it has judged anew."""
        if isinstance(error, WrongKind):
            self.problems.wrong_kind(source, error)
        else:
            self.problems.failed(state.observer, error)
        mine: dict[Atom, None] = {} if touched is None else touched
        state.verdicts.clear()
        if again:
            self._reset(state, max(self.now_ns, state.floor_ns), mine)
            # One that fails again and again costs little.
            self._ticks.schedule(state, after(self.now_ns, SECOND))
        else:
            state.end_wait()
            state.tick_ns = NEVER
        mine.update(dict.fromkeys(state.observer.atoms))
        return self._combined.changes(mine, self.now_ns) if touched is None else ()


class _Route:
    """Who wants the samples of one source, and how far it has come."""

    __slots__ = ("lost_ns", "newest_ns", "states")

    def __init__(self) -> None:
        self.states: list[ObserverState] = []
        self.lost_ns: int | None = None  # since when nobody looks
        self.newest_ns = -NEVER


# --- stretches of a log in which no verdict changes: their samples are taken in at once.
#
# Most of a log is like that, and what it costs to feed and ask observers message by message is most of what
# it costs to read one. A driver that took a stretch at once says afterwards what it would have said had it
# been fed one by one; where any observer cannot promise that, it is.

Samples = Mapping[str, tuple[Any, Callable[[], Any] | None]]
"""Source -> the times of its samples, an array, and what returns their values, likewise, or None where they
cannot be had at once; None: times suffice."""


def steady(
    states: Iterable[ObserverState], samples: Samples, now_ns: int, until_ns: int
) -> list[tuple[ObserverState, Callable[[], None]]] | None:
    """Return the observers that are fed, each with what takes its samples in; None if a verdict may change.

    Args:
        states: of all observers.
        samples: of the stretch.
        now_ns: where it begins.
        until_ns: the newest of them.
    """
    taking: list[tuple[ObserverState, Callable[[], None]]] = []
    for state in states:
        mine = state.observer.sources & samples.keys()
        if not mine:
            if state.tick_ns <= until_ns:
                return None
            continue
        times_ns, values = samples[next(iter(mine))]
        if (
            state.steady is None
            or state.waiting
            or state.blind
            or state.said is None
            or int(times_ns[0]) < state.floor_ns
        ):
            return None
        try:
            if state.check(now_ns) is not state.said:
                return None
            found = None if values is None else values()
            take = state.steady(times_ns, found, until_ns) if values is None or found is not None else None
        except Exception:  # noqa: BLE001  # anybody's observer may raise anything: then it does so when it is fed
            return None
        if take is None:
            return None
        taking.append((state, _with_turn(state, int(times_ns[-1]), until_ns, take)))
    return taking


def _with_turn(
    state: ObserverState, newest_ns: int, until_ns: int, take: Callable[[], None]
) -> Callable[[], None]:
    """Have it be asked at the next tick of its grid, unless it was since its newest sample."""

    def taken() -> None:
        take()
        state.fed = bool(state.period_ns) and after(newest_ns, state.period_ns) > until_ns

    return taken
