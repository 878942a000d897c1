"""Secrets of a configuration: shown to nobody, kept while the receiver stays."""

from __future__ import annotations

from typing import Any

import pytest

from robomend.errors import InputError
from robomend.redaction import shown_url
from robomend.robots.configuration import covered, uncovered

STARS = "**********"


def hook(kind: str = "webhook", **options: Any) -> dict[str, Any]:
    return {"model": "m", "actions": {"call": {"executor": {"kind": kind, "options": options}}}}


def options(config: Any) -> Any:
    return config["actions"]["call"]["executor"]["options"]


@pytest.mark.parametrize(
    ("url", "shown"),
    [
        ("https://h/a", "https://h/a"),
        ("https://ann:pw@h:1/a", f"https://{STARS}@h:1/a"),
        ("https://a@b@h", f"https://{STARS}@h"),
        ("https://h/a?token=s3cr3t&x=1#f", f"https://h/a?{STARS}"),
        ("https://h?s3cr3t", f"https://h?{STARS}"),
        ("https://h/a#s3cr3t", f"https://h/a#{STARS}"),
        ("https://h/a@b", "https://h/a@b"),
        ("usb-reset", "usb-reset"),
    ],
)
def test_an_address_is_shown_without_its_credentials(url: str, shown: str) -> None:
    assert shown_url(url) == shown


def test_what_an_option_is_called_tells_a_secret_of_any_kind_of_executor() -> None:
    secrets = dict.fromkeys(("secret", "apiKey", "api_key", "auth_token", "Password", "key"), "s3cr3t")
    shown = options(covered(hook("mine", line="/dev/x", keyboard="de", **secrets)))
    assert shown == {"line": "/dev/x", "keyboard": "de", **dict.fromkeys(secrets, STARS)}


def test_put_back_as_it_is_shown_a_configuration_stays_as_it_was() -> None:
    before = hook(url="https://h/a?token=t", secret="s")
    assert uncovered(covered(before), before) == before


def test_a_new_secret_replaces_the_one_before() -> None:
    before = hook(url="https://h/a?token=t", secret="s")
    new = hook(url="https://h/a?token=u", secret="v")
    assert uncovered(new, before) == new


@pytest.mark.parametrize(
    "new",
    [
        hook(url="https://evil.example/a", secret=STARS),
        hook(url=f"https://evil.example/a?{STARS}", secret="mine"),
        hook("mine", url="https://h/a?token=t", secret=STARS),
        hook(url=f"https://h/a?{STARS}", secret="s", token=STARS),
    ],
)
def test_a_secret_does_not_go_to_another_receiver(new: dict[str, Any]) -> None:
    with pytest.raises(InputError, match=r"actions\.call\.executor\.options\..*write it anew"):
        uncovered(new, hook(url="https://h/a?token=t", secret="s"))
