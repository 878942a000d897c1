"""Who carries out which action of one robot: the usual executors, and what its configuration says otherwise.

    power_up, shutdown        the robot's board, if it has one
    start_node, stop_node     the agent on the node's host
    a user's own actions      the agent, unless the robot's `actions` name another

A program that the service runs itself (`process`) must also be named in the service's own settings: whoever
may configure a robot over HTTP must not thereby choose programs for this computer.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from robomend.errors import InputError
from robomend.planning.policy import POWER_ACTIONS
from robomend.repairs.executors.once import Once
from robomend.repairs.executors.process import ProcessExecutor
from robomend.repairs.executors.webhook import Webhook, WebhookExecutor
from robomend_client.actions import Executor


def executors(
    actions: Iterable[str],
    configured: Mapping[str, Mapping[str, Any]],
    *,
    board: Executor | None,
    agent: Executor,
    programs: Mapping[str, Sequence[str]],
) -> dict[str, Executor]:
    """Return action name -> executor; an action that nobody can carry out is absent.

    Args:
        actions: the action names of the robot's repair domain.
        configured: the robot's `actions`, name -> {"executor": {"kind", "options"} | None, …}.
        board, agent: the robot's own; `agent` also answers for actions that nobody asks for (unreachable).
        programs: name -> argument list, from the service's settings.

    Raises:
        InputError: options that do not fit their kind.
    """
    found: dict[str, Executor] = {}
    for action in actions:
        executor = (configured.get(action) or {}).get("executor")
        if executor is not None:
            kind, options = executor["kind"], dict(executor.get("options") or {})
        else:
            kind, options = ("board" if action in POWER_ACTIONS else "agent"), {}
        if kind == "board":
            if board is not None and action in POWER_ACTIONS:
                found[action] = board
        elif kind == "process":
            found[action] = Once(_process(action, options, programs))
        elif kind == "webhook":
            found[action] = Once(_webhook(action, options))
        else:
            found[action] = agent
    return found


def _process(action: str, options: Mapping[str, Any], programs: Mapping[str, Sequence[str]]) -> Executor:
    name = options.get("program", action)
    if name not in programs:
        known = ", ".join(sorted(programs)) or "none"
        raise InputError(
            f"actions.{action}: the service's settings name no program {name!r} (programs: {known}); "
            "add it there, or let the robot's agent run it"
        )
    return ProcessExecutor({action: programs[name]})


def _webhook(action: str, options: Mapping[str, Any]) -> Executor:
    unknown = set(options) - {"url", "secret", "allow_private"}
    url, secret = options.get("url"), options.get("secret")
    if unknown or not isinstance(url, str) or not isinstance(secret, str):
        raise InputError(f"actions.{action}: a webhook needs url and secret (and may have allow_private)")
    if not url.startswith(("http://", "https://")):
        raise InputError(f"actions.{action}: {url!r} is no http or https address")
    return WebhookExecutor({action: Webhook(url, secret, bool(options.get("allow_private", False)))})
