"""One message to one recipient: what came of it, in words that hold no secret."""

from __future__ import annotations

import asyncio
import json
import smtplib
import socket
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import httpx

from robomend import webhooks
from robomend.notifications import mail
from robomend.notifications.recipients import Recipient
from robomend.settings import Settings

DELIVERY_S = 30.0
"""Of one call, its look-up included."""

Messages = Sequence[Mapping[str, Any]]


@dataclass(frozen=True, slots=True)
class Delivery:
    """What came of a delivery."""

    delivered: bool
    answer: str


async def deliver(recipient: Recipient, messages: Messages, settings: Settings) -> Delivery:
    """Send these together, as one message."""
    identity = f"notifications-{messages[0]['id']}-{messages[-1]['id']}"
    try:
        async with asyncio.timeout(DELIVERY_S):
            if recipient.webhook is not None:
                return await _called(recipient.webhook, messages, identity)
            return await _mailed(recipient.mail, messages, settings, identity)
    except TimeoutError:
        return Delivery(False, f"no answer in {DELIVERY_S:g} s")


UNREACHED = (
    (httpx.TimeoutException, "no answer in time"),
    (httpx.ConnectError, "nobody listens there, or its certificate is not good"),
    (httpx.TransportError, "the connection broke"),
    (socket.gaierror, "its name leads nowhere"),
)
"""What is told of who was not reached: whoever reads it knows the network, not our library."""


async def _called(hook: webhooks.Webhook, messages: Messages, identity: str) -> Delivery:
    body = json.dumps({"notifications": messages}).encode()
    try:
        address = await webhooks.allowed_address(hook)
        if address is None:
            why = "it leads to a private address, and the setting webhook_hosts does not name its host"
            return Delivery(False, why)
        async with webhooks.client() as client:
            response = await webhooks.post(client, hook, address, identity, body)
    except (httpx.HTTPError, OSError, ValueError) as error:
        why = next((words for kind, words in UNREACHED if isinstance(error, kind)), type(error).__name__)
        return Delivery(False, f"not reached: {why}")
    return Delivery(200 <= response.status_code < 300, f"answered {response.status_code}")


async def _mailed(to: Sequence[str], messages: Messages, settings: Settings, identity: str) -> Delivery:
    if settings.mail_server is None or settings.mail_from is None:
        return Delivery(False, "the settings name no mail_server and mail_from")
    letter = mail.composed(messages, settings.mail_from, to, identity)
    try:
        await asyncio.to_thread(mail.send, settings, letter)
    except smtplib.SMTPResponseException as error:
        return Delivery(False, f"the mail server answered {error.smtp_code}")
    except (OSError, smtplib.SMTPException, ValueError) as error:
        return Delivery(False, f"not sent: {type(error).__name__}")
    return Delivery(True, "taken by the mail server")
