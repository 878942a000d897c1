"""Which observer is looked at next: a heap of ticks, on one grid so that many of them share a wake-up."""

from __future__ import annotations

import heapq
from collections.abc import Iterator, Sequence

from robomend_client.observers.observer_state import NEVER, ObserverState


class Ticks:
    """When each observer is looked at next, by the clock alone."""

    __slots__ = ("_heap", "_states", "next_ns")

    def __init__(self, states: Sequence[ObserverState]) -> None:
        self._states = states
        self._heap: list[tuple[int, int]] = []
        self.next_ns = NEVER
        """The earliest; one that was overtaken since counts too."""

    def schedule(self, state: ObserverState, tick_ns: int) -> None:
        """Look at an observer then, and not when it was to be looked at before."""
        state.tick_ns = tick_ns
        if tick_ns == NEVER:
            return
        heap = self._heap
        heapq.heappush(heap, (tick_ns, state.number))
        if len(heap) > 4 * len(self._states) + 64:  # mostly of ticks that were overtaken
            heap[:] = [(s.tick_ns, s.number) for s in self._states if s.tick_ns != NEVER]
            heapq.heapify(heap)
        self.next_ns = heap[0][0] if heap else NEVER

    def of(self, tick_ns: int) -> Iterator[ObserverState]:
        """Yield, and take out, the observers of this tick; more may be scheduled for it meanwhile."""
        heap = self._heap
        while heap and heap[0][0] == tick_ns:
            state = self._states[heapq.heappop(heap)[1]]
            if state.tick_ns == tick_ns:
                yield state
        while heap and self._states[heap[0][1]].tick_ns != heap[0][0]:  # nobody shall be woken for it
            heapq.heappop(heap)
        self.next_ns = heap[0][0] if heap else NEVER
