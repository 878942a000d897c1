"""`robomend keys`: create, list and revoke bearer keys. A key's text is shown once and stored nowhere."""

from __future__ import annotations

import asyncio
import getpass
import json
import os
from collections.abc import Callable
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, TypeVar

import click

from robomend.cli.config import read_settings, settings_options
from robomend.errors import InputError

if TYPE_CHECKING:
    from robomend.settings import Settings
    from robomend.store import Transaction, View
    from robomend.store.records import ApiKey

T = TypeVar("T")

ROLES = ("viewer", "robot", "operator", "admin")


@click.group("keys")
def command() -> None:
    """Create, list and revoke API keys."""


@command.command("create")
@settings_options
@click.option("--role", type=click.Choice(ROLES), required=True)
@click.option("--robot", help="The robot's id; for the role robot, and only for it.")
@click.option("--name", help="What the audit log calls it; by default the role and the robot.")
@click.option("--reason", default="", help="Why; it goes to the audit log.")
@click.option("--format", "format_", type=click.Choice(["text", "json"]), default="text", show_default=True)
def create(
    config_file: Path | None,
    data: Path | None,
    database: str | None,
    role: str,
    robot: str | None,
    name: str | None,
    reason: str,
    format_: str,
) -> None:
    """Create a key and print it; it cannot be shown again."""
    from robomend.security import digest, new_key
    from robomend.store import api_keys

    if (role == "robot") != (robot is not None):
        raise click.UsageError("--robot goes with --role robot: a robot's key opens that robot only")
    settings, _ = read_settings(config_file, data=data, database=database)
    text = new_key()
    called = name or (f"robot-{robot}" if robot else role)

    def add(tx: Transaction) -> ApiKey:
        key = api_keys.add(tx, name=called, hash=digest(text), role=role, robot=robot, by=person())
        tx.note(api_keys.told("key.create", key, by=person(), reason=reason))
        return key

    key = write(settings, add)
    if format_ == "json":
        click.echo(json.dumps({"id": key.id, "name": called, "role": role, "robot": robot, "key": text}))
    else:
        click.echo(text)
        click.echo(f"key {key.id} ({called}, {role}): keep it, it is not shown again", err=True)


@command.command("list")
@settings_options
@click.option("--format", "format_", type=click.Choice(["text", "json"]), default="text", show_default=True)
def list_keys(config_file: Path | None, data: Path | None, database: str | None, format_: str) -> None:
    """List the keys, revoked ones included; never their text."""
    from robomend.store import api_keys

    settings, _ = read_settings(config_file, data=data, database=database)
    for key in read(settings, api_keys.every):
        values = {
            "id": key.id,
            "name": key.name,
            "role": key.role,
            "robot": key.robot,
            "created": _day(key.created_ns),
            "revoked": None if key.revoked_ns is None else _day(key.revoked_ns),
        }
        if format_ == "json":
            click.echo(json.dumps(values))
        else:
            click.echo("  ".join("-" if value is None else str(value) for value in values.values()))


@command.command("revoke", short_help="Revoke KEY, by its id or name.")
@settings_options
@click.argument("key")
@click.option("--reason", default="", help="Why; it goes to the audit log.")
def revoke(config_file: Path | None, data: Path | None, database: str | None, key: str, reason: str) -> None:
    """Revoke KEY, by its id or name; running services notice within two seconds."""
    from robomend.store import api_keys

    settings, _ = read_settings(config_file, data=data, database=database)

    def revoke_it(tx: Transaction) -> ApiKey:
        found = [k for k in api_keys.every(tx) if k.revoked_ns is None and key in (k.id, k.name)]
        if not found:
            raise InputError(f"no key in use has the id or name {key!r}; see `robomend keys list`")
        tx.note(api_keys.told("key.revoke", found[0], by=person(), reason=reason))
        return api_keys.revoke(tx, found[0].id)

    gone = write(settings, revoke_it)
    click.echo(f"revoked {gone.id} ({gone.name})", err=True)


def person() -> str:
    """Return what the audit log calls whoever runs this command: their account on this computer."""
    try:
        account = getpass.getuser()
    except (OSError, KeyError):  # an account without a name, in a container, say
        account = str(os.getuid())
    return f"command line ({account})"


def write(settings: Settings, change: Callable[[Transaction], T]) -> T:
    """Change the database from a command."""

    async def run() -> T:
        from robomend.store import opened

        async with opened(settings.database_url) as store:
            return await store.write(change)

    return asyncio.run(run())


def read(settings: Settings, query: Callable[[View], T]) -> T:
    """Ask the database from a command."""

    async def run() -> T:
        from robomend.store import opened

        async with opened(settings.database_url) as store:
            return await store.read(query)

    return asyncio.run(run())


def _day(time_ns: int) -> str:
    return datetime.fromtimestamp(time_ns / 1e9, UTC).isoformat(timespec="seconds")
