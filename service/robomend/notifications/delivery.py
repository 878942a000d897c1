"""One message to one recipient, by webhook or by mail (SMTP, RFC 5321, with the standard library): what came
of it, in words that hold no secret.
"""

from __future__ import annotations

import asyncio
import json
import smtplib
import socket
import ssl
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from email.message import EmailMessage
from email.utils import formatdate
from typing import Any

import httpx

from robomend import webhooks
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
    (httpx.ConnectError, "the connection was refused, or its certificate was"),
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
    letter = composed(messages, settings.mail_from, to, identity)
    try:
        await asyncio.to_thread(send_mail, settings, letter)
    except smtplib.SMTPResponseException as error:
        return Delivery(False, f"the mail server answered {error.smtp_code}")
    except (OSError, smtplib.SMTPException, ValueError) as error:
        return Delivery(False, f"not sent: {type(error).__name__}")
    return Delivery(True, "taken by the mail server")


MAIL_TIMEOUT_S = 20.0
"""Of each word with the mail server."""

SUBJECT_CHARACTERS = 200


def composed(
    notifications: Sequence[Mapping[str, Any]], sender: str, to: Sequence[str], identity: str
) -> EmailMessage:
    """Return one mail that tells all of these; the same `identity` gives the same Message-ID."""
    mail = EmailMessage()
    first = notifications[0]["title"]
    more = f" (and {len(notifications) - 1} more)" if len(notifications) > 1 else ""
    mail["Subject"] = _one_line(f"[robomend] {first}{more}")[:SUBJECT_CHARACTERS]
    mail["From"] = sender
    mail["To"] = ", ".join(to)
    mail["Date"] = formatdate()
    mail["Message-ID"] = f"<{identity}@{sender.rpartition('@')[2].rstrip('>')}>"
    mail["Auto-Submitted"] = "auto-generated"  # RFC 3834: no reply by a machine
    parts = []
    for one in notifications:
        lines = [one["title"], one["time"], *one["text"].splitlines()]
        parts.append("\n".join([*lines, *([one["url"]] if one["url"] else [])]))
    mail.set_content("\n\n".join(parts) + "\n")
    return mail


def send_mail(settings: Settings, mail: EmailMessage) -> None:
    """Hand a mail to the server of the settings. Blocking, with bounds.

    Raises:
        OSError, smtplib.SMTPException: it was not taken, by nobody or for nobody.
    """
    assert settings.mail_server is not None
    host, _, port = settings.mail_server.rpartition(":")
    name = socket.gethostname()
    context = ssl.create_default_context()
    if settings.mail_tls == "tls":
        server: smtplib.SMTP = smtplib.SMTP_SSL(
            host, int(port), name, timeout=MAIL_TIMEOUT_S, context=context
        )
    else:
        server = smtplib.SMTP(host, int(port), name, timeout=MAIL_TIMEOUT_S)
    with server:
        if settings.mail_tls == "starttls":
            server.starttls(context=context)
        if settings.mail_user is not None and settings.mail_password is not None:
            server.login(settings.mail_user, settings.mail_password.get_secret_value())
        server.send_message(mail)


def _one_line(text: str) -> str:
    return " ".join(text.split())
