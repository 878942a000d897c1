"""Arguments that name a robot, a repair or a batch of a running service, and what shells complete them to."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from typing import TYPE_CHECKING, Any

import click
from click.shell_completion import CompletionItem

from robomend.cli.remote.connection import DEFAULT_URL, KEY_VARIABLE, URL_VARIABLE

if TYPE_CHECKING:
    from robomend_client.rest import Client

COMPLETION_S = 1.0
"""For the service to say which names there are; whoever typed waits for it."""

OFFERED = 200

Offers = Callable[["Client"], Iterator[CompletionItem]]


class RobotName(click.ParamType[str]):
    """A robot's id."""

    name = "robot"

    def shell_complete(
        self, ctx: click.Context, param: click.Parameter, incomplete: str
    ) -> list[CompletionItem]:
        """Return the robots that the service knows."""
        return offered(ctx, incomplete, _robots)


class RepairName(click.ParamType[str]):
    """A repair's id."""

    name = "repair"

    def __init__(self, *states: str, open_only: bool = False) -> None:
        """Complete to any repair, to those that have not ended, or to those in one of these states."""
        self.states = states
        self.open_only = open_only or bool(states)

    def shell_complete(
        self, ctx: click.Context, param: click.Parameter, incomplete: str
    ) -> list[CompletionItem]:
        """Return the repairs that the command is for, newest first."""

        def repairs(client: Client) -> Iterator[CompletionItem]:
            for one in client.all_repairs(limit=OFFERED, open_only=self.open_only)["items"]:
                if not self.states or one["state"] in self.states:
                    yield CompletionItem(one["id"], help=f"{one['robot']}: {one['state']}")

        return offered(ctx, incomplete, repairs)


class BatchName(click.ParamType[str]):
    """A batch's id."""

    name = "batch"

    def __init__(self, *states: str) -> None:
        """Complete to any batch, or to those in one of these states."""
        self.states = states

    def shell_complete(
        self, ctx: click.Context, param: click.Parameter, incomplete: str
    ) -> list[CompletionItem]:
        """Return the batches that the command is for, newest first."""

        def batches(client: Client) -> Iterator[CompletionItem]:
            for one in client.batches(limit=OFFERED)["items"]:
                if not self.states or one["state"] in self.states:
                    yield CompletionItem(one["id"], help=f"{one['model']}: {one['state']}")

        return offered(ctx, incomplete, batches)


def _robots(client: Client) -> Iterator[CompletionItem]:
    for one in client.robots(limit=1000)["items"]:
        yield CompletionItem(one["id"], help=f"follows {one['model']}")


def offered(ctx: click.Context, incomplete: str, offers: Offers) -> list[CompletionItem]:
    """Return what begins as it was typed; nothing where no service answers: a shell shows no errors."""
    from robomend_client.rest import NEVER, Client

    given: dict[str, Any] = ctx.params
    url = given.get("url") or os.environ.get(URL_VARIABLE) or DEFAULT_URL
    key = given.get("key") or os.environ.get(KEY_VARIABLE)
    try:
        with Client(url, key, timeout_s=COMPLETION_S, retry=NEVER) as client:
            return [item for item in offers(client) if item.value.startswith(incomplete)][:OFFERED]
    except Exception:  # noqa: BLE001  # a traceback in the middle of a command line helps nobody
        return []
