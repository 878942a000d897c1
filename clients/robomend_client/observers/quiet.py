"""Stretches of a log in which no verdict changes: their samples are taken in at once.

Most of a log is like that, and what it costs to feed and ask observers message by message is most of what it
costs to read one. A driver that took a stretch at once says afterwards what it would have said had it been
fed one by one; where any observer cannot promise that, it is.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from typing import Any

from robomend_client.observers.base import Steady
from robomend_client.observers.observer_state import ObserverState, after

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
        observer = state.observer
        mine = observer.sources & samples.keys()
        if not mine:
            if state.tick_ns <= until_ns:
                return None
            continue
        times_ns, values = samples[next(iter(mine))]
        if (
            not isinstance(observer, Steady)
            or len(observer.sources) > 1
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
            take = observer.steady(times_ns, found, until_ns) if values is None or found is not None else None
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
