"""Send one goal to an action server and wait for its end: `action SERVER PACKAGE/action/TYPE FIELD=VALUE …`.

    actions:
      dock: {kind: process, gives_up: true, parameters: {dock: [home, lab]},
             command: [ros2, run, robomend_ros, action, /dock, nav2_msgs/action/DockRobot, "dock_id={dock}"]}

Fields of messages in the goal are dotted: pose.position.x=1.5. Ended by SIGTERM, it cancels the goal.
Exit code 0: the goal succeeded; 1: it was aborted, rejected or cancelled; 2: usage; 4: nobody answers.
"""

from __future__ import annotations

import json
import signal
import sys
from typing import Any, Callable, Sequence

import rclpy
from action_msgs.msg import GoalStatus
from rclpy.action import ActionClient

from robomend_ros.types import load_message

WAIT_S = 10.0
DONE, FAILED, USAGE, NOBODY = 0, 1, 2, 4
LOOK_S = 0.1


def fill(message: Any, given: Sequence[str]) -> Any:
    """Set the fields of a message.

    Raises:
        AttributeError, TypeError, ValueError, AssertionError: it has no such field, or of another type.
    """
    for text in given:
        path, equals, value = text.partition("=")
        if not equals:
            raise ValueError(f"{text!r} is no FIELD=VALUE")
        *way, name = path.split(".")
        part = message
        for step in way:
            part = getattr(part, step)
        now = getattr(part, name)
        setattr(part, name, value if isinstance(now, str) else type(now)(json.loads(value)))
    return message


def ask(node: Any, server: str, kind: Any, goal: Any, given_up: Callable[[], bool]) -> tuple[int, str]:
    """Send the goal; return the exit code and what there is to say. `given_up` says whether to cancel."""
    client = ActionClient(node, kind, server)
    if not client.wait_for_server(timeout_sec=WAIT_S):
        return NOBODY, f"there is no action server {server}"
    sent = client.send_goal_async(goal)
    rclpy.spin_until_future_complete(node, sent, timeout_sec=WAIT_S)
    if not sent.done():
        return NOBODY, f"{server} does not answer within {WAIT_S:g} s"
    accepted = sent.result()
    if not accepted.accepted:
        return FAILED, f"{server} rejected the goal"
    result = accepted.get_result_async()
    while not result.done() and not given_up():
        rclpy.spin_until_future_complete(node, result, timeout_sec=LOOK_S)
    if not result.done():
        rclpy.spin_until_future_complete(node, accepted.cancel_goal_async(), timeout_sec=1.0)
        return FAILED, f"the goal of {server} was given up"
    if result.result().status != GoalStatus.STATUS_SUCCEEDED:
        return FAILED, f"{server} ended with status {result.result().status}"
    return DONE, f"{server}: {result.result().result}"


def main() -> None:
    ended: list[bool] = []
    rclpy.init()
    for number in (signal.SIGTERM, signal.SIGINT):
        signal.signal(number, lambda *_: ended.append(True))
    try:
        server, kind = sys.argv[1], load_message(sys.argv[2])
        goal = fill(kind.Goal(), sys.argv[3:])
    except (IndexError, ValueError, TypeError, ImportError, AttributeError, AssertionError) as error:
        print(f"action SERVER PACKAGE/action/TYPE FIELD=VALUE …: {error}")
        sys.exit(USAGE)
    code, said = ask(rclpy.create_node("robomend_action"), server, kind, goal, lambda: bool(ended))
    print(said)
    rclpy.shutdown()
    sys.exit(code)


if __name__ == "__main__":
    main()
