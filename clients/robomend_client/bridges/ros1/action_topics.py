"""The words of actionlib: the five topics of an action, and the states of a goal.

    NAME/goal, NAME/cancel          client → server
    NAME/status, /feedback, /result server → client

Goals are those of the published system: a list of strings, an integer result, integer feedback.
"""

from __future__ import annotations

from enum import IntEnum

from robomend_client.bridges.ros1 import formats

TO_SERVER = {"goal": formats.GOAL, "cancel": formats.CANCEL}
TO_CLIENT = {"status": formats.STATUSES, "feedback": formats.FEEDBACK, "result": formats.RESULT}


class GoalState(IntEnum):
    PENDING = 0
    ACTIVE = 1
    PREEMPTED = 2
    SUCCEEDED = 3
    ABORTED = 4
    REJECTED = 5
    PREEMPTING = 6
    RECALLING = 7
    RECALLED = 8
    LOST = 9


def header(time_ns: int) -> dict[str, object]:
    return {"stamp": formats.stamp(time_ns)}
