"""POST an action to a configured address, signed, and take the answer as its result.

    POST <url>                                   application/json
    X-Robomend-Timestamp: 1761000000             seconds since the epoch
    X-Robomend-Signature: sha256=<hex>           HMAC-SHA256 of "<timestamp>.<body>" with the shared secret
    Idempotency-Key: repair-7:2                  the action id: a receiver that has seen it answers as before
    {"id": "repair-7:2", "name": "reset_usb", "parameters": ["usb1"], "timeout_s": 10}

The receiver answers 2xx with {"code": 0, "message": "…"} when the action is done. A lost connection, 429
and 5xx are tried again with the same id until the action's time is up. Then the outcome is unknown, unless no
call got through (or every one was turned away with 429); a 2xx that says no code leaves it unknown as well,
as the receiver did take the call. Who may be called is said in robomend.webhooks.
"""

from __future__ import annotations

import asyncio
import json
import time
from collections.abc import Mapping
from typing import Any

import httpx

from robomend import webhooks
from robomend.errors import InputError
from robomend.redaction import COVERED
from robomend.repairs.execution_values import Confirm, nobodys
from robomend.repairs.executors.registry import Surroundings
from robomend.webhooks import Webhook, receiver
from robomend_client.actions import (
    FAILED,
    OK,
    REFUSED,
    TIMED_OUT,
    UNREACHABLE,
    Action,
    ActionResult,
    Executor,
    Feedback,
)


def make(action: str, options: Mapping[str, Any], around: Surroundings) -> Executor:
    """Return the receiver that the options name (see registry.MakeExecutor)."""
    try:
        return WebhookExecutor({action: receiver(options, around.webhook_hosts)}, around.confirm)
    except InputError as error:
        raise InputError(f"actions.{action}: {error}") from error


class WebhookExecutor:
    """Carries out actions by calling the receivers configured for their names."""

    def __init__(self, hooks: Mapping[str, Webhook], confirm: Confirm = nobodys) -> None:
        """`hooks`: action name -> receiver; `confirm`: see execution_values."""
        self._confirm = confirm
        self._hooks = dict(hooks)

    async def execute(self, action: Action, feedback: Feedback) -> ActionResult:
        hook = self._hooks.get(action.name)
        if hook is None:
            return ActionResult(REFUSED, f"no webhook is configured for {action.name!r}")
        if COVERED in hook.secret + hook.url:  # what somebody put back, or an export left out
            return ActionResult(REFUSED, f"{hook.shown}: its secret is not known here; put it in again")
        deadline = time.monotonic() + action.timeout_s
        body = json.dumps(
            {
                "id": action.id,
                "name": action.name,
                "parameters": list(action.parameters),
                "timeout_s": action.timeout_s,
            }
        ).encode()
        answer = ActionResult(UNREACHABLE, "not called")
        may_have_acted = False
        pause_s = 0.2
        async with webhooks.client() as client:
            while (left := deadline - time.monotonic()) > 0:
                called = False
                try:
                    async with asyncio.timeout(left):
                        address = await webhooks.allowed_address(hook)
                        if address is None:
                            why = "a private address, and the setting webhook_hosts does not name its host"
                            return ActionResult(REFUSED, f"{hook.shown} leads to {why}")
                        await self._confirm()
                        called = True
                        response = await webhooks.post(client, hook, address, action.id, body)
                except (httpx.ConnectError, httpx.ConnectTimeout) as error:
                    answer = ActionResult(UNREACHABLE, f"{hook.shown}: {error}")
                except (TimeoutError, httpx.TimeoutException):
                    may_have_acted |= called
                    break
                except (httpx.HTTPError, OSError, ValueError) as error:
                    may_have_acted |= called
                    answer = ActionResult(UNREACHABLE, f"{hook.shown}: {error}")
                else:
                    if response.status_code != 429 and response.status_code < 500:
                        return _result(hook, response)
                    may_have_acted |= response.status_code != 429  # a gateway that gave up waiting, say
                    answer = ActionResult(UNREACHABLE, f"{hook.shown} answered {response.status_code}")
                feedback(0, f"{answer.message}; trying again")
                await asyncio.sleep(max(0.0, min(pause_s, deadline - time.monotonic())))
                pause_s = min(2 * pause_s, 5.0)
        if may_have_acted:
            why = f" ({answer.message})" if answer.message != "not called" else ""
            return ActionResult(TIMED_OUT, f"{hook.shown} said nothing of it in {action.timeout_s:g} s{why}")
        return answer


def _result(hook: Webhook, response: httpx.Response) -> ActionResult:
    if response.status_code >= 300:
        return ActionResult(FAILED, f"{hook.shown} answered {response.status_code}")
    try:
        answer = json.loads(response.content)
        code = answer["code"]
        message = str(answer.get("message", ""))[:1000]
    except (ValueError, KeyError, TypeError, AttributeError):
        return ActionResult(TIMED_OUT, f"{hook.shown} answered {response.status_code} without a code")
    if isinstance(code, bool) or not isinstance(code, int):
        return ActionResult(TIMED_OUT, f"{hook.shown}: code {code!r} is no integer")
    return ActionResult(OK if code == 0 else code, message)
