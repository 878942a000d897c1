"""The multiple observer: one topic answers another in time."""

from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st

from robomend_client.literals import Atom
from robomend_client.observers import Answers, Evidence, MultipleObserver, ns

MAP = Atom("ok", ("map_triggered",))


def observer(**answers: object) -> MultipleObserver:
    return MultipleObserver("map_triggered", "scan", "map", Answers(**answers))  # type: ignore[arg-type]  # two types


def fed(o: MultipleObserver, *happened: tuple[str, float]) -> MultipleObserver:
    for topic, time_s in happened:
        o.feed(topic, ns(time_s))
    return o


def sign(o: MultipleObserver, now_s: float) -> bool | None:
    literals = o.check(ns(now_s))
    return literals[0].positive if literals else None


def test_no_answer_is_told_without_waiting_for_one() -> None:
    o = fed(observer(), ("scan", 1), ("map", 1.2), ("scan", 2))
    assert sign(o, 2.5) is True
    assert o.due_ns() == ns(2.5) + 1
    assert o.check(ns(2.5) + 1)[0].positive is False
    assert o.evidence(MAP, ns(2.6))[:2] == Evidence(ns(2), ns(1.2))[:2]


@given(st.lists(st.tuples(st.booleans(), st.integers(0, 900)), max_size=40))
def test_agrees_with_the_definition(happened: list[tuple[bool, int]]) -> None:
    o, time_ms = observer(lifetime_s=1000), 0
    asked: list[int] = []
    expected: bool | None = None
    for asks, gap_ms in happened:
        time_ms += gap_ms
        overdue = bool(asked) and time_ms - asked[0] > 500
        before = o.check(time_ms * 1_000_000)
        early = expected is True and time_ms < 500  # after the start, no answer could not be known yet
        assert [literal.positive for literal in before] == (
            [False] if overdue else [] if expected is None or early else [expected]
        )
        if asks:
            asked.append(time_ms)
        elif asked:
            expected = time_ms - asked[0] <= 500
            asked = []
        o.feed("scan" if asks else "map", time_ms * 1_000_000)
