"""Whom the settings may name, and what is shown of them."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from robomend.notifications.recipients import recipients
from robomend.settings import Settings, SettingsError, load, shown

HOOK = {"name": "duty", "url": "https://ops:8443/services/T0KEN?key=K3Y", "secret": "s3cret"}
MAIL = {"name": "night", "mail": ["ann@b.example"]}
BY_MAIL = {"mail_server": "mail.b.example:587", "mail_from": "r@b.example"}


def refused(**settings: Any) -> str:
    with pytest.raises(SettingsError) as caught:
        load(settings, {}, None)
    return str(caught.value)


def test_a_file_names_them(tmp_path: Path) -> None:
    file = tmp_path / "robomend.yaml"
    file.write_text(
        "public_url: https://robots.example\n"
        "mail_server: mail.b.example:587\nmail_from: robomend@b.example\nmail_user: r\nmail_password: pa55\n"
        "notify:\n"
        "- {name: duty, url: 'https://hooks.example/x', secret: s3cret, robots: ['lab-*']}\n"
        "- {name: night, mail: [ann@b.example], about: [stop, escalated]}\n"
    )
    settings, _ = load({}, {}, file)
    found = recipients(settings)
    assert list(found) == ["duty", "night"]
    assert found["duty"].robots == ("lab-*",)
    assert found["duty"].about == {"approval", "escalated", "change", "unknown", "stop"}
    assert found["night"].about == {"stop", "escalated"}


def test_nothing_secret_is_shown() -> None:
    settings = Settings.model_validate(
        {"notify": [HOOK], **BY_MAIL, "mail_user": "r", "mail_password": "pa55"}
    )
    [duty] = recipients(settings).values()
    assert duty.shown == "https://ops:8443/…"
    for text in (str(shown(settings)), repr(settings), repr(duty)):
        for secret in ("s3cret", "K3Y", "pa55"):
            assert secret not in text


@pytest.mark.parametrize(
    ("recipient", "more", "why"),
    [
        ({"name": "duty"}, {}, "needs a url with its secret, or mail"),
        ({**HOOK, "mail": ["ann@b.example"]}, BY_MAIL, "not both"),
        ({"name": "duty", "url": "https://h.example/"}, {}, "secret"),
        ({**HOOK, "url": "ftp://h.example/"}, {}, "no http or https address"),
        ({**HOOK, "url": "http://127.0.0.1/"}, {}, "webhook_hosts"),
        ({**HOOK, "url": "http://u:p@h.example/"}, {}, "no user and password"),
        (MAIL, {}, "mail_server"),
        ({**MAIL, "mail": ["ann"]}, BY_MAIL, "no mail address"),
        ({**MAIL, "mail": ["a@b.example\nBcc: c@d.example"]}, BY_MAIL, "no mail address"),
        ({**MAIL, "about": ["everything"]}, BY_MAIL, "notify.0.about.0"),
        ({**MAIL, "name": "a b"}, BY_MAIL, "notify.0.name"),
    ],
)
def test_what_can_never_work_is_refused_at_the_start(
    recipient: dict[str, Any], more: dict[str, Any], why: str
) -> None:
    said = refused(notify=[recipient], **more)
    assert why in said
    assert "s3cret" not in said


def test_two_recipients_have_two_names() -> None:
    assert "one name" in refused(notify=[HOOK, HOOK])


def test_a_password_is_not_sent_in_the_clear() -> None:
    assert "TLS" in refused(**BY_MAIL, mail_tls="none", mail_user="r", mail_password="p")


@pytest.mark.parametrize(
    "url", ["robots.example", "ftp://h/", "https://u@h/", "https://h/?q=1", "https://h/ x"]
)
def test_a_public_url_is_one_that_links_can_begin_with(url: str) -> None:
    assert "public_url" in refused(public_url=url)
