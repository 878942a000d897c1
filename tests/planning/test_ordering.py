"""Steps of a plan as a partial order, and one order that keeps it."""

from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st

from robomend.planning.ordering import layered


def test_where_the_order_is_free_low_ranks_come_first() -> None:
    assert layered([(), (), ()], lambda position: (-position,)) == [2, 1, 0]
    assert layered([(), (0,), ()], lambda position: (-position,)) == [2, 0, 1]


@given(st.lists(st.integers(0, 5), max_size=8), st.data())
def test_every_step_comes_once_and_after_what_it_comes_after(ranks: list[int], data: st.DataObject) -> None:
    after = [
        tuple(sorted(data.draw(st.sets(st.integers(0, position - 1))))) if position else ()
        for position in range(len(ranks))
    ]
    order = layered(after, lambda position: (ranks[position],))
    assert sorted(order) == list(range(len(ranks)))
    for position, before in enumerate(after):
        assert all(order.index(other) < order.index(position) for other in before)
