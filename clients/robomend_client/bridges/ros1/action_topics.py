"""The words of actionlib: the five topics of an action, and the states of a goal.

    NAME/goal, NAME/cancel          client → server
    NAME/status, /feedback, /result server → client

Goals are those of the published system: a list of strings, an integer result, integer feedback.
"""

from __future__ import annotations

from enum import IntEnum
from typing import Any

from robomend_client.bridges.ros1 import formats
from robomend_client.bridges.ros1.node import RosNode
from robomend_client.bridges.ros1.subscription import Publisher

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


def read(node: RosNode, topic: str, expected: str, publisher: Publisher, body: bytes) -> Any:
    """Return a message of one of the five topics; None, and told once, if it is none of the expected type."""
    place = f"{topic} by {publisher.node}"
    if publisher.md5 != formats.message_type(expected).md5:
        node.problems.tell(place, f"{publisher.type} is no {expected}; it is not heard")
        return None
    try:
        return formats.decode(expected, body)
    except Exception as error:  # noqa: BLE001  # anybody's bytes
        node.problems.tell(place, f"cannot be read: {error}"[:200])
        return None
