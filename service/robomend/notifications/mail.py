"""Messages by mail, over SMTP (RFC 5321) with the standard library."""

from __future__ import annotations

import smtplib
import socket
import ssl
from collections.abc import Mapping, Sequence
from email.message import EmailMessage
from email.utils import formatdate
from typing import Any

from robomend.settings import Settings

TIMEOUT_S = 20.0
"""Of each word with the server."""

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


def send(settings: Settings, mail: EmailMessage) -> None:
    """Hand a mail to the server of the settings. Blocking, with bounds.

    Raises:
        OSError, smtplib.SMTPException: it was not taken, by nobody or for nobody.
    """
    assert settings.mail_server is not None
    host, _, port = settings.mail_server.rpartition(":")
    name = socket.gethostname()
    context = ssl.create_default_context()
    if settings.mail_tls == "tls":
        server: smtplib.SMTP = smtplib.SMTP_SSL(host, int(port), name, timeout=TIMEOUT_S, context=context)
    else:
        server = smtplib.SMTP(host, int(port), name, timeout=TIMEOUT_S)
    with server:
        if settings.mail_tls == "starttls":
            server.starttls(context=context)
        if settings.mail_user is not None and settings.mail_password is not None:
            server.login(settings.mail_user, settings.mail_password.get_secret_value())
        server.send_message(mail)


def _one_line(text: str) -> str:
    return " ".join(text.split())
