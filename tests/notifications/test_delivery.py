"""One message to one recipient: by a signed call, and by mail."""

from __future__ import annotations

import hashlib
import hmac
import json
import socket
from collections.abc import Iterator
from typing import Any

import pytest
from tests.notifications.receivers import Hook, MailServer, serving

from robomend.notifications.delivery import Delivery, deliver
from robomend.notifications.recipients import recipients
from robomend.settings import Settings

pytestmark = pytest.mark.anyio

MESSAGE = {
    "id": "n-17",
    "about": "approval",
    "robot": "r1",
    "repair": "r-1",
    "time": "2025-11-24T16:00:00.123Z",
    "title": "r1: a plan waits for a yes",
    "text": "diagnosis: jaguar\nplan: power_up(jaguar)",
    "url": "https://robots.example/ui/repairs/r-1",
}
MORE = {**MESSAGE, "id": "n-18", "title": "r2: nothing is known of it\r\nBcc: x@evil.example", "url": None}


@pytest.fixture
def hook() -> Iterator[Hook]:
    server = Hook()
    with serving(server):
        yield server


@pytest.fixture
def mail_server() -> Iterator[MailServer]:
    server = MailServer()
    with serving(server):
        yield server


async def delivered(*messages: dict[str, Any], **settings: Any) -> Delivery:
    found = Settings.model_validate(settings)
    [recipient] = recipients(found).values()
    return await deliver(recipient, messages, found)


def by_hook(hook: Hook) -> dict[str, Any]:
    url = f"http://{hook.host}/told?token=t0ken"
    return {"notify": [{"name": "duty", "url": url, "secret": "s3cret"}], "webhook_hosts": (hook.host,)}


def by_mail(address: str, **more: Any) -> dict[str, Any]:
    return {
        "notify": [{"name": "duty", "mail": ["ann@b.example", "bob@b.example"]}],
        "mail_server": address,
        "mail_from": "robomend@b.example",
        **more,
    }


async def test_a_webhook_is_called_signed_with_all_that_is_due(hook: Hook) -> None:
    assert await delivered(MESSAGE, MORE, **by_hook(hook)) == Delivery(True, "answered 200")
    [(headers, body)] = hook.calls
    assert json.loads(body) == {"notifications": [MESSAGE, MORE]}
    signed = headers["X-Robomend-Timestamp"].encode() + b"." + body
    expected = hmac.new(b"s3cret", signed, hashlib.sha256).hexdigest()
    assert headers["X-Robomend-Signature"] == f"sha256={expected}"
    assert headers["Idempotency-Key"] == "notifications-n-17-n-18"


@pytest.mark.parametrize("status", [302, 404, 500])
async def test_any_other_answer_is_no_delivery(hook: Hook, status: int) -> None:
    hook.status = status
    assert await delivered(MESSAGE, **by_hook(hook)) == Delivery(False, f"answered {status}")


async def test_a_receiver_that_is_not_there_is_not_reached() -> None:
    hook = Hook()
    hook.server_close()
    outcome = await delivered(MESSAGE, **by_hook(hook))
    assert outcome == Delivery(False, "not reached: the connection was refused, or its certificate was")


async def test_a_name_that_leads_inside_is_not_called(hook: Hook, monkeypatch: pytest.MonkeyPatch) -> None:
    def inside(*_: object, **__: object) -> list[Any]:
        return [(socket.AF_INET, socket.SOCK_STREAM, 6, "", ("127.0.0.1", hook.server_port))]

    monkeypatch.setattr(socket, "getaddrinfo", inside)
    url = f"http://rebound.example:{hook.server_port}/"
    outcome = await delivered(MESSAGE, notify=[{"name": "duty", "url": url, "secret": "s"}])
    assert not outcome.delivered
    assert "private address" in outcome.answer
    assert hook.calls == []


async def test_a_mail_tells_all_that_is_due(mail_server: MailServer) -> None:
    outcome = await delivered(MESSAGE, MORE, **by_mail(mail_server.address, mail_tls="none"))
    assert outcome == Delivery(True, "taken by the mail server")
    [(to, mail)] = mail_server.mails
    assert to == ["ann@b.example", "bob@b.example"]
    assert mail["Subject"] == "[robomend] r1: a plan waits for a yes (and 1 more)"
    assert (mail["From"], mail["To"]) == ("robomend@b.example", "ann@b.example, bob@b.example")
    assert mail["Message-ID"] == "<notifications-n-17-n-18@b.example>"
    text = mail.get_content()
    for part in ("power_up(jaguar)", "https://robots.example/ui/repairs/r-1", "r2: nothing is known of it"):
        assert part in text


async def test_what_a_robot_is_called_adds_no_header(mail_server: MailServer) -> None:
    await delivered(MORE, **by_mail(mail_server.address, mail_tls="none"))
    [(to, mail)] = mail_server.mails
    assert mail["Bcc"] is None
    assert to == ["ann@b.example", "bob@b.example"]


async def test_no_mail_goes_out_in_the_clear_unless_the_settings_say_so(mail_server: MailServer) -> None:
    outcome = await delivered(MESSAGE, **by_mail(mail_server.address))
    assert outcome == Delivery(False, "not sent: SMTPNotSupportedError")
    assert mail_server.mails == []


async def test_a_mail_server_that_is_not_there_is_no_delivery() -> None:
    server = MailServer()
    server.server_close()
    assert await delivered(MESSAGE, **by_mail(server.address)) == Delivery(
        False, "not sent: ConnectionRefusedError"
    )
