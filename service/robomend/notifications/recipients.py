"""Whom the settings name, and what each is told of."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from fnmatch import fnmatchcase
from typing import Any
from urllib.parse import urlsplit

from robomend.notifications.notices import Notice
from robomend.settings import RecipientSettings, Settings
from robomend.webhooks import Webhook, receiver


@dataclass(frozen=True, slots=True)
class Recipient:
    """Somebody who is told: by a webhook or by mail, not both."""

    name: str
    webhook: Webhook | None
    mail: tuple[str, ...]
    about: frozenset[str]
    robots: tuple[str, ...]  # patterns of ids

    def wants(self, notice: Notice) -> bool:
        """Return whether this is told; what is of no robot concerns whoever is told of such things at all."""
        if notice.about not in self.about:
            return False
        return notice.robot is None or any(fnmatchcase(notice.robot, pattern) for pattern in self.robots)

    @property
    def shown(self) -> str:
        """Where it goes, for people: of an address no more than the host, as its path may be a secret."""
        if self.webhook is None:
            return ", ".join(self.mail)
        parts = urlsplit(self.webhook.url)
        return f"{parts.scheme}://{parts.netloc}/…"


def recipients(settings: Settings) -> Mapping[str, Recipient]:
    """Return them by name, in the order of the settings."""
    return {one.name: _recipient(one, settings) for one in settings.notify}


def _recipient(one: RecipientSettings, settings: Settings) -> Recipient:
    webhook = None
    if one.url is not None:
        secret = "" if one.secret is None else one.secret.get_secret_value()
        options: dict[str, Any] = {"url": one.url.get_secret_value(), "secret": secret}
        webhook = receiver(options, settings.webhook_hosts)
    return Recipient(one.name, webhook, one.mail, frozenset(one.about), one.robots)
