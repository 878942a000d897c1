"""Change the lifecycle of a node, once: `lifecycle NODE configure|activate|deactivate|cleanup`.

    actions:
      activate: {kind: process, command: [ros2, run, robomend_ros, lifecycle, "{node}", activate],
                 parameters: {node: [/camera]}}

Exit code 0: done; 1: the node refused it or failed; 2: no such change; 4: nobody answers.
"""

from __future__ import annotations

import sys
from typing import Any

import rclpy
from lifecycle_msgs.msg import Transition
from lifecycle_msgs.srv import ChangeState

WAIT_S = 10.0
CHANGES = {
    "configure": Transition.TRANSITION_CONFIGURE,
    "activate": Transition.TRANSITION_ACTIVATE,
    "deactivate": Transition.TRANSITION_DEACTIVATE,
    "cleanup": Transition.TRANSITION_CLEANUP,
}
DONE, FAILED, USAGE, NOBODY = 0, 1, 2, 4


def change(node: Any, name: str, change: str) -> tuple[int, str]:
    """Change it; return the exit code and what there is to say."""
    client = node.create_client(ChangeState, f"/{name.strip('/')}/change_state")
    if not client.wait_for_service(timeout_sec=WAIT_S):
        return NOBODY, f"there is no lifecycle node {name}"
    request = ChangeState.Request(transition=Transition(id=CHANGES[change]))
    future = client.call_async(request)
    rclpy.spin_until_future_complete(node, future, timeout_sec=WAIT_S)
    if not future.done():
        return NOBODY, f"{name} does not answer within {WAIT_S:g} s"
    if not future.result().success:
        return FAILED, f"{name} refuses to {change}, or failed to"
    return DONE, f"{name}: {change} is done"


def main() -> None:
    if len(sys.argv) < 3 or sys.argv[2] not in CHANGES:
        print("lifecycle NODE " + "|".join(CHANGES))
        sys.exit(USAGE)
    rclpy.init()
    code, said = change(rclpy.create_node("robomend_lifecycle"), sys.argv[1], sys.argv[2])
    print(said)
    rclpy.shutdown()
    sys.exit(code)


if __name__ == "__main__":
    main()
