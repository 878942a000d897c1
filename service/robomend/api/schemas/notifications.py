"""Who is told, of what, and whether it arrived."""

from __future__ import annotations

from typing import Literal

from pydantic import Field

from robomend.api.schemas.base import Moment, Nanoseconds, Out, moment_of


class RecipientOut(Out):
    """Somebody who is told, as the settings name them."""

    name: str = Field(examples=["duty"])
    kind: Literal["webhook", "mail"]
    to: str = Field(
        description="mail addresses, or the host of a webhook", examples=["https://hooks.example/…"]
    )
    about: list[str] = Field(examples=[["approval", "change", "escalated", "stop", "unknown"]])
    robots: list[str] = Field(description="patterns of ids", examples=[["tedusar-*"]])


class Recipients(Out):
    """Everybody who is told."""

    items: list[RecipientOut]
    public_url: str | None = Field(
        description="links begin so; null: there are none", examples=["https://robots.example"]
    )


class NotificationOut(Out):
    """What one recipient was told, or is to be told."""

    id: str = Field(examples=["n-17"])
    recipient: str = Field(examples=["duty"])
    about: Literal["approval", "escalated", "change", "unknown", "stop", "test"]
    robot: str | None = Field(examples=["tedusar-1"])
    repair: str | None = Field(examples=["r-7k2m9x4q"])
    title: str = Field(examples=["tedusar-1: a plan waits for a yes"])
    text: str = Field(examples=["diagnosis: jaguar\nplan: power_up(jaguar)"])
    created_ns: Nanoseconds
    created: Moment = moment_of("created_ns")
    state: Literal["waiting", "delivered", "given-up"]
    tries: int = Field(examples=[1])
    answer: str = Field(description="to the last try", examples=["answered 200"])
