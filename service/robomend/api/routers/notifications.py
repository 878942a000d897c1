"""/notifications: who is told that a person is needed, what they were told, and whether it arrives."""

from __future__ import annotations

import asyncio
from typing import Annotated, Literal

from fastapi import APIRouter, Path
from pydantic import Field

from robomend.api.deps import PagingDep, Parts, PartsDep, PrincipalDep
from robomend.api.gate import GuardedRoute
from robomend.api.problems import problems
from robomend.api.schemas.base import NAME, Items, Moment, Nanoseconds, Out, moment_of
from robomend.security import API
from robomend.store import notifications
from robomend.store.records import StoredNotification

# --- who is told, of what, and whether it arrived.


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


router = APIRouter(prefix=API, tags=["control"], route_class=GuardedRoute)

ARRIVED_S = 10.0
"""How long the answer to a test waits for what comes of it."""

LOOK_S = 0.05

RecipientPath = Annotated[
    str, Path(pattern=NAME, description="a name of the setting `notify`", examples=["duty"])
]


@router.get("/notifications", responses=problems())
async def get_notifications(parts: PartsDep, paging: PagingDep) -> Items[NotificationOut]:
    """Return what people were told or are to be told, newest first."""
    page = await parts.store.read(notifications.page, paging)
    return Items(items=[notification_out(one) for one in page.items], next=page.next)


@router.get("/notifications/recipients", responses=problems())
async def get_recipients(parts: PartsDep) -> Recipients:
    """Return who is told, and of what: the settings `notify` and `public_url`, without secrets."""
    told = [
        RecipientOut(
            name=one.name,
            kind="mail" if one.webhook is None else "webhook",
            to=one.shown,
            about=sorted(one.about),
            robots=list(one.robots),
        )
        for one in parts.notifier.recipients.values()
    ]
    return Recipients(items=told, public_url=parts.settings.public_url)


@router.post("/notifications/recipients/{recipient}/test", responses=problems(404, 507))
async def test_recipient(
    recipient: RecipientPath, parts: PartsDep, principal: PrincipalDep
) -> NotificationOut:
    """Send a test, and answer with what came of the first try, after 10 s at most."""
    return notification_out(await tried(parts, recipient, principal.name))


async def tried(parts: Parts, recipient: str, by: str) -> StoredNotification:
    """Send a test and return it as it is after the first try, or after a while."""
    number = await parts.notifier.test(recipient, by)
    deadline = asyncio.get_running_loop().time() + ARRIVED_S
    while True:
        found = await parts.store.read(notifications.get, number)
        if found.tries or asyncio.get_running_loop().time() > deadline:
            return found
        await asyncio.sleep(LOOK_S)


def notification_out(one: StoredNotification) -> NotificationOut:
    """Return a notification as it is shown."""
    data = one.data
    return NotificationOut.model_validate(
        {
            "id": f"n-{one.number}",
            "recipient": one.recipient,
            "about": data["about"],
            "robot": data["robot"],
            "repair": data["repair"],
            "title": data["title"],
            "text": "\n".join(data["lines"]),
            "created_ns": one.created_ns,
            "state": one.state,
            "tries": one.tries,
            "answer": one.answer,
        }
    )
