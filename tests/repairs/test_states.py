"""The states of a repair and of its steps: which follow from which, and that nobody writes them by hand."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from robomend.repairs.states import (
    ENDS,
    INITIAL,
    OPEN,
    REPAIR,
    STEP,
    STEP_ENDS,
    RepairState,
    RepairTrigger,
    StepState,
    StepTrigger,
)
from robomend.transitions import after


def targets(state: RepairState) -> set[RepairState]:
    return {then for (before, _), then in REPAIR.items() if before is state}


@given(st.lists(st.sampled_from(StepTrigger), max_size=20))
def test_a_step_that_was_never_sent_is_never_done(walk: list[StepTrigger]) -> None:
    state, sent = StepState.WAITING, False
    for trigger in walk:
        if (state, trigger) in STEP:
            state = after(STEP, state, trigger)
            sent = sent or trigger is StepTrigger.SENT
    assert sent or state is not StepState.DONE
    assert not (sent and state is StepState.ALREADY)


@pytest.mark.parametrize("state", OPEN)
def test_an_open_repair_can_always_be_halted_fail_ask_and_be_taken_up(state: RepairState) -> None:
    assert after(REPAIR, state, RepairTrigger.HALTED) is RepairState.CANCELLED
    assert after(REPAIR, state, RepairTrigger.BROKE) is RepairState.FAILED
    assert after(REPAIR, state, RepairTrigger.QUESTIONED) is RepairState.AWAITING_APPROVAL
    assert after(REPAIR, state, RepairTrigger.TAKEN_UP) is RepairState.WAITING


def test_every_state_can_be_reached_and_only_ends_have_no_way_out() -> None:
    reached, frontier = {INITIAL}, [INITIAL]
    while frontier:
        new = targets(frontier.pop()) - reached
        reached |= new
        frontier += new
    assert reached == set(RepairState)
    assert {state for state in RepairState if not targets(state)} == ENDS
    assert {state for state in StepState if not any(before is state for before, _ in STEP)} <= STEP_ENDS


def test_nothing_is_sent_without_the_policy_or_a_person() -> None:
    leads = {trigger for (_, trigger), then in REPAIR.items() if then is RepairState.RUNNING}
    assert leads == {RepairTrigger.PERMITTED, RepairTrigger.APPROVED}
