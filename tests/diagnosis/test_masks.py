"""Sets as integers, short and long."""

from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st

from robomend.diagnosis.masks import bits, mask_of, members, outside

health_variables = st.sets(st.one_of(st.integers(1, 70), st.integers(1, 400)))


@given(health_variables)
def test_a_mask_holds_its_members_and_nothing_else(health: set[int]) -> None:
    mask = mask_of(health)
    assert members(mask) == tuple(sorted(health))
    assert bits(mask) == [variable - 1 for variable in sorted(health)]
    every = list(range(1, 401))
    assert outside(every, mask) == [variable for variable in every if variable not in health]
    assert len(every) == 400
