"""The kind `systemd`: units are started, stopped, restarted or reloaded by systemctl, which waits for the
end of it.

    restart_camera: {kind: systemd, verb: restart, units: {camera_node: camera.service}}
    start_node: {kind: systemd, units: {camera_node: camera.service}}       # verb: start, by its name

`units` maps the action's parameter to the unit. The agent needs the right to do so: a user's units (`user:
true`), or a polkit rule for these units.
"""

from __future__ import annotations

import re
from collections.abc import Mapping

from robomend_client.actions import OK, Action, ActionResult, Feedback
from robomend_client.agent.executors.program import run

VERBS = ("start", "stop", "restart", "reload")
UNIT = re.compile(r"[A-Za-z0-9:_.@\\][A-Za-z0-9:_.@\\-]*\Z")
"""The letters of systemd.unit(5); one that begins with `-` would be an option."""


class Units:
    """Acts on units of systemd."""

    def __init__(
        self, name: str, units: Mapping[str, str], verb: str | None = None, user: bool = False
    ) -> None:
        """
        Args:
            name: the action, as the plan has it; by default the entry's name.
            units: the action's parameter → the unit.
            verb: start, stop, restart or reload; by default the name's first word.
            user: whether they are units of the agent's user, not of the system.
        """
        verb = verb or name.partition("_")[0]
        if verb not in VERBS:
            raise ValueError(f"verb must be one of {', '.join(VERBS)}, not {verb!r}")
        if not units:
            raise ValueError("units must map a parameter to a unit, e.g. {camera_node: camera.service}")
        for unit in units.values():
            if not UNIT.match(unit):
                raise ValueError(f"units: {unit!r} is no unit's name")
        self.name = name
        self.gives_up = False  # systemd goes on with its job
        self.parameters = (tuple(units),)
        self._units = dict(units)
        self._verb = verb
        self._systemctl = ["systemctl", *(["--user"] if user else []), "--no-ask-password"]
        self._command = [*self._systemctl, verb, "--"]

    async def execute(self, action: Action, feedback: Feedback) -> ActionResult:
        unit = self._units[action.parameters[0]]
        if self._verb == "start":
            asked = [*self._systemctl, "is-active", "--quiet", "--", unit]
            if (await run(asked, str(action), feedback)).code == OK:
                return ActionResult(OK, f"runs already: {unit} is active")
        return await run([*self._command, unit], str(action), feedback)
