"""The states of a drill: what was planted is undone on every way to an end but by a person's word."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from robomend.drills.record import (
    DRILL,
    ENDS,
    INITIAL,
    OPEN,
    DrillState,
    DrillTrigger,
)
from robomend.transitions import NoTransition, after

NOTHING_PLANTED = {DrillTrigger.NOT_POSSIBLE, DrillTrigger.NOT_ACTED, DrillTrigger.WITHDRAWN}


def targets(state: DrillState) -> set[DrillState]:
    return {then for (before, _), then in DRILL.items() if before is state}


@given(st.lists(st.sampled_from(DrillTrigger), max_size=60))
def test_on_a_random_walk_what_may_be_planted_is_undone_or_abandoned(walk: list[DrillTrigger]) -> None:
    state, planted, abandoned = INITIAL, False, False
    for trigger in walk:
        if (state, trigger) not in DRILL:
            with pytest.raises(NoTransition):
                after(DRILL, state, trigger)
            continue
        assert state in OPEN
        state = after(DRILL, state, trigger)
        planted = (planted or trigger is DrillTrigger.BEGUN) and trigger is not DrillTrigger.UNDONE
        planted = planted and trigger not in NOTHING_PLANTED
        planted = planted or trigger is DrillTrigger.LIFTED
        abandoned = abandoned or trigger is DrillTrigger.ABANDONED
        if state in ENDS:
            assert not planted or abandoned


def test_every_state_can_be_reached_and_only_ends_have_no_way_out() -> None:
    reached, frontier = {INITIAL}, [INITIAL]
    while frontier:
        new = targets(frontier.pop()) - reached
        reached |= new
        frontier += new
    assert reached == set(DrillState)
    assert {state for state in DrillState if not targets(state)} == ENDS


def test_nothing_is_planted_before_its_undo_is_written() -> None:
    assert targets(INITIAL) == {DrillState.PLANTING, DrillState.REFUSED, DrillState.CANCELLED}
    befores = {state for (state, _), then in DRILL.items() if then is DrillState.PLANTED}
    assert befores == {DrillState.PLANTING}
