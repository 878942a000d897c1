"""Which observer is looked at next: a heap of ticks, on one grid so that many of them share a wake-up."""

from __future__ import annotations

from collections.abc import Sequence
from heapq import heapify, heappop, heappush

from robomend_client.observers.observer_state import GRID_NS, NEVER, ObserverState, after


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
