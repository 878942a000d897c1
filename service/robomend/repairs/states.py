"""The states of a repair, of its steps and of an agent's action, and how each comes from the one before.

The tables are all there is: (state, what happens) → state; what is not in them is refused. The store keeps
the states as text, events and HTTP show them. docs/repair.md draws the first table.
"""

from __future__ import annotations

from enum import StrEnum

from robomend.store.records import AgentAction


class RepairState(StrEnum):
    """What a repair is in."""

    WAITING = "waiting"  # for its turn, or for observers
    PLANNING = "planning"
    AWAITING_APPROVAL = "awaiting-approval"  # of a plan, or an answer to a question
    RUNNING = "running"
    VERIFYING = "verifying"  # the plan has ended: did it help?
    REPAIRED = "repaired"
    UNCONFIRMED = "unconfirmed"  # nothing is known to be wrong, and nobody has seen that it is well
    ESCALATED = "escalated"  # a person is needed
    CANCELLED = "cancelled"
    FAILED = "failed"  # a part of the service failed


ENDS = frozenset(
    {
        RepairState.REPAIRED,
        RepairState.UNCONFIRMED,
        RepairState.ESCALATED,
        RepairState.CANCELLED,
        RepairState.FAILED,
    },
)
"""Nothing happens to a repair any more."""

OPEN = tuple(state for state in RepairState if state not in ENDS)
"""It may still act; a robot has one such repair at a time."""


class RepairTrigger(StrEnum):
    """What happens to a repair."""

    UNHEARD = "an observer is not heard"
    HEARD = "every observer was heard"
    LOOKS_FIRST = "a probe is cheaper than the repair"
    PLANNED = "a plan is chosen"
    NEEDS_APPROVAL = "the policy says approve"
    PERMITTED = "the policy says auto, or a yes covers it; what was waited for has booted"
    APPROVED = "yes"
    OVERTAKEN = "the diagnosis changed meanwhile, or nothing is observed"
    ROUND_ENDED = "every step is done, or one went wrong"
    HEALTHY = "every observation is what a healthy robot shows"
    UNSEEN = "nothing is known to be wrong, and not all that was is seen to be well"
    NEEDS_PERSON = "a person is needed"
    QUESTIONED = "an action that must not be repeated may have acted"
    GO_ON = "a person looked, and says to go on"
    TAKEN_UP = "taken up again, with fresh observations"
    HALTED = "cancelled, or the global stop"
    BROKE = "a part of the service failed"


INITIAL = RepairState.WAITING

REPAIR: dict[tuple[RepairState, RepairTrigger], RepairState] = {
    (RepairState.WAITING, RepairTrigger.UNHEARD): RepairState.WAITING,
    (RepairState.WAITING, RepairTrigger.HEARD): RepairState.PLANNING,
    (RepairState.WAITING, RepairTrigger.LOOKS_FIRST): RepairState.WAITING,
    (RepairState.WAITING, RepairTrigger.PLANNED): RepairState.PLANNING,
    (RepairState.PLANNING, RepairTrigger.UNHEARD): RepairState.WAITING,
    (RepairState.PLANNING, RepairTrigger.LOOKS_FIRST): RepairState.WAITING,
    (RepairState.PLANNING, RepairTrigger.PLANNED): RepairState.PLANNING,
    (RepairState.PLANNING, RepairTrigger.NEEDS_APPROVAL): RepairState.AWAITING_APPROVAL,
    (RepairState.PLANNING, RepairTrigger.PERMITTED): RepairState.RUNNING,
    (RepairState.AWAITING_APPROVAL, RepairTrigger.APPROVED): RepairState.RUNNING,
    (RepairState.AWAITING_APPROVAL, RepairTrigger.OVERTAKEN): RepairState.CANCELLED,
    (RepairState.WAITING, RepairTrigger.OVERTAKEN): RepairState.CANCELLED,
    (RepairState.PLANNING, RepairTrigger.OVERTAKEN): RepairState.CANCELLED,
    (RepairState.VERIFYING, RepairTrigger.OVERTAKEN): RepairState.CANCELLED,
    (RepairState.AWAITING_APPROVAL, RepairTrigger.GO_ON): RepairState.WAITING,
    (RepairState.RUNNING, RepairTrigger.UNHEARD): RepairState.WAITING,
    (RepairState.WAITING, RepairTrigger.PERMITTED): RepairState.RUNNING,
    (RepairState.RUNNING, RepairTrigger.PERMITTED): RepairState.RUNNING,  # another step has waited, too
    (RepairState.RUNNING, RepairTrigger.ROUND_ENDED): RepairState.VERIFYING,
    (RepairState.WAITING, RepairTrigger.ROUND_ENDED): RepairState.VERIFYING,
    (RepairState.VERIFYING, RepairTrigger.UNHEARD): RepairState.WAITING,
    (RepairState.VERIFYING, RepairTrigger.LOOKS_FIRST): RepairState.WAITING,
    (RepairState.VERIFYING, RepairTrigger.PLANNED): RepairState.PLANNING,
    (RepairState.WAITING, RepairTrigger.HEALTHY): RepairState.REPAIRED,
    (RepairState.PLANNING, RepairTrigger.HEALTHY): RepairState.REPAIRED,
    (RepairState.VERIFYING, RepairTrigger.HEALTHY): RepairState.REPAIRED,
    (RepairState.WAITING, RepairTrigger.UNSEEN): RepairState.UNCONFIRMED,
    (RepairState.PLANNING, RepairTrigger.UNSEEN): RepairState.UNCONFIRMED,
    (RepairState.VERIFYING, RepairTrigger.UNSEEN): RepairState.UNCONFIRMED,
    (RepairState.WAITING, RepairTrigger.NEEDS_PERSON): RepairState.ESCALATED,
    (RepairState.PLANNING, RepairTrigger.NEEDS_PERSON): RepairState.ESCALATED,
    (RepairState.RUNNING, RepairTrigger.NEEDS_PERSON): RepairState.ESCALATED,
    (RepairState.VERIFYING, RepairTrigger.NEEDS_PERSON): RepairState.ESCALATED,
    **{(state, RepairTrigger.QUESTIONED): RepairState.AWAITING_APPROVAL for state in OPEN},
    **{(state, RepairTrigger.TAKEN_UP): RepairState.WAITING for state in OPEN},
    **{(state, RepairTrigger.HALTED): RepairState.CANCELLED for state in OPEN},
    **{(state, RepairTrigger.BROKE): RepairState.FAILED for state in OPEN},
}


class ChangeState(StrEnum):
    """What a change of configuration is in."""

    AWAITING_APPROVAL = "awaiting-approval"
    RUNNING = "running"
    CHANGED = "changed"  # the variant was seen to be active
    FAILED = "failed"
    CANCELLED = "cancelled"  # by a person or the global stop, or it was not due any more


class ChangeTrigger(StrEnum):
    """What happens to a change of configuration."""

    PERMITTED = "yes, by a person"
    SEEN = "the variant is seen to be active"
    WENT_WRONG = "an act failed, or its effect is missing; the service ended in the middle of it"
    OVERTAKEN = "it is not due any more, cancelled, or the global stop"


CHANGE: dict[tuple[ChangeState, ChangeTrigger], ChangeState] = {
    (ChangeState.AWAITING_APPROVAL, ChangeTrigger.PERMITTED): ChangeState.RUNNING,
    (ChangeState.AWAITING_APPROVAL, ChangeTrigger.OVERTAKEN): ChangeState.CANCELLED,
    (ChangeState.AWAITING_APPROVAL, ChangeTrigger.WENT_WRONG): ChangeState.FAILED,
    (ChangeState.RUNNING, ChangeTrigger.SEEN): ChangeState.CHANGED,
    (ChangeState.RUNNING, ChangeTrigger.WENT_WRONG): ChangeState.FAILED,
    (ChangeState.RUNNING, ChangeTrigger.OVERTAKEN): ChangeState.CANCELLED,
}


class StepState(StrEnum):
    """How far a step came."""

    WAITING = "waiting"
    RUNNING = "running"
    DONE = "done"
    ALREADY = "already-there"  # its effect was visible: not sent
    FAILED = "failed"


STEP_ENDS = frozenset({StepState.DONE, StepState.ALREADY, StepState.FAILED})


class StepTrigger(StrEnum):
    """What happens to a step."""

    SENT = "its action is sent, or sent again"
    EFFECT_THERE = "OBS shows its effect already"
    EFFECT_SEEN = "its effect was seen"
    WENT_WRONG = "not permitted, not possible, failed, cut off, or its effect is missing"


STEP: dict[tuple[StepState, StepTrigger], StepState] = {
    (StepState.WAITING, StepTrigger.SENT): StepState.RUNNING,
    (StepState.WAITING, StepTrigger.EFFECT_THERE): StepState.ALREADY,
    (StepState.WAITING, StepTrigger.WENT_WRONG): StepState.FAILED,
    (StepState.RUNNING, StepTrigger.SENT): StepState.RUNNING,
    (StepState.RUNNING, StepTrigger.EFFECT_SEEN): StepState.DONE,
    (StepState.RUNNING, StepTrigger.WENT_WRONG): StepState.FAILED,
    (StepState.FAILED, StepTrigger.WENT_WRONG): StepState.FAILED,  # cut off, and then the plan ends
}


class QueueState(StrEnum):
    """Where an agent's action is, as its events say; the store keeps what it follows from."""

    QUEUED = "queued"
    RUNNING = "running"  # the agent has said something
    DONE = "done"

    @classmethod
    def of(cls, action: AgentAction) -> QueueState:
        """Return where an action is."""
        if action.code is not None:
            return cls.DONE
        return cls.RUNNING if action.answered else cls.QUEUED
