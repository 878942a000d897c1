"""The control port: JSON lines that a person, a test or a simulated device sends to the emulator.

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
import time
from collections.abc import Mapping
from typing import Any

from robomend_board.board import ChannelState
from robomend_board.faults import FAULTS, FaultError, parse_channel, parse_fault
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
