"""The states of a repair and of its steps: which follow from which, and that nobody writes them by hand."""

from __future__ import annotations

import ast
from collections.abc import Mapping
from enum import StrEnum
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

import robomend
from robomend.repairs.states import (
    ENDS,
    INITIAL,
    OPEN,
    REPAIR,
    STEP,
    STEP_ENDS,
    QueueState,
    RepairState,
    RepairTrigger,
    StepState,
    StepTrigger,
)
from robomend.transitions import NoTransition, after

ROOT = Path(robomend.__file__).parent


def targets(state: RepairState) -> set[RepairState]:
    return {then for (before, _), then in REPAIR.items() if before is state}


@given(st.lists(st.sampled_from(RepairTrigger), max_size=40))
def test_a_random_walk_stays_in_the_table_and_an_end_is_an_end(walk: list[RepairTrigger]) -> None:
    state, ended = INITIAL, False
    for trigger in walk:
        if (state, trigger) not in REPAIR:
            with pytest.raises(NoTransition):
                after(REPAIR, state, trigger)
            continue
        assert not ended
        state = after(REPAIR, state, trigger)
        ended = state in ENDS


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


OTHER_WORDS = {
    # SOVD's states of an execution
    *(("api/routers/sovd.py", word) for word in ("running", "failed")),
    ("repairs/execution_values.py", "failed"),  # of the sentence on a result
    ("repairs/execution_values.py", "done"),  # how an execution ends
    ("api/schemas/batch.py", "running"),  # a batch's states
    ("web/plan_graph.py", "running"),  # the look of a step
    ("web/plan_graph.py", "waiting"),
    ("batches/one_batch.py", "done"),
    ("cli/remote/batches.py", "done"),
    *(("batches/record.py", word) for word in ("done", "failed")),
    ("cli/init/described.py", "running"),  # the predicate
    ("api/schemas/drill.py", "done"),  # what a person says
    ("api/routers/notifications.py", "escalated"),  # what a notification is about
    ("notifications/notices.py", "escalated"),
    ("settings.py", "escalated"),
    ("api/routers/notifications.py", "waiting"),  # a notification, to be delivered
    ("api/routers/status.py", "waiting"),  # for a person: a filter of robots
    ("cli/remote/status.py", "waiting"),
    ("cli/remote/mcp.py", "waiting"),
    ("cli/remote/repairs.py", "cancelled"),  # of the sentence on a decision
    ("notifications/notifier.py", "failed"),  # what became of a try
    ("api/schemas/repair_record.py", "done"),  # how a round ends
    ("cli/drill_run.py", "done"),
    ("cli/drill_run.py", "repaired"),  # a key of the report
    ("drills/score.py", "repaired"),
    ("drills/drills.py", "done"),
    ("drills/one_drill.py", "done"),
    ("repairs/left_off.py", "running"),  # the predicate
    ("repairs/headline.py", "running"),
    ("robots/sight.py", "unconfirmed"),  # an attribute: what acts have made uncertain
    ("repairs/remembering.py", "repaired"),  # a key of an attempt: the components that were
    ("repairs/signals.py", "cancelled"),  # the reason of a cancellation that gives none
    ("web/fleet.py", "waiting"),  # for a person: a filter of the list
    ("web/words.py", "planning"),  # the states' names for people
    ("web/words.py", "running"),
    ("web/words.py", "cancelled"),
    ("web/words.py", "failed"),
}
"""The same words where they are no state of these."""

OTHER_ROOMS = ("model/", "observations/", "diagnosis/", "planning/", "store/")
"""Rooms that know no repair: `running` is a predicate there, `done` a column."""

OTHER_TABLES = {"drills/states.py", "batches/states.py"}


def test_no_state_is_written_by_hand_outside_the_tables() -> None:
    states: set[str] = {str(state) for kind in (RepairState, StepState, QueueState) for state in kind}
    found = set()
    for path in ROOT.rglob("*.py"):
        place = path.relative_to(ROOT).as_posix()
        if place in {"repairs/states.py", *OTHER_TABLES} or place.startswith(OTHER_ROOMS):
            continue
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.Constant) and node.value in states:
                found.add((place, node.value))
    assert found == OTHER_WORDS


@pytest.mark.parametrize("table", [REPAIR, STEP])
def test_triggers_are_told_apart_by_their_words(table: Mapping[tuple[StrEnum, StrEnum], StrEnum]) -> None:
    triggers = {trigger for _, trigger in table}
    assert len({str(trigger) for trigger in triggers}) == len(triggers)
