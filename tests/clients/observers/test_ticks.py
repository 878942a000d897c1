"""Whose turn it is: ticks in their order, what is overtaken, and the bound of what is kept."""

from __future__ import annotations

from collections.abc import Iterator

from hypothesis import given
from hypothesis import strategies as st
from tests.clients.observers.driving import Told

from robomend_client.observers.observer_state import NEVER, ObserverState, Ticks, after

STATES = 3


def states() -> list[ObserverState]:
    return [ObserverState(Told("a"), number) for number in range(STATES)]


def of(ticks: Ticks, tick_ns: int) -> Iterator[ObserverState]:
    """Yield the observers of a tick, as the driver takes them out."""
    while ticks.next_ns == tick_ns:
        state = ticks.pop()
        if state is not None:
            yield state


def turns(ticks: Ticks) -> list[tuple[int, int]]:
    """Return when each is looked at, from the first tick to the last."""
    found = []
    while (tick_ns := ticks.next_ns) != NEVER:
        for state in of(ticks, tick_ns):
            state.tick_ns = NEVER
            found.append((tick_ns, state.number))
    return found


@given(st.lists(st.tuples(st.integers(0, STATES - 1), st.integers(0, 9) | st.just(NEVER)), max_size=300))
def test_each_is_looked_at_once_when_it_was_scheduled_last(scheduled: list[tuple[int, int]]) -> None:
    observers = states()
    ticks = Ticks(observers)
    for number, tick_ns in scheduled:
        ticks.schedule(observers[number], tick_ns)
    last = dict(scheduled)
    assert turns(ticks) == sorted((tick, number) for number, tick in last.items() if tick != NEVER)


def test_an_observer_that_is_put_off_again_and_again_takes_no_room() -> None:
    one, other, _ = observers = states()
    ticks = Ticks(observers)
    ticks.schedule(other, 7)
    for tick_ns in range(10_000, 0, -1):
        ticks.schedule(one, tick_ns)
    assert len(ticks._heap) <= 4 * STATES + 65
    assert turns(ticks) == [(1, 0), (7, 1)]


def test_more_may_be_scheduled_for_the_tick_that_is_under_way() -> None:
    one, other, _ = observers = states()
    ticks = Ticks(observers)
    ticks.schedule(one, 5)
    seen = []
    for state in of(ticks, 5):
        seen.append(state.number)
        if state is one:
            ticks.schedule(other, 5)
    assert seen == [0, 1]


def test_a_multiple_after_a_time_is_never_the_time_itself() -> None:
    assert [after(time_ns, 10) for time_ns in (0, 1, 9, 10, 11)] == [10, 10, 10, 20, 20]
