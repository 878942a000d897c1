"""A topic that the bridge publishes: all its subscribers, and what each is sent.

A subscriber that does not keep up loses the newest messages, as on any robot; one that wants another type
is refused with a reason.
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from dataclasses import dataclass

from robomend_client.bridges.problems import Problems
from robomend_client.bridges.ros1.tcpros import ProtocolError, TcprosDecoder, encode_header, frame

MOST_WAITING = 1024 * 1024
"""Bytes that may wait for one subscriber."""

MOST_SUBSCRIBERS = 64
GREETING_S = 5.0


@dataclass(frozen=True)
class MessageType:
    """What the header of a connection says of its messages."""

    name: str  # diagnostic_msgs/DiagnosticArray
    md5: str
    definition: str


Describe = Callable[[str], MessageType]


def never_said(name: str) -> MessageType:
    """Return the type of a topic on which nothing is ever said: whatever its subscriber takes it for."""
    return MessageType(name, "*", "")


class Publication:
    """One topic."""

    def __init__(
        self, topic: str, node: str, type_name: str, describe: Describe, latched: bool = False
    ) -> None:
        """`describe` is asked, in a thread, when the first subscriber comes."""
        self.topic = topic
        self.type_name = type_name
        self._describe = describe
        self.dropped = 0
        self._node = node
        self._latched = latched
        self._last: bytes | None = None
        self._subscribers: set[Subscriber] = set()

    @property
    def wanted(self) -> bool:
        """Whether anybody listens."""
        return bool(self._subscribers)

    def publish(self, message: bytes) -> None:
        """Send a message to all who listen."""
        data = frame(message)
        if self._latched:
            self._last = data
        for subscriber in self._subscribers:
            if not subscriber.send(data):
                self.dropped += 1

    def close(self) -> None:
        for subscriber in tuple(self._subscribers):
            subscriber.abort()

    async def joined(self, subscriber: Subscriber, header: dict[str, str]) -> bytes:
        """Take in a subscriber; return what it is sent first.

        Raises:
            ProtocolError: it wants another type.
        """
        kind = await asyncio.to_thread(self._describe, self.type_name)
        if kind.md5 == "*":
            kind = MessageType(header.get("type", kind.name), header.get("md5sum", "*"), kind.definition)
        if header.get("md5sum") not in ("*", kind.md5):
            raise ProtocolError(
                f"{self.topic} is {kind.name} with md5sum {kind.md5}, not "
                f"{header.get('type')} with {header.get('md5sum')}"
            )
        if len(self._subscribers) >= MOST_SUBSCRIBERS:
            raise ProtocolError(f"{self.topic} has {MOST_SUBSCRIBERS} subscribers already")
        hello = {
            "callerid": self._node,
            "topic": self.topic,
            "type": kind.name,
            "md5sum": kind.md5,
            "message_definition": kind.definition,
            "latching": "1" if self._latched else "0",
        }
        self._subscribers.add(subscriber)
        return encode_header(hello) + (self._last or b"")

    def left(self, subscriber: Subscriber) -> None:
        self._subscribers.discard(subscriber)


class Subscriber(asyncio.Protocol):
    """One connection that somebody has made to us."""

    def __init__(self, publications: dict[str, Publication], problems: Problems) -> None:
        self._publications = publications
        self._problems = problems
        self._decoder = TcprosDecoder(keep=False)
        self._publication: Publication | None = None
        self._transport: asyncio.Transport | None = None
        self._late: asyncio.TimerHandle | None = None
        self._greeting: asyncio.Task[None] | None = None

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        assert isinstance(transport, asyncio.Transport)
        self._transport = transport
        self._late = asyncio.get_running_loop().call_later(GREETING_S, transport.abort)

    def data_received(self, data: bytes) -> None:
        assert self._transport is not None
        try:
            self._decoder.receive(data)
        except ProtocolError as error:
            self._refuse(ProtocolError("it speaks no TCPROS", str(error)))
            return
        header = self._decoder.header
        if self._greeting is None and header is not None:
            self._greeting = asyncio.create_task(self._greet(header))

    def connection_lost(self, error: Exception | None) -> None:
        if self._late is not None:
            self._late.cancel()
        if self._publication is not None:
            self._publication.left(self)

    def send(self, data: bytes) -> bool:
        """Send, unless too much waits already."""
        assert self._transport is not None
        if self._transport.is_closing():  # or asyncio logs a warning for each message
            return True
        if self._transport.get_write_buffer_size() + len(data) > MOST_WAITING:
            return False
        self._transport.write(data)
        return True

    def abort(self) -> None:
        if self._transport is not None:
            self._transport.abort()

    async def _greet(self, header: dict[str, str]) -> None:
        assert self._transport is not None
        assert self._late is not None
        self._late.cancel()
        try:
            publication = self._publications.get(header.get("topic", ""))
            if publication is None:
                raise ProtocolError(f"{header.get('topic', '')[:200]!r} is not published here")
            hello = await publication.joined(self, header)
        except ProtocolError as error:
            self._refuse(error)
            return
        if self._transport.is_closing():
            publication.left(self)
            return
        self._publication = publication
        self._transport.write(hello)

    def _refuse(self, error: ProtocolError) -> None:
        assert self._transport is not None
        peer = self._transport.get_extra_info("peername")
        self._problems.tell(f"a subscriber at {peer[0] if peer else 'somewhere'}", error)
        if not self._transport.is_closing():
            self._transport.write(encode_header({"error": str(error)}))
            self._transport.close()
