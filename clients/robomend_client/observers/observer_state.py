"""What a driver keeps of one observer: when it is asked again, what it said, what it must judge anew."""

from __future__ import annotations

from collections.abc import Sequence
from heapq import heapify, heappop, heappush

from robomend_client.literals import Atom, Literal
from robomend_client.observers.base import DueAgain, Observer, Patient, Steady, Verdict, ns

GRID_NS = 10_000_000
"""Ticks of observers that are due; coarse enough that many of them share a wake-up."""

NEVER = 1 << 62

CHANCES = 3
"""Settling times for which an observer at whose sources nobody looks, now and again, is waited for; after a
lapse of so many none is."""


BLIND_NS = 1_000_000_000
"""So long, at most, what was said last stands while nobody looks: who is back soon is no news."""


class ObserverState:
    """One observer in its driver."""

    __slots__ = (
        "bears_lapses",
        "blind",
        "check",
        "due_after",
        "due_ns",
        "fed",
        "feed",
        "floor_ns",
        "latched",
        "left_ns",
        "number",
        "observer",
        "patient_until_ns",
        "period_ns",
        "said",
        "steady",
        "tick_ns",
        "verdicts",
        "waiting",
    )  # fmt: skip

    def __init__(self, observer: Observer, number: int) -> None:
        self.observer = observer
        self.number = number
        self.feed, self.check, self.due_ns = observer.feed, observer.check, observer.due_ns
        self.due_after = observer.due_after if isinstance(observer, DueAgain) else None
        alone = isinstance(observer, Steady) and len(observer.sources) == 1
        self.steady = observer.steady if alone else None  # type: ignore[attr-defined]  # as it was asked
        self.period_ns = observer.period_ns
        self.fed = False
        self.blind: set[str] = set()  # its sources at which nobody looks
        self.tick_ns = NEVER
        self.floor_ns = -NEVER
        self.latched: bool = getattr(observer, "latched", False)  # what is left out would not come again
        self.bears_lapses: bool = getattr(observer, "bears_lapses", False)  # it holds what happened before
        self.said: tuple[Literal, ...] | None = None  # the newest answer
        self.verdicts: dict[Atom, Verdict] = {}
        self.waiting: frozenset[Atom] = frozenset()  # atoms that were to be judged anew, and are not yet
        self.left_ns = 0  # of the time that it is waited for
        self.patient_until_ns = NEVER

    @property
    def patience_ns(self) -> int:
        """So long nobody may look: what waits meanwhile comes all at once, and changes no verdict."""
        observer = self.observer
        if self.bears_lapses:
            return ns(observer.settling_s / 2)
        try:
            patience_s = observer.patience_s if isinstance(observer, Patient) else observer.detection_s
            return ns(min(patience_s, observer.detection_s / 2))
        except Exception:  # noqa: BLE001  # anybody's observer may raise anything: then it judges anew
            return -1

    def wait(self, time_ns: int, lapsed_ns: int | None = None) -> None:
        """It judges anew from `time_ns` on.

        After a lapse, which began at `lapsed_ns`, with what is left of its chances: one that never gets to
        judge does not stand for ever on what it said once. A lapse after a lapse does not lengthen its time.
        """
        settling_ns = ns(self.observer.settling_s)
        if lapsed_ns is None or not self.waiting:
            self.left_ns = CHANCES * settling_ns
        elif time_ns > lapsed_ns:
            self.left_ns = min(self.left_ns, settling_ns) - max(0, time_ns - self.floor_ns)
        else:
            self.left_ns -= max(0, lapsed_ns - self.floor_ns)
        if lapsed_ns is not None and time_ns - lapsed_ns >= CHANCES * settling_ns:
            self.left_ns = 0  # nobody looked for too long: what was said last says nothing of now
        self.floor_ns = time_ns
        self.fed = self.fed and not self.blind
        self.waiting = frozenset(self.observer.atoms)
        most_ns = min(settling_ns, BLIND_NS) if self.blind else settling_ns
        self.patient_until_ns = time_ns + max(0, min(most_ns, self.left_ns)) + GRID_NS
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
            else:
                new[atom] = _going_on(known, verdict)
        touched.update((atom, None) for atom in old if atom not in new)
        self.verdicts = new

    def refresh(self, now_ns: int) -> None:
        """Bring the evidence of its verdicts up to date; the verdicts themselves wait for their tick."""
        if not self.verdicts or self.blind:
            return
        for literal in self.check(now_ns):
            known = self.verdicts.get(literal.atom)
            if (
                known is not None
                and known.literal.positive is literal.positive
                and literal.atom not in self.waiting
            ):
                verdict = Verdict(literal, *self.observer.evidence(literal.atom, now_ns))
                self.verdicts[literal.atom] = _going_on(known, verdict)


def _going_on(known: Verdict, verdict: Verdict) -> Verdict:
    """Return the newer of two verdicts that agree: an observer that judges anew does not know the onset."""
    if verdict.onset_ns is not None or known.onset_ns is None or verdict.literal.positive:
        return verdict
    return verdict._replace(onset_ns=known.onset_ns)


def after(time_ns: int, period_ns: int) -> int:
    """Return the first multiple of `period_ns` after a time."""
    return (time_ns // period_ns + 1) * period_ns


# --- which observer is looked at next: a heap of ticks, on one grid so that many of them share a wake-up.


class Ticks:
    """When each observer is looked at next, by the clock alone."""

    __slots__ = ("_heap", "_most", "_states", "next_ns")

    def __init__(self, states: Sequence[ObserverState]) -> None:
        self._states = states
        self._heap: list[tuple[int, int]] = []
        self._most = 4 * len(states) + 64
        self.next_ns = NEVER
        """The earliest; one that was overtaken since counts too."""

    def plan(self, state: ObserverState, due_ns: int | None, now_ns: int) -> None:
        """Look at an observer again when it is due, has its turn, or has been waited for.

        A time that it was due at, and is past, has had its answer. A tick that is planned, and earlier, will
        do: it is planned anew there.
        """
        if due_ns is not None and due_ns <= now_ns:
            due_ns = None if state.due_after is None else state.due_after(now_ns)
        tick_ns = NEVER if due_ns is None else (due_ns + (GRID_NS - 1)) // GRID_NS * GRID_NS
        if state.waiting:
            tick_ns = min(tick_ns, after(max(state.patient_until_ns - 1, now_ns), GRID_NS))
        if state.fed:
            turn_ns = (now_ns // state.period_ns + 1) * state.period_ns
            if turn_ns < tick_ns:
                tick_ns = turn_ns
        if not now_ns < state.tick_ns <= tick_ns:
            self.schedule(state, tick_ns)

    def schedule(self, state: ObserverState, tick_ns: int) -> None:
        """Look at an observer then, and not when it was to be looked at before."""
        state.tick_ns = tick_ns
        if tick_ns == NEVER:
            return
        heap = self._heap
        heappush(heap, (tick_ns, state.number))
        if len(heap) > self._most:  # mostly of ticks that were overtaken
            heap[:] = [(s.tick_ns, s.number) for s in self._states if s.tick_ns != NEVER]
            heapify(heap)
        self.next_ns = heap[0][0]

    def pop(self) -> ObserverState | None:
        """Take out the first of the next tick; None if that was overtaken by another of the same observer.

        More may be scheduled for this tick before the next is taken out.
        """
        heap, states = self._heap, self._states
        tick_ns, number = heappop(heap)
        while heap and states[heap[0][1]].tick_ns != heap[0][0]:  # nobody shall be woken for it
            heappop(heap)
        self.next_ns = heap[0][0] if heap else NEVER
        state = states[number]
        return state if state.tick_ns == tick_ns else None
