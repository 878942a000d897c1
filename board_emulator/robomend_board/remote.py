"""`robomend-board control`: the control port from a shell.

    robomend-board control fault stuck 7 at=off
    robomend-board control set 7 off
    robomend-board control clear all
    robomend-board control watch

Exit codes: 0 done, 1 the emulator said no, 2 bad input, 3 no emulator there.
"""

from __future__ import annotations

import json
import socket
import sys
from collections.abc import Iterator
from typing import Any, NoReturn

import click

from robomend_board.faults import FAULTS

TIMEOUT_S = 5.0
REFUSED = 1
FAILED = 3


@click.group(help="Speak to the control port of an emulator that runs.")
@click.option("--host", default="127.0.0.1", show_default=True)
@click.option("--port", type=click.IntRange(1, 65535), default=5001, show_default=True)
@click.pass_context
def control(context: click.Context, host: str, port: int) -> None:
    context.obj = (host, port)


@control.command(short_help="Bring a fault about.")
@click.argument("name", type=click.Choice([*FAULTS]))
@click.argument("channel", required=False)
@click.argument("parameters", nargs=-1)
@click.pass_obj
def fault(address: tuple[str, int], name: str, channel: str | None, parameters: tuple[str, ...]) -> None:
    """Bring a fault about, e.g. `fault stuck 7 at=off`, `fault late delay_s=0.3`."""
    request: dict[str, Any] = {"fault": name}
    given = parameters
    if channel is not None and "=" in channel:
        given = (channel, *parameters)
    elif channel is not None:
        request["channel"] = _number(channel)
    for pair in given:
        key, equals, value = pair.partition("=")
        if not equals:
            raise click.BadParameter(f"{pair!r} is not KEY=VALUE")
        request[key] = _number(value)
    _print_answer(address, request)


@control.command()
@click.argument("name", type=click.Choice([*FAULTS, "all"]))
@click.argument("channel", type=int, required=False)
@click.pass_obj
def clear(address: tuple[str, int], name: str, channel: int | None) -> None:
    """Take a fault away; without a channel, from all of them."""
    _print_answer(address, {"clear": name} | ({} if channel is None else {"channel": channel}))


@control.command("set", short_help="Move a relay although no client asked for it.")
@click.argument("channel", type=int)
@click.argument("state", type=click.Choice(["on", "off"]))
@click.pass_obj
def set_channel(address: tuple[str, int], channel: int, state: str) -> None:
    """Move a relay although no client asked for it: `set 7 off` takes the power from device 7."""
    _print_answer(address, {"set": {"channel": channel, "on": state == "on"}})


@control.command()
@click.pass_obj
def status(address: tuple[str, int]) -> None:
    """Print channels, faults and clients as JSON."""
    _print_answer(address, {"status": True})


@control.command(short_help="Print a line of JSON for each change.")
@click.pass_obj
def watch(address: tuple[str, int]) -> None:
    """Print a line of JSON for each channel, then one for each change, until interrupted."""
    try:
        for line in _lines(address, {"watch": True}, timeout_s=None):
            click.echo(line.rstrip("\n"))
            sys.stdout.flush()
    except OSError as error:
        _unreachable(address, error)


def _lines(address: tuple[str, int], request: dict[str, Any], timeout_s: float | None) -> Iterator[str]:
    """Send one request and yield what comes back, line by line."""
    with socket.create_connection(address, TIMEOUT_S) as connection:
        connection.settimeout(timeout_s)
        with connection.makefile("rw", encoding="utf-8") as stream:
            stream.write(json.dumps(request) + "\n")
            stream.flush()
            yield from stream


def _print_answer(address: tuple[str, int], request: dict[str, Any]) -> None:
    try:
        line = next(iter(_lines(address, request, TIMEOUT_S)), "")
    except OSError as error:
        _unreachable(address, error)
    if not line:
        _unreachable(address, "the connection was closed")
    answer = json.loads(line)
    click.echo(json.dumps(answer, indent=2 if "channels" in answer else None))
    if not answer["ok"]:
        sys.exit(REFUSED)


def _unreachable(address: tuple[str, int], why: object) -> NoReturn:
    click.echo(f"robomend-board: no emulator answers at {address[0]}:{address[1]}: {why}", err=True)
    sys.exit(FAILED)


def _number(text: str) -> int | float | str:
    for kind in (int, float):
        try:
            return kind(text)
        except ValueError:
            continue
    return text
