"""POST an action to a configured address, signed, and take the answer as its result.

    POST <url>                                   application/json
    X-Robomend-Timestamp: 1761000000             seconds since the epoch
    X-Robomend-Signature: sha256=<hex>           HMAC-SHA256 of "<timestamp>.<body>" with the shared secret
    Idempotency-Key: repair-7:2                  the action id: a receiver that has seen it answers as before
    {"id": "repair-7:2", "name": "reset_usb", "parameters": ["usb1"], "timeout_s": 10}

The receiver answers 2xx with {"code": 0, "message": "…"} when the action is done. A lost connection, 429
and 5xx are tried again with the same id until the action's time is up. Then the outcome is unknown, unless no
call got through (or every one was turned away with 429); a 2xx that says no code leaves it unknown as well,
as the receiver did take the call. Where a webhook may point is checked on every call, after the name was
looked up and against the very address that is then connected to, so that a name cannot change in between.
"""

from __future__ import annotations

import asyncio
import hashlib
import hmac
import ipaddress
import json
import socket
import time
from collections.abc import Collection, Mapping
from dataclasses import dataclass
from typing import Any
from urllib.parse import urlsplit

import httpx

from robomend.errors import InputError
from robomend.repairs.execution_values import Confirm, nobodys
from robomend.repairs.executors.registry import Surroundings
from robomend.robots.configuration import COVERED, shown_url
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

ANSWER_BYTES = 64 * 1024

INSIDE = tuple(
    map(
        ipaddress.ip_network,
        (
            "168.63.129.16/32",  # a public address with metadata for machines of its cloud
            "192.0.0.0/24",  # protocol assignments, another cloud's metadata among them
            "224.0.0.0/4",
            "ff00::/8",
            "::/96",  # IPv4 addresses in disguise: deprecated, translated locally, 6to4
            "64:ff9b:1::/48",
            "2002::/16",
        ),
    )
)
"""Refused although some versions of the standard library take them for addresses of the internet."""

NAT64 = ipaddress.ip_network("64:ff9b::/96")


@dataclass(frozen=True, slots=True)
class Webhook:
    """One receiver. Neither `secret` nor what may be a credential of the address is in logs or answers."""

    url: str
    secret: str
    allow_private: bool = False  # else loopback, private, link-local and metadata addresses are refused

    @property
    def shown(self) -> str:
        """The address as messages have it."""
        return shown_url(self.url)

    def __repr__(self) -> str:
        return f"Webhook(url={self.shown!r}, secret=…, allow_private={self.allow_private})"


def receiver(options: Mapping[str, Any], hosts: Collection[str]) -> Webhook:
    """Return the receiver that an executor's options name.

    Args:
        hosts: those that may have private addresses, from the service's settings: `name` or `name:port`.

    Raises:
        InputError: options that do not fit, or an address that cannot be called.
    """
    unknown = set(options) - {"url", "secret", "allow_private"}
    url, secret = options.get("url"), options.get("secret")
    if unknown or not isinstance(url, str) or not isinstance(secret, str) or not secret:
        raise InputError("a webhook needs url and secret, and takes nothing else")
    try:
        parts = urlsplit(url)
        host, port = (parts.hostname or "").lower(), parts.port
    except ValueError as error:
        raise InputError(f"url: {shown_url(url)!r}: {error}") from error
    if parts.scheme not in ("http", "https") or not host:
        raise InputError(f"url: {shown_url(url)!r} is no http or https address with a host")
    if "@" in parts.netloc:
        raise InputError("url: no user and password in an address; a receiver knows us by `secret`")
    allowed = {name.lower() for name in hosts}
    private = host in allowed or f"{host}:{port or (443 if parts.scheme == 'https' else 80)}" in allowed
    if options.get("allow_private") and not private:
        raise InputError(
            f"allow_private: which private addresses may be called is for the service's own settings to say: "
            f"name {host!r} in webhook_hosts there"
        )
    if not private and _is_inside(host):
        raise InputError(f"url: {host} is a private address, and the setting webhook_hosts does not name it")
    return Webhook(url, secret, private)


def _is_inside(host: str) -> bool:
    """Return whether a host is given by a private address. Names are looked up at each call."""
    try:
        return not outside(host)
    except ValueError:
        return host == "localhost" or host.endswith(".localhost")


def make(action: str, options: Mapping[str, Any], around: Surroundings) -> Executor:
    """Return the receiver that the options name (see registry.MakeExecutor)."""
    try:
        return WebhookExecutor({action: receiver(options, around.webhook_hosts)}, around.confirm)
    except InputError as error:
        raise InputError(f"actions.{action}: {error}") from error


def signature(secret: str, timestamp: str, body: bytes) -> str:
    """Return the value of X-Robomend-Signature; receivers compare it in constant time."""
    digest = hmac.new(secret.encode(), timestamp.encode() + b"." + body, hashlib.sha256).hexdigest()
    return f"sha256={digest}"


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
        async with httpx.AsyncClient(follow_redirects=False, trust_env=False) as client:
            while (left := deadline - time.monotonic()) > 0:
                called = False
                try:
                    async with asyncio.timeout(left):
                        address = await allowed_address(hook)
                        if address is None:
                            why = "a private address, and the setting webhook_hosts does not name its host"
                            return ActionResult(REFUSED, f"{hook.shown} leads to {why}")
                        await self._confirm()
                        called = True
                        response = await _post(client, hook, address, action.id, body)
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


async def allowed_address(hook: Webhook) -> str | None:
    """Return the address that the hook's name leads to now, or None when it may not be called."""
    parts = urlsplit(hook.url)
    port = parts.port or (443 if parts.scheme == "https" else 80)
    loop = asyncio.get_running_loop()
    found = await loop.getaddrinfo(parts.hostname, port, type=socket.SOCK_STREAM)
    for *_, where in found:
        if hook.allow_private or outside(str(where[0])):
            return str(where[0])
    return None


def outside(text: str) -> bool:
    """Return whether an address is one of the internet; what it stands for counts, not how it is written."""
    address = ipaddress.ip_address(text)
    if isinstance(address, ipaddress.IPv6Address):
        if address.ipv4_mapped is not None:
            address = address.ipv4_mapped
        elif address in NAT64:  # the last four bytes
            address = ipaddress.IPv4Address(int(address) & 0xFFFF_FFFF)
    return address.is_global and not any(address in network for network in INSIDE)


async def _post(
    client: httpx.AsyncClient, hook: Webhook, address: str, action_id: str, body: bytes
) -> httpx.Response:
    url = httpx.URL(hook.url)
    timestamp = str(int(time.time()))
    request = client.build_request(
        "POST",
        url.copy_with(host=address),
        content=body,
        headers={
            "Host": url.netloc.decode(),
            "Content-Type": "application/json",
            "Idempotency-Key": action_id,
            "X-Robomend-Timestamp": timestamp,
            "X-Robomend-Signature": signature(hook.secret, timestamp, body),
        },
        extensions={"sni_hostname": url.host},
    )
    response = await client.send(request, stream=True)
    try:
        received = b""
        async for chunk in response.aiter_raw():
            received += chunk
            if len(received) > ANSWER_BYTES:
                raise ValueError("the answer is longer than 64 KiB")
        return httpx.Response(response.status_code, content=received)
    finally:
        await response.aclose()


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
