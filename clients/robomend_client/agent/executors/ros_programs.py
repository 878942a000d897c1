"""The kinds `lifecycle` and `launch`: ROS's own programs, run to their end like those of `process`.

    activate: {kind: lifecycle, nodes: {camera_node: /camera}}        # by its name; or `transition: activate`
    calibrate: {kind: launch, package: arm, file: calibrate.launch, arguments: {side: "{arm}"},
                parameters: {arm: [left, right]}}

A lifecycle is changed by robomend_ros, with the robot's own ROS 2. A launch file that goes on running belongs
under `processes:`, whose command may be [roslaunch, …] or [ros2, launch, …]: stopped, all of it is ended.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

from robomend_client.actions import Action, ActionResult, Feedback
from robomend_client.agent.executors.program import TAKES_S, Program, run

TRANSITIONS = ("configure", "activate", "deactivate", "cleanup")
LAUNCHERS = {"ros1": ("roslaunch",), "ros2": ("ros2", "launch")}


class Lifecycle:
    """Makes one change of the lifecycle of nodes."""

    takes_s = TAKES_S

    def __init__(self, name: str, nodes: Mapping[str, str], transition: str | None = None) -> None:
        """
        Args:
            name: the action, as the plan has it; by default the entry's name.
            nodes: the action's parameter → the node's full name.
            transition: configure, activate, deactivate or cleanup; by default the name's first word.
        """
        transition = transition or name.partition("_")[0]
        if transition not in TRANSITIONS:
            raise ValueError(f"transition must be one of {', '.join(TRANSITIONS)}, not {transition!r}")
        if not nodes:
            raise ValueError("nodes must map a parameter to a node, e.g. {camera_node: /camera}")
        for node in nodes.values():
            if not node.startswith("/"):
                raise ValueError(f"nodes: {node!r} must be a node's full name, with its slash")
        self.name = name
        self.gives_up = False  # the node goes on with its change
        self.parameters = (tuple(nodes),)
        self._nodes = dict(nodes)
        self._transition = transition

    async def execute(self, action: Action, feedback: Feedback) -> ActionResult:
        node = self._nodes[action.parameters[0]]
        command = ["ros2", "run", "robomend_ros", "lifecycle", node, self._transition]
        return await run(command, str(action), feedback)


class Launch(Program):
    """Runs a launch file to its end."""

    def __init__(
        self,
        name: str,
        package: str,
        file: str,
        base: Path,
        release: str = "ros2",
        arguments: Mapping[str, str] | None = None,
        parameters: Mapping[str, Sequence[str]] | None = None,
        gives_up: bool = False,
        timeout_s: float = TAKES_S,
    ) -> None:
        """
        Args:
            name: the action, as the plan has it; by default the entry's name.
            package: the ROS package that has the launch file.
            file: the launch file's name.
            base: the folder of the agent's file.
            release: ros1 (roslaunch) or ros2 (ros2 launch).
            arguments: the launch file's own, name → value; `{NAME}` stands for a parameter.
            parameters: name → what it may be, in the order in which the action has them.
            gives_up: whether one that is cut off leaves things as they were.
            timeout_s: how long it may take, in seconds; the robot's configuration at the service may say less
                or more.
        """
        if release not in LAUNCHERS:
            raise ValueError(f"release must be one of {', '.join(LAUNCHERS)}, not {release!r}")
        for key, word in (("package", package), ("file", file)):
            if not word or word.startswith("-"):
                raise ValueError(f"{key} must be a name, not {word!r}")
        given = [f"{key}:={value}" for key, value in (arguments or {}).items()]
        command = [*LAUNCHERS[release], package, file, *given]
        super().__init__(name, command, base, parameters, gives_up=gives_up, timeout_s=timeout_s)
