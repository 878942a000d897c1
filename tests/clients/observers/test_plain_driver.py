"""The driver beside its rules written down plainly: no heap of ticks, and no short way past an observer."""

from __future__ import annotations

from collections.abc import Sequence

from hypothesis import example, given
from hypothesis import strategies as st
from tests.clients.observers.driving import SCAN, Told
from tests.clients.observers.test_paper_kinds import MS, START_NS, eight, happened, stream

from robomend_client.literals import Atom
from robomend_client.observers import (
    SECOND,
    Change,
    Driver,
    GeneralObserver,
    NoNumber,
    Observer,
    QualitativeObserver,
    Rate,
    Trend,
)
from robomend_client.observers.combining import Combined
from robomend_client.observers.observer_state import GRID_NS, NEVER, ObserverState, after


class PlainDriver:
    """driver.py's rules, live and without faults, one after another."""

    def __init__(self, observers: Sequence[Observer], start_ns: int) -> None:
        self.now_ns = start_ns
        self._states = [ObserverState(observer, number) for number, observer in enumerate(observers)]
        self._combined = Combined(self._states, ())
        self._newest_ns: dict[str, int] = {}
        for state in self._states:
            state.wait(start_ns)
            state.observer.reset(start_ns)
            state.tick_ns = after(start_ns, GRID_NS)

    def sample(self, source: str, time_ns: int, value: object, now_ns: int) -> list[Change]:
        changes = self.advance(now_ns)
        time_ns = self._newest_ns[source] = max(time_ns, self._newest_ns.get(source, -NEVER))
        for state in self._states:
            if source not in state.observer.sources or time_ns < state.floor_ns:
                continue
            try:
                state.observer.feed(source, time_ns, value)
            except NoNumber:
                continue
            if state.period_ns:
                state.fed = True
                state.tick_ns = min(state.tick_ns, after(now_ns, state.period_ns))
            else:
                changes += self._asked([state], now_ns)
        return changes

    def advance(self, now_ns: int) -> list[Change]:
        changes: list[Change] = []
        while (tick_ns := min((state.tick_ns for state in self._states), default=NEVER)) <= now_ns:
            due = []
            for state in self._states:
                if state.tick_ns != tick_ns:
                    continue
                due_ns = state.observer.due_ns()
                its_turn = state.fed and tick_ns % state.period_ns == 0
                if state.waiting or its_turn or (due_ns is not None and due_ns <= tick_ns):
                    due.append(state)
                else:
                    self._plan(state, tick_ns)
            changes += self._asked(due, tick_ns)
        self.now_ns = now_ns
        return changes

    def _asked(self, states: Sequence[ObserverState], now_ns: int) -> Sequence[Change]:
        touched: dict[Atom, None] = {}
        for state in states:
            state.fed = False
            said = state.observer.check(now_ns)
            if said is not state.said or state.waiting:  # who says the same again keeps its evidence
                state.take(said, now_ns, touched)
            self._plan(state, now_ns)
        return self._combined.changes(touched, now_ns)

    def _plan(self, state: ObserverState, now_ns: int) -> None:
        due_ns = state.observer.due_ns()
        if due_ns is not None and due_ns <= now_ns:
            due_ns = None if state.due_after is None else state.due_after(now_ns)
        ticks_ns = [NEVER if due_ns is None else -(-due_ns // GRID_NS) * GRID_NS]
        if state.waiting:
            ticks_ns.append(after(max(state.patient_until_ns - 1, now_ns), GRID_NS))
        if state.fed:
            ticks_ns.append(after(now_ns, state.period_ns))
        if not now_ns < state.tick_ns <= min(ticks_ns):
            state.tick_ns = min(ticks_ns)


def several() -> list[Observer]:
    """Return the eight of the paper, some of them several times: other periods, one topic, one atom."""
    return [
        *eight(),
        GeneralObserver("odom:x", Rate(20.0, 4.0, check_s=0.5)),
        GeneralObserver("imu:y", Rate(20.0, 4.0, window=10, pause_s=0.2, test="student_t")),
        QualitativeObserver("x", "odom:x", Trend(check_s=0.0)),
        QualitativeObserver("y", "imu:y", Trend(slope=1.0, debounce_s=0.1, check_s=0.03, wraps_at=6.28)),
        Told("ask", SCAN),
        Told("answer", SCAN),
    ]


Stream = list[tuple[tuple[str, object], int]]


def phase(sources: Sequence[str], gap_ms: int, slope: float, count: int) -> Stream:
    """Return samples of topics at their rates, and of a value that goes its way."""
    found: Stream = []
    for k in range(count):
        for n, source in enumerate(sources):
            value = k * gap_ms / 1000 * slope if ":" in source else None
            found.append(((source, value), 0 if n else gap_ms))
    return found


# Of random streams nearly every sample is news. Of a robot hardly any is: it stays as it is, for a while.
phases = st.lists(
    st.builds(
        phase,
        st.sampled_from([("scan",), ("odom:x",), ("scan", "odom:x"), ("imu:y", "scan", "odom:x")]),
        st.sampled_from([30, 45, 50, 55, 70, 100, 110, 400]),
        st.sampled_from([0.0, 0.04, 0.2, -0.2, 2.0]),
        st.integers(1, 60),
    ),
    max_size=5,
).map(lambda some: [one for samples in some for one in samples])


@given(st.one_of(happened, phases))
@example(
    [one for n in range(8) for one in phase(("scan", "odom:x"), 50 + 20 * (n % 2), 0.2 - 0.1 * n, 40 + 3 * n)]
)
def test_the_driver_says_what_its_rules_say(told: Stream) -> None:
    plain, driver = PlainDriver(several(), START_NS), Driver(several(), START_NS)
    logged = Driver(several(), START_NS)
    followed = all(gap_ms <= 1000 for _, gap_ms in told)  # a log's jump of time waits to be confirmed
    for now_ns, (source, time_ns, value) in stream(told):
        expected = plain.sample(source, time_ns, value, now_ns)
        assert list(driver.sample(source, time_ns, value, now_ns)) == expected
        if followed:
            assert list(logged.sample(source, time_ns, value)) == expected
    expected = plain.advance(plain.now_ns + 20 * SECOND)
    assert driver.advance(driver.now_ns + 20 * SECOND) == expected
    if followed:
        assert logged.advance(logged.now_ns + 20 * SECOND) == expected
    assert not driver.problems.counts


@given(st.one_of(happened, phases), st.lists(st.integers(0, 900), max_size=60))
def test_samples_that_are_late_are_fed_as_the_rules_say(told: Stream, behind_ms: list[int]) -> None:
    plain, driver = PlainDriver(several(), START_NS), Driver(several(), START_NS)
    behind_ms = behind_ms + [0] * len(told)
    for (now_ns, (source, time_ns, value)), ms in zip(stream(told), behind_ms, strict=False):
        time_ns -= ms * MS
        assert list(driver.sample(source, time_ns, value, now_ns)) == plain.sample(
            source, time_ns, value, now_ns
        )
