"""The states of a drill, and how each comes from the one before; docs/drill.md draws the table.

What was planted is undone on every way to an end but one: a person says to leave it.
"""

from __future__ import annotations

from enum import StrEnum


class DrillState(StrEnum):
    """What a drill is in."""

    WAITING = "waiting"  # for its owner; nothing is planted
    PLANTING = "planting"  # its undo is on disk, the act is sent
    PLANTED = "planted"  # watched; repairs may answer it
    UNDOING = "undoing"
    RECOVERING = "recovering"  # undone; the robot must be seen to be healthy
    STOPPED = "stopped"  # by the global stop, which forbids the undo too; it is due when the stop is lifted
    DONE = "done"  # watched to its end, and undone
    CANCELLED = "cancelled"  # cut short, and undone
    REFUSED = "refused"  # nothing was planted
    FAILED = "failed"  # a person is needed


ENDS = frozenset({DrillState.DONE, DrillState.CANCELLED, DrillState.REFUSED, DrillState.FAILED})
"""Nothing is left of a drill but, where it failed, what its reason says."""

OPEN = tuple(state for state in DrillState if state not in ENDS)
"""A robot has one such drill at a time."""

MAYBE_PLANTED = (DrillState.PLANTING, DrillState.PLANTED, DrillState.UNDOING, DrillState.RECOVERING)


class DrillTrigger(StrEnum):
    """What happens to a drill."""

    BEGUN = "the robot is as it must be; the undo is written down"
    NOT_POSSIBLE = "the robot is in use, or not as it must be"
    WITHDRAWN = "cancelled, or the global stop, before anything was planted"
    ACTED = "the fault is there"
    NOT_ACTED = "who should act says that nothing was done"
    WATCHED = "what becomes of it was seen, or its time is over"
    CUT_SHORT = "the act failed, it was cancelled, the service was restarted, or the agent is gone"
    STOPPED = "the global stop"
    LIFTED = "the stop is lifted"
    TRIED_IN_VAIN = "the undo did not work, and is tried again"
    UNDONE = "what was planted is undone"
    WELL = "the robot is healthy"
    WELL_CUT_SHORT = "the robot is healthy, and the drill was cut short"
    NOT_WELL = "it is undone, and the robot is not healthy"
    ABANDONED = "a person says that nothing more is to be undone"


INITIAL = DrillState.WAITING

DRILL: dict[tuple[DrillState, DrillTrigger], DrillState] = {
    (DrillState.WAITING, DrillTrigger.BEGUN): DrillState.PLANTING,
    (DrillState.WAITING, DrillTrigger.NOT_POSSIBLE): DrillState.REFUSED,
    (DrillState.WAITING, DrillTrigger.WITHDRAWN): DrillState.CANCELLED,
    (DrillState.PLANTING, DrillTrigger.ACTED): DrillState.PLANTED,
    (DrillState.PLANTING, DrillTrigger.NOT_ACTED): DrillState.REFUSED,
    (DrillState.PLANTING, DrillTrigger.CUT_SHORT): DrillState.UNDOING,
    (DrillState.PLANTED, DrillTrigger.WATCHED): DrillState.UNDOING,
    (DrillState.PLANTED, DrillTrigger.CUT_SHORT): DrillState.UNDOING,
    (DrillState.UNDOING, DrillTrigger.TRIED_IN_VAIN): DrillState.UNDOING,
    (DrillState.UNDOING, DrillTrigger.UNDONE): DrillState.RECOVERING,
    (DrillState.UNDOING, DrillTrigger.ABANDONED): DrillState.FAILED,
    (DrillState.RECOVERING, DrillTrigger.WELL): DrillState.DONE,
    (DrillState.RECOVERING, DrillTrigger.WELL_CUT_SHORT): DrillState.CANCELLED,
    (DrillState.RECOVERING, DrillTrigger.NOT_WELL): DrillState.FAILED,
    **{(state, DrillTrigger.STOPPED): DrillState.STOPPED for state in MAYBE_PLANTED},
    (DrillState.STOPPED, DrillTrigger.LIFTED): DrillState.UNDOING,
    (DrillState.STOPPED, DrillTrigger.ABANDONED): DrillState.FAILED,
}
