"""`robomend-board`: run the emulator, or speak to the control port of one that runs."""

from __future__ import annotations

import asyncio
import json
import logging
import os
import signal
import sys
from collections.abc import Callable
from functools import partial
from pathlib import Path

import click

from robomend_board.board import Board
from robomend_board.control import ControlPort
from robomend_board.loads import LoadsError, default_rig, read_rig
from robomend_board.relay_file import RelayFileError, read_relays, write_relays
from robomend_board.remote import control
from robomend_board.server import Emulator

BAD_INPUT = 2
FAILED = 3
PARENT_CHECK_S = 0.2

PORT = click.IntRange(0, 65535)
FILE = click.Path(dir_okay=False, path_type=Path)


def _channel_list(context: click.Context, parameter: click.Parameter, values: tuple[str, ...]) -> list[int]:
    """Read `--on 2 --on 7` and `--on 2,7` alike."""
    numbers = [part for value in values for part in value.replace(",", " ").split()]
    if wrong := [number for number in numbers if not number.isdecimal()]:
        raise click.BadParameter(f"{wrong[0]!r} is no channel number")
    return sorted({int(number) for number in numbers})


@click.group(invoke_without_command=True, context_settings={"help_option_names": ["-h", "--help"]})
@click.option("--host", default="127.0.0.1", show_default=True, help="Address to listen on.")
@click.option("--port", type=PORT, default=5000, show_default=True, help="For clients; 0 takes a free one.")
@click.option("--control-port", type=PORT, help="For faults; default: the one after --port, or a free one.")
@click.option("--channels", type=click.IntRange(1, 255), default=10, show_default=True)
@click.option("--on", callback=_channel_list, multiple=True, help="Channels on at power-up: 2,7 or repeated.")
@click.option("--state", type=FILE, help="Keep the relays in this file.")
@click.option("--loads", type=FILE, help="What hangs on the channels (YAML or JSON).")
@click.option("--seed", type=int, default=0, show_default=True, help="Of the noise.")
@click.option("--max-clients", type=click.IntRange(1, 1000), default=16, show_default=True)
@click.option("--end-with-parent", is_flag=True, help="End when the process that started this one does.")
@click.option("--verbose", is_flag=True, help="Say more on standard error.")
@click.pass_context
def main(
    context: click.Context,
    host: str,
    port: int,
    control_port: int | None,
    channels: int,
    on: list[int],
    state: Path | None,
    loads: Path | None,
    seed: int,
    max_clients: int,
    end_with_parent: bool,
    verbose: bool,
) -> None:
    """A ten-channel power board, emulated: loads, noise, and faults on demand.

    When it is ready it prints one line of JSON with its ports on standard output. A state file wins over
    --on, as a real board's latching relays do.
    """
    if context.invoked_subcommand is not None:
        return
    logging.basicConfig(
        stream=sys.stderr,
        level=logging.DEBUG if verbose else logging.INFO,
        format="%(asctime)s %(name)s %(message)s",
    )
    if beyond := [number for number in on if number >= channels]:
        raise click.BadParameter(f"there is no channel {beyond[0]}: 0 to {channels - 1}", param_hint="--on")
    try:
        rig = read_rig(loads, channels) if loads else default_rig(channels)
        kept = read_relays(state, channels) if state else None
    except (LoadsError, RelayFileError) as error:
        click.echo(f"robomend-board: {error}", err=True)
        sys.exit(BAD_INPUT)
    closed = on if kept is None else [number for number, relay in enumerate(kept) if relay]
    board = Board(rig, closed, seed)
    keep: Callable[[tuple[bool, ...]], None] = partial(write_relays, state) if state else _keep_nothing
    if state is not None and kept is None:
        try:
            keep(board.relays())
        except OSError as error:
            click.echo(f"robomend-board: {state}: cannot be written: {error.strerror or error}", err=True)
            sys.exit(FAILED)
    try:
        if control_port is None:
            control_port = port + 1 if 0 < port < 65535 else 0
        asyncio.run(_serve(board, keep, host, port, control_port, max_clients, seed, end_with_parent))
    except OSError as error:
        click.echo(f"robomend-board: {error}", err=True)
        sys.exit(FAILED)


main.add_command(control)


def _keep_nothing(relays: tuple[bool, ...]) -> None:
    """Without --state, every start is a first one."""


async def _serve(
    board: Board,
    keep: Callable[[tuple[bool, ...]], None],
    host: str,
    port: int,
    control_port: int,
    max_clients: int,
    seed: int,
    end_with_parent: bool,
) -> None:
    """Run until SIGTERM or SIGINT."""
    ended = asyncio.Event()
    loop = asyncio.get_running_loop()
    for number in (signal.SIGTERM, signal.SIGINT):
        loop.add_signal_handler(number, ended.set)
    emulator = Emulator(board, keep=keep, max_clients=max_clients, seed=seed)
    controls = ControlPort(emulator)
    parent = asyncio.create_task(_parent_gone(ended)) if end_with_parent else None
    try:
        await emulator.listen(host, port)
        await controls.listen(host, control_port)
        ready = {
            "ready": True,
            "host": emulator.host,
            "port": emulator.port,
            "control_port": controls.port,
            "channels": len(board.channels),
            "pid": os.getpid(),
        }
        print(json.dumps(ready), flush=True)
        await ended.wait()
    finally:
        if parent is not None:
            parent.cancel()
        await controls.close()
        await emulator.close()


async def _parent_gone(ended: asyncio.Event) -> None:
    """An orphan gets another parent: that is how a kill -9 of the one that started us shows."""
    parent = os.getppid()
    while os.getppid() == parent:
        await asyncio.sleep(PARENT_CHECK_S)
    ended.set()


if __name__ == "__main__":
    main()
