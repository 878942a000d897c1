"""`robomend-board`: run the emulator, or speak to the control port of one that runs.

The control port takes JSON lines that a person, a test or a simulated device sends to the emulator.

    → {"fault": "stuck", "channel": 7}      ← {"ok": true}
    → {"watch": true}                       ← {"ok": true}, then a line a channel, then a line a change:
                                            ← {"channel": 7, "on": false, "powered": false, "time_ns": …}

Each request gets one answer, in order; a wrong one gets {"ok": false, "error": …} and the port goes on.
docs/board.md has them all. Who watches and does not read is dropped, as the board's own clients are.
"""

from __future__ import annotations

import asyncio
import json
import logging
import os
import signal
import socket
import sys
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any, NoReturn

import click

from robomend_board.board import Board, ChannelState
from robomend_board.faults import FAULTS, FaultError, parse_channel, parse_fault
from robomend_board.loads import LoadsError, default_rig, read_rig
from robomend_board.server import Emulator

logger = logging.getLogger(__name__)

MAX_LINE = 1 << 14  # bytes of one request
MAX_UNSENT = 1 << 16  # bytes waiting for one that watches
MAX_CONNECTIONS = 32
REQUESTS = ("fault", "clear", "set", "status", "watch")


class ControlPort:
    """Listens for requests about one emulator."""

    def __init__(self, emulator: Emulator) -> None:
        self._emulator = emulator
        self._server: asyncio.Server | None = None
        self._writers: set[asyncio.StreamWriter] = set()
        self.port = 0

    async def listen(self, host: str, port: int) -> None:
        """Open the port; OSError if it is taken."""
        self._server = await asyncio.start_server(self._serve, host, port, limit=MAX_LINE)
        self.port = self._server.sockets[0].getsockname()[1]

    async def close(self) -> None:
        """Close the port and every connection to it."""
        if self._server is not None:
            self._server.close()
        for writer in tuple(self._writers):
            writer.transport.abort()
        await asyncio.sleep(0)

    async def _serve(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        if len(self._writers) >= MAX_CONNECTIONS:
            _say(writer, {"ok": False, "error": f"there are {MAX_CONNECTIONS} connections already"})
            writer.close()
            return
        self._writers.add(writer)

        def tell(changed: Mapping[int, ChannelState]) -> None:
            for number, state in changed.items():
                _say(writer, _line(number, state))
            if writer.transport.get_write_buffer_size() > MAX_UNSENT:
                logger.info("one that watches does not read: dropped")
                writer.transport.abort()

        try:
            while line := await reader.readline():
                answer = await self._answer(line)
                _say(writer, answer)
                if answer.get("watching"):
                    states = self._emulator.board.states(self._emulator.now_s())
                    tell(dict(enumerate(states)))
                    self._emulator.watchers.add(tell)
                await writer.drain()
        except ValueError:  # the line is longer than MAX_LINE
            _say(writer, {"ok": False, "error": f"a request is one line of at most {MAX_LINE} bytes"})
        except OSError as error:
            logger.debug("a control connection is lost: %s", error)
        finally:
            self._emulator.watchers.discard(tell)
            self._writers.discard(writer)
            writer.close()

    async def _answer(self, line: bytes) -> dict[str, Any]:
        try:
            request = json.loads(line.decode("utf-8"))
        except (ValueError, RecursionError):  # no UTF-8, no JSON, or nested too deep
            request = None
        kinds = [kind for kind in REQUESTS if isinstance(request, dict) and kind in request]
        if len(kinds) != 1:
            expected = f"a request is a JSON object with one of the keys {', '.join(REQUESTS)}"
            return {"ok": False, "error": expected}
        try:
            return {"ok": True, **await self._do(kinds[0], request)}
        except FaultError as error:
            return {"ok": False, "error": str(error)}
        except OSError as error:
            return {"ok": False, "error": f"port {self._emulator.port} cannot be opened again: {error}"}

    async def _do(self, kind: str, request: dict[str, Any]) -> dict[str, Any]:
        emulator = self._emulator
        channels = len(emulator.board.channels)
        match kind:
            case "fault":
                await emulator.set_fault(parse_fault(request, channels))
            case "clear":
                name = request["clear"]
                _only(request, "clear", "channel")
                if not isinstance(name, str) or name not in (*FAULTS, "all"):
                    raise FaultError(f"there is no fault {name!r}; there are {', '.join(FAULTS)}, and all")
                channel = parse_channel(request, channels) if "channel" in request else None
                await emulator.clear(name, channel)
            case "set":
                _only(request, "set")
                wish = request["set"]
                if not isinstance(wish, dict) or not isinstance(wish.get("on"), bool):
                    raise FaultError('set takes an object: {"set": {"channel": 7, "on": false}}')
                _only(wish, "channel", "on")
                channel = parse_channel(wish, channels)
                if not emulator.switch(channel, wish["on"]):
                    raise FaultError(f"the relay of channel {channel} does not move: it is faulty")
            case "status":
                _only(request, "status")
                return self._status()
            case _:
                _only(request, "watch")
                return {"watching": True}
        return {}

    def _status(self) -> dict[str, Any]:
        emulator = self._emulator
        board = emulator.board
        states = board.states(emulator.now_s())
        readings = emulator.measure().channels
        return {
            "channels": [
                {
                    "channel": number,
                    "name": board.channels[number].load.name,
                    "on": state.on,
                    "powered": state.powered,
                    "current_a": round(reading.current_a or 0.0, 3),
                    "voltage_v": round(reading.voltage_v or 0.0, 3),
                }
                for number, (state, reading) in enumerate(zip(states, readings, strict=True))
            ],
            "faults": [
                *board.faults(),
                *({"fault": name, **given} for name, given in emulator.line.active().items()),
            ],
            "clients": [
                {"peer": client.peer, "broadcast_hz": client.broadcast_hz} for client in emulator.clients
            ],
            "dropped": emulator.dropped,
        }


def _only(request: Mapping[str, Any], *allowed: str) -> None:
    if unknown := set(request) - set(allowed):
        raise FaultError(f"{', '.join(sorted(unknown))}: not a key here; there are {', '.join(allowed)}")


def _line(number: int, state: ChannelState) -> dict[str, Any]:
    return {"channel": number, "on": state.on, "powered": state.powered, "time_ns": time.time_ns()}


def _say(writer: asyncio.StreamWriter, answer: Mapping[str, Any]) -> None:
    if not writer.is_closing():
        writer.write(json.dumps(answer).encode() + b"\n")


# --- `robomend-board control`: the control port from a shell.
#
#     robomend-board control fault stuck 7 at=off
#     robomend-board control set 7 off
#     robomend-board control clear all
#     robomend-board control watch
#
# Exit codes: 0 done, 1 the emulator said no, 2 bad input, 3 no emulator there.

TIMEOUT_S = 5.0
REFUSED = 1


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


# --- the relays on disk, so that they survive a restart as a board's latching relays survive a power cut.


class RelayFileError(ValueError):
    """A state file that is not one of this board's; the message names it and the remedy."""


def read_relays(path: Path, channels: int) -> tuple[bool, ...] | None:
    """Return which relays were closed, or None if the file is not there yet.

    Raises:
        RelayFileError: the file cannot be read, or is of another board.
    """
    try:
        document = json.loads(path.read_text(encoding="utf-8"))
        relays = document["relays"]
        if not isinstance(relays, list) or not all(isinstance(closed, bool) for closed in relays):
            raise ValueError("relays is no list of true and false")
    except FileNotFoundError:
        return None
    except (OSError, ValueError, TypeError, KeyError) as error:
        raise RelayFileError(f"{path}: not a board's state ({error}); remove it to start afresh") from error
    if len(relays) != channels:
        raise RelayFileError(
            f"{path}: the state of {len(relays)} channels, not {channels}; give each board its own file"
        )
    return tuple(relays)


def write_relays(path: Path, relays: Sequence[bool]) -> None:
    """Replace the file in one step: after a crash it holds the old state or the new one, never half of it."""
    new = path.with_name(f"{path.name}.{os.getpid()}.new")
    try:
        with new.open("w", encoding="utf-8") as file:
            json.dump({"relays": list(relays)}, file)
            file.flush()
            os.fsync(file.fileno())
        new.replace(path)
    finally:
        new.unlink(missing_ok=True)


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
