"""The local bus, the agent's side: takes lines from nodes, tells the observers, hands them on to subscribers.

robomend_client/bus.py describes the lines. Everything is bounded: clients, bytes of a line, bytes that wait
for a slow subscriber (its newest messages are dropped and counted), topics per subscriber. A client that
sends something else is disconnected, and nobody else notices.

An agent on another host of the same robot joins this bus instead of opening its own: see Tap.
"""

from __future__ import annotations

import asyncio
import contextlib
import json
import logging
import os
import socket
import struct
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from robomend_client.bus import LONGEST_LINE, parse_address
from robomend_client.observers import Contact
from robomend_client.python310 import end, timeout

log = logging.getLogger(__name__)

MOST_CLIENTS = 256
MOST_TOPICS = 1024
MOST_WAITING = 256 * 1024
"""Bytes that may wait for one subscriber."""


@dataclass(frozen=True)
class TopicMessage:
    """What was published."""

    topic: str
    data: object = None
    time_ns: int | None = None  # None: when it arrives
    fields: Mapping[str, Any] | None = None


def read_message(line: object) -> TopicMessage | None:
    """Return the message of a line that was read as JSON; None if it is none.

    Raises:
        ValueError: it is one, and not as it should be.
    """
    if not isinstance(line, dict) or not isinstance(line.get("topic"), str):
        return None
    time_ns, fields = line.get("time"), line.get("fields")
    if time_ns is not None and (isinstance(time_ns, bool) or not isinstance(time_ns, int)):
        raise ValueError(f"time must be nanoseconds, a whole number, not {time_ns!r}")
    if fields is not None and not isinstance(fields, dict):
        raise ValueError(f"fields must be a mapping, not {fields!r}")
    return TopicMessage(line["topic"], line.get("data"), time_ns, fields)


OnMessage = Callable[[TopicMessage], None]

MOST_TOLD = 1000

BEAT_S = 0.05
"""How often a subscriber that asks for beats is told that we are at work; whoever is halted tells nobody."""

DEAF_S = 0.15
"""A bus that gives beats and has said nothing for so long is not heard: no silence of its topics."""

NO_BEATS_S = 1.0
"""A bus that has given no beat by then gives none."""

BEAT = b'{"beat": true}\n'

Diversion = Callable[[TopicMessage, bytes], None]
"""Takes a message, and the line that it came in, in place of observers and subscribers."""


class Broker:
    """Listens on `address`; with tcp port 0 the system chooses, and `address` then says which."""

    def __init__(self, address: str, on_message: OnMessage) -> None:
        self.address = address
        self.dropped = 0
        self._on_message = on_message
        self._peers: set[_Peer] = set()
        self._subscribers: dict[str, set[_Peer]] = {}
        self._diverted: dict[str, Diversion] = {}
        self._server: asyncio.Server | None = None
        self._closing = False
        self._told: set[str] = set()  # places of clients that spoke otherwise
        self._beats: set[_Peer] = set()  # who asks for them
        self._beating: asyncio.Task[None] | None = None

    async def open(self) -> None:
        """Listen.

        Raises:
            OSError: the address is taken, or is none of this machine's.
        """
        try:
            await self._listen()
        except OSError as error:
            raise OSError(f"the bus cannot listen on {self.address}: {error.strerror or error}") from error

    async def _listen(self) -> None:
        loop = asyncio.get_running_loop()
        where = parse_address(self.address)
        if isinstance(where, str):
            Path(where).unlink(missing_ok=True)  # left by a killed agent; the state directory's lock is ours
            old = os.umask(0o077)
            try:
                self._server = await loop.create_unix_server(lambda: _Peer(self), where)
            finally:
                os.umask(old)
        else:
            self._server = await loop.create_server(lambda: _Peer(self), *where)
            host, port = self._server.sockets[0].getsockname()[:2]
            self.address = f"tcp:{host}:{port}"

    async def close(self) -> None:
        if self._server is None:
            return
        self._closing = True
        if self._beating is not None:
            await end([self._beating])
        loop = asyncio.get_running_loop()
        for listening in self._server.sockets:
            loop.remove_reader(listening.fileno())
        await asyncio.sleep(0)  # what was accepted gets its transport, or Python 3.13 trips over it
        self._server.close()
        for peer in tuple(self._peers):
            peer.transport.abort()
        with contextlib.suppress(TimeoutError):
            async with timeout(1.0):
                await self._server.wait_closed()
        where = parse_address(self.address)
        if isinstance(where, str):
            Path(where).unlink(missing_ok=True)

    # --- called by the peers ------------------------------------------------------------------------

    def joined(self, peer: _Peer) -> bool:
        if self._closing:  # it was accepted just before
            return False
        if len(self._peers) >= MOST_CLIENTS:
            log.warning("the bus has %d clients already; one more was turned away", MOST_CLIENTS)
            return False
        self._peers.add(peer)
        return True

    def left(self, peer: _Peer) -> None:
        self._peers.discard(peer)
        self._beats.discard(peer)
        for topic in peer.topics:
            self._subscribers[topic].discard(peer)
            if not self._subscribers[topic]:
                del self._subscribers[topic]

    def beat(self, peer: _Peer) -> None:
        """Tell a subscriber again and again that we are at work."""
        self._beats.add(peer)
        if self._beating is None:
            self._beating = asyncio.create_task(self._beat(), name="beats of the bus")

    async def _beat(self) -> None:
        while True:
            for peer in self._beats:
                if peer.transport.get_write_buffer_size() < MOST_WAITING:
                    peer.transport.write(BEAT)
            await asyncio.sleep(BEAT_S)

    def rubbish(self, place: str, why: str) -> None:
        """A client does not speak as the bus does, and is disconnected: told once for each place."""
        if place not in self._told and len(self._told) < MOST_TOLD:
            self._told.add(place)
            log.warning("the bus, a client at %s: disconnected: %s", place, why)

    def subscribe(self, peer: _Peer, topic: str) -> None:
        if topic not in peer.topics and len(peer.topics) < MOST_TOPICS:
            peer.topics.add(topic)
            self._subscribers.setdefault(topic, set()).add(peer)

    def publish(self, message: TopicMessage, line: bytes) -> None:
        diversion = self._diverted.get(message.topic.removeprefix("/"))
        (diversion or self.deliver)(message, line)

    # --- called by planted.py -----------------------------------------------------------------------

    def divert(self, topic: str, to: Diversion | None) -> None:
        """Hand the messages of a topic to somebody else from now on; None: to nobody any more."""
        if to is None:
            self._diverted.pop(topic, None)
        else:
            self._diverted[topic] = to

    def deliver(self, message: TopicMessage, line: bytes) -> None:
        """Tell the observers, and hand a message on to its subscribers."""
        self._on_message(message)
        for peer in self._subscribers.get(message.topic, ()):
            if peer.transport.get_write_buffer_size() + len(line) > MOST_WAITING:
                self.dropped += 1
            else:
                peer.transport.write(line)


class _Peer(asyncio.Protocol):
    """One connection to the broker."""

    transport: asyncio.Transport

    def __init__(self, broker: Broker) -> None:
        self.topics: set[str] = set()
        self._broker = broker
        self._rest = b""

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        assert isinstance(transport, asyncio.Transport)
        self.transport = transport
        if not self._broker.joined(self):
            transport.abort()

    def connection_lost(self, error: Exception | None) -> None:
        self._broker.left(self)

    def data_received(self, data: bytes) -> None:
        *lines, self._rest = (self._rest + data).split(b"\n")
        try:
            for line in lines:
                self._line(line)
            if len(self._rest) > LONGEST_LINE:
                raise ValueError(f"a line of more than {LONGEST_LINE} bytes")
        except (ValueError, RecursionError) as error:
            self._broker.rubbish(self._place(), str(error))
            self._rest = b""
            self.transport.abort()

    def _place(self) -> str:
        """Return who is at the other end: its process, or its computer."""
        wire, peer = self.transport.get_extra_info("socket"), self.transport.get_extra_info("peername")
        if peer:
            return str(peer[0])
        try:
            pid, _, _ = struct.unpack("3i", wire.getsockopt(socket.SOL_SOCKET, socket.SO_PEERCRED, 12))
        except (AttributeError, OSError):  # this system does not say
            return "this computer"
        return f"process {pid}"

    def _line(self, line: bytes) -> None:
        read = json.loads(line)
        message = read_message(read)
        if message is not None:
            self._broker.publish(message, line + b"\n")
            return
        match read:
            case {"subscribe": [*topics]} if all(isinstance(topic, str) for topic in topics):
                for topic in topics:
                    self._broker.subscribe(self, topic)
                if read.get("beat") is True:
                    self._broker.beat(self)
            case _:
                raise ValueError(f"not a line of the bus: {line[:80]!r}")


class Tap:
    """Listens in on the bus of another agent, and comes back when it was lost."""

    def __init__(
        self, address: str, topics: list[str], on_message: OnMessage, on_sight: Callable[[Contact], None]
    ) -> None:
        """`on_sight` is told when the bus is heard no more, and when it is again."""
        self.address = address
        self._topics = topics
        self._on_message = on_message
        self._on_sight = on_sight
        self._heard_s: float | None = None  # the newest line of a bus that gives beats
        self._hears: bool | None = None

    async def run(self) -> None:
        wait_s = 0.1
        while True:
            self._see(False)
            try:
                await self._listen()
                wait_s = 0.1
            except (OSError, ValueError, TimeoutError) as error:
                log.warning("the bus at %s: %s; trying again", self.address, error)
                wait_s = min(2.0, wait_s * 2)
            self._heard_s = None
            self._see(False)
            await asyncio.sleep(wait_s)

    def read_now(self) -> None:
        """See that nothing comes any more, also no beat: called each beat, and before anything is judged."""
        if self._heard_s is not None and time.monotonic() - self._heard_s > DEAF_S:
            self._see(False)

    def _see(self, hears: bool) -> None:
        if hears is not self._hears:
            self._hears = hears
            self._on_sight(Contact.BACK if hears else Contact.LOST)

    async def _listen(self) -> None:
        where = parse_address(self.address)
        opening: Any = (
            asyncio.open_unix_connection(where, limit=LONGEST_LINE)
            if isinstance(where, str)
            else asyncio.open_connection(*where, limit=LONGEST_LINE)
        )
        async with timeout(5.0):
            reader, writer = await opening
        # An agent of before knows no beats; a connection alone shows only that its system takes it.
        no_beats = asyncio.get_running_loop().call_later(NO_BEATS_S, self._see, True)
        try:
            writer.write(json.dumps({"subscribe": self._topics, "beat": True}).encode() + b"\n")
            async for line in reader:
                no_beats.cancel()
                read = json.loads(line)
                now_s = time.monotonic()
                if isinstance(read, dict) and "beat" in read and "topic" not in read:
                    # One that was halted hands on at once what waited, which is no rate, and a late beat.
                    late = self._heard_s is not None and now_s - self._heard_s > DEAF_S
                    self._heard_s = now_s
                    self._see(not late)
                elif message := read_message(read):
                    if self._heard_s is None:
                        self._see(True)
                    if self._hears:
                        self._on_message(message)
        finally:
            no_beats.cancel()
            writer.close()
