"""A topic that the bridge listens to: one connection to each of its publishers, taken up again when lost.

    publishers of the topic ──► requestTopic ──► TCPROS connection ──► messages
       (from the master)             ▲                  │ lost
                                     └──── a while ◄────┘

A connection that delivers is not cut because the master has forgotten its publisher: after a master's restart
the old publishers go on, and nobody has told the new one of them. What is over ends by itself.
"""

from __future__ import annotations

import asyncio
import logging
import select
import socket
import struct
import time
from collections.abc import Callable, Collection, Iterable
from contextlib import ExitStack, suppress
from dataclasses import dataclass
from importlib import import_module
from typing import Protocol

from robomend_client.bridges.problems import Problems
from robomend_client.bridges.ros1.tcpros import ProtocolError, TcprosDecoder, encode_header
from robomend_client.bridges.ros1.xmlrpc import (
    CALL_S,
    CallRefused,
    NobodyListens,
    OutOfReach,
    PeerError,
    call,
    unreachable,
)
from robomend_client.python310 import end, timeout

# --- connections that are read together --------------------------------------------------------------------
#
#     something came on any        ──► waits until `read` (each beat) ──► all that have something are read
#     it hung up; it is to be read
#     as it comes                  ──► is read at once
#
# A node publishes its topics one after the other, and being woken for each message by itself costs more than
# all that is done with it. What is read as it comes is a connection that is new, that is in the middle of a
# message, or that sends large ones, so that nobody who sends much ever waits for us. When something came is
# what the kernel says, so that neither the wait nor our own lateness is in it.

AT_ONCE = 256
"""Connections that are read, of those that do not wait for the beat, before others have their turn."""

READ_BYTES = 256 * 1024

READS = 16
"""Of one connection, before others have their turn."""

SO_TIMESTAMPNS = 35
"""Linux; the module socket does not have it."""

STAMP = struct.Struct("@ll")
ABOUT_BYTES = socket.CMSG_SPACE(STAMP.size)

HUNG_UP = select.EPOLLRDHUP | select.EPOLLHUP | select.EPOLLERR
AS_IT_COMES = HUNG_UP | select.EPOLLIN


class Reader(Protocol):
    """One connection, as what is read of it is told."""

    def received(self, data: memoryview, after_ns: int, arrived_ns: int) -> bool:
        """Take in bytes, which are another's after that; return whether to read on as they come.

        Args:
            after_ns: before that, nothing of it was there.
            arrived_ns: when the last of it came.
        """

    def ended(self, error: Exception | None) -> None:
        """Nothing comes any more, and `leave` was done. None: the other side has closed it."""


class _Joined:
    """One connection."""

    __slots__ = ("as_it_comes", "reader", "wire")

    def __init__(self, wire: socket.socket, reader: Reader) -> None:
        self.wire = wire
        self.reader = reader
        self.as_it_comes = True  # what begins shall not wait


class Bursts:
    """All connections of one node of ours."""

    def __init__(self, now_ns: Callable[[], int] = time.time_ns) -> None:
        """`now_ns` is the clock by which readers are told when something came."""
        self._now_ns = now_ns
        self._any = select.epoll()
        self._at_once = select.epoll()
        self._joined: dict[int, _Joined] = {}
        self._looked_ns = time.monotonic_ns()  # when there was nothing left of what had come
        self._buffer = bytearray(READ_BYTES)  # one for all: memory of that size is not to be had for nothing
        self._view = memoryview(self._buffer)

    def join(self, wire: socket.socket, reader: Reader) -> None:
        """Read this connection, too; it does not block."""
        if not self._joined:
            asyncio.get_running_loop().add_reader(self._at_once.fileno(), self._read_at_once)
        with suppress(OSError):  # without it, what comes is as old as our reading it
            wire.setsockopt(socket.SOL_SOCKET, SO_TIMESTAMPNS, 1)
        self._joined[wire.fileno()] = _Joined(wire, reader)
        self._any.register(wire.fileno(), select.EPOLLIN)
        self._at_once.register(wire.fileno(), AS_IT_COMES)

    def leave(self, wire: socket.socket) -> None:
        """Read it no more, before it is closed; it may have left before."""
        number = wire.fileno()
        if self._joined.pop(number, None) is None:
            return
        self._any.unregister(number)
        self._at_once.unregister(number)
        if not self._joined:
            asyncio.get_running_loop().remove_reader(self._at_once.fileno())

    def close(self) -> None:
        """All have left."""
        for joined in tuple(self._joined.values()):
            self.leave(joined.wire)
        self._any.close()
        self._at_once.close()

    def read(self) -> None:
        """Read all that has come by now."""
        if not self._joined:
            return
        before_ns, self._looked_ns = self._looked_ns, time.monotonic_ns()
        self._read_all(self._any.poll(0, len(self._joined)), self._looked_ns - before_ns)

    # --- inside ----------------------------------------------------------------------------------------

    def _read_at_once(self) -> None:
        ready = self._at_once.poll(0, AT_ONCE)
        if any(event & HUNG_UP for _, event in ready):
            self.read()  # what it has said on others before it hung up must not count as said since
        else:
            self._read_all(ready, time.monotonic_ns() - self._looked_ns)

    def _read_all(self, ready: Iterable[tuple[int, int]], since_ns: int) -> None:
        """Read these, of which everything came within the last so many nanoseconds."""
        wall_ns, now_ns = time.time_ns(), self._now_ns()
        for number, _ in ready:
            joined = self._joined.get(number)
            if joined is not None:  # or one that was read before has sent this one away
                self._read(number, joined, since_ns, wall_ns, now_ns)

    def _read(self, number: int, joined: _Joined, since_ns: int, wall_ns: int, now_ns: int) -> None:
        wire, reader, as_it_comes = joined.wire, joined.reader, joined.as_it_comes
        try:
            for _ in range(READS):
                size, about, _, _ = wire.recvmsg_into((self._buffer,), ABOUT_BYTES)
                if not size:
                    self.leave(wire)
                    reader.ended(None)
                    return
                age_ns = _age_ns(about, since_ns, wall_ns)
                as_it_comes = reader.received(self._view[:size], now_ns - since_ns, now_ns - age_ns)
                if size < READ_BYTES:
                    break
        except (BlockingIOError, InterruptedError):
            pass
        except Exception as error:  # noqa: BLE001  # one connection's, and told by who reads it
            self.leave(wire)
            reader.ended(error)
            return
        if as_it_comes is not joined.as_it_comes and self._joined.get(number) is joined:
            joined.as_it_comes = as_it_comes
            self._at_once.modify(number, AS_IT_COMES if as_it_comes else HUNG_UP)


def _age_ns(about: Iterable[tuple[int, int, bytes]], oldest_ns: int, now_ns: int) -> int:
    """Return how long ago bytes came; 0 if the computer's clock was set meanwhile, or it is not told.

    Args:
        now_ns: by the computer's clock.
    """
    for level, kind, value in about:
        if level == socket.SOL_SOCKET and kind == SO_TIMESTAMPNS and len(value) == STAMP.size:
            seconds, nanoseconds = STAMP.unpack(value)
            age_ns = now_ns - (int(seconds) * 1_000_000_000 + int(nanoseconds))
            if 0 <= age_ns <= oldest_ns:
                return age_ns
    return 0


log = logging.getLogger(__name__)

FIRST_WAIT_S, LONGEST_WAIT_S = 0.1, 3.0
"""Between two tries to reach a publisher."""

MOST_PUBLISHERS = 512

LARGE = 16 * 1024
"""Bytes of a message; where such ones come, they are read as they come: no publisher waits for room here."""

NAMES = "; is ROS_IP or ROS_HOSTNAME right, where it runs? Its topics look silent from here"

KEEPALIVE = ((socket.TCP_KEEPIDLE, 5), (socket.TCP_KEEPINTVL, 2), (socket.TCP_KEEPCNT, 3))
"""A publisher whose host has lost its power hangs up after about ten seconds."""


@dataclass(frozen=True)
class Publisher:
    """Who is at the other end of a connection, as its header says."""

    node: str  # its name, with the slash
    uri: str
    type: str = ""
    md5: str = ""
    definition: str = ""
    latched: bool = False  # the last message is sent to whoever comes later


OnMessage = Callable[[Publisher, bytes, int], None]
"""Called with who says it, what, and when it came, by our node's clock."""

OnLink = Callable[[Publisher, bool], None]


class Subscription:
    """One topic."""

    def __init__(
        self,
        topic: str,
        node: str,
        on_message: OnMessage,
        problems: Problems,
        bursts: Bursts,
        keep: bool = False,
        on_link: OnLink | None = None,
        up_to: int = 0,
    ) -> None:
        """
        Args:
            topic: its full name.
            node: our own.
            on_message: called with each message; with empty bytes unless `keep`, or it has `up_to` at most.
            bursts: reads its connections.
            on_link: called when a publisher's connection stands, and when it is lost.
        """
        self.topic = topic
        self.type = ""
        self._md5 = ""
        self._node = node
        self._on_message: list[OnMessage] = []
        self._on_link: list[OnLink] = []
        self._problems = problems
        self._bursts = bursts
        self._keep = False
        self._up_to = up_to
        self.add(on_message, keep, on_link)
        self._wanted: frozenset[str] = frozenset()
        self._links: dict[str, asyncio.Task[None]] = {}
        self._closed = False
        self._standing: dict[str, str] = {}  # publishers that are connected: uri -> node
        self._open: set[str] = set()  # those that it is to be seen of whether they can be

    @property
    def nodes(self) -> Collection[str]:
        """The publishers that are connected."""
        return self._standing.values()

    @property
    def open(self) -> bool:
        """Whether a publisher may be there that is not connected (yet, or any more)."""
        return bool(self._open)

    def add(self, on_message: OnMessage, keep: bool, on_link: OnLink | None) -> None:
        """Somebody else wants the topic, too: before the first connection."""
        self._on_message.append(on_message)
        self._keep = self._keep or keep
        if on_link is not None:
            self._on_link.append(on_link)

    def publishers(self, uris: Iterable[str]) -> None:
        """The topic has these publishers now."""
        if self._closed:  # the master goes on telling while the node takes its leave
            return
        self._wanted = frozenset(list(dict.fromkeys(uris))[:MOST_PUBLISHERS])
        for uri in self._wanted - self._links.keys():
            self._open.add(uri)
            self._links[uri] = asyncio.create_task(self._link(uri), name=f"{self.topic} from {uri}")

    async def close(self) -> None:
        self._closed = True
        self._wanted = frozenset()
        await end(list(self._links.values()))

    # --- one publisher ---------------------------------------------------------------------------------

    async def _link(self, uri: str) -> None:
        """Listen to a publisher for as long as there is one."""
        place = f"{self.topic} from {uri}"
        wait_s = FIRST_WAIT_S
        if self._keep:  # what reads its messages; a third of a second in which nobody else shall wait
            await asyncio.to_thread(import_module, "rosbags.typesys")
        try:
            while uri in self._wanted:
                lost = False
                try:
                    if await self._listen(uri):
                        wait_s = FIRST_WAIT_S
                        self._problems.over(place)
                    lost = True  # whether it can be connected again is yet to be seen
                except (NobodyListens, OutOfReach) as error:  # of one that is gone, once for all its topics
                    hint = NAMES if isinstance(error, OutOfReach) else ""
                    if uri in self._wanted:
                        self._problems.tell(f"the publisher at {uri}", f"{error}{hint}")
                except (PeerError, ProtocolError) as error:
                    if uri in self._wanted:
                        self._problems.tell(place, error)
                if not lost:
                    self._open.discard(uri)  # nobody is there, or no way there: what does not come is silent
                await asyncio.sleep(wait_s)
                wait_s = min(2 * wait_s, LONGEST_WAIT_S)
        finally:
            self._open.discard(uri)
            del self._links[uri]

    async def _listen(self, uri: str) -> bool:
        """Connect and take messages until the connection is lost; return whether any came.

        Raises:
            PeerError, ProtocolError: why not.
        """
        host, port = await self._where(uri)
        try:
            async with timeout(CALL_S):
                wire = await _connected(host, port)
        except TimeoutError as error:
            raise PeerError(f"{host}:{port} takes no connection within {CALL_S:g} s") from error
        except (OSError, UnicodeError) as error:
            raise unreachable(host, port, error) from error
        stream = _Stream(self, uri)
        with wire:
            self._bursts.join(wire, stream)
            try:
                hello = {"callerid": self._node, "topic": self.topic, "type": "*", "md5sum": "*"}
                wire.send(encode_header({**hello, "tcp_nodelay": "1"}))  # a new connection takes that much
                await asyncio.wait({stream.greeted}, timeout=CALL_S)
                if not stream.greeted.done():
                    raise ProtocolError(f"{host}:{port} takes a subscriber, and sends no header")
                await stream.lost
            except OSError:
                pass  # lost before it began
            finally:
                self._bursts.leave(wire)
                stream.ended(None)
        if stream.error is not None:
            raise stream.error
        return stream.messages > 0

    async def _where(self, uri: str) -> tuple[str, int]:
        """Ask a publisher for the address of its messages."""
        answer = await call(uri, "requestTopic", self._node, self.topic, [["TCPROS"]])
        match answer:
            case [1, _, ["TCPROS", str(host), int(port)]] if 0 < port < 65536:
                return host, port
            case [int(code), str(why), *_] if code != 1:
                raise CallRefused(f"it does not publish {self.topic}: {why[:200]}")
        raise ProtocolError("requestTopic was answered with something else", repr(str(answer)[:200]))

    # --- called by its streams -------------------------------------------------------------------------

    def greeted(self, stream: _Stream, header: dict[str, str]) -> Publisher:
        """A publisher has said who it is.

        Raises:
            ProtocolError: it does not want us.
        """
        if "error" in header:
            raise ProtocolError(f"it refuses: {header['error'][:200]}")
        publisher = Publisher(
            header.get("callerid", "?"),
            stream.uri,
            header.get("type", ""),
            header.get("md5sum", ""),
            header.get("message_definition", ""),
            header.get("latching") == "1",
        )
        if self._md5 and self._md5 != publisher.md5:
            self._problems.tell(
                self.topic,
                f"{publisher.node} publishes {publisher.type} ({publisher.md5}), "
                f"where {self.type} ({self._md5}) came before",
            )
        self.type, self._md5 = publisher.type, publisher.md5
        self._problems.over(f"the publisher at {stream.uri}")
        self._standing[stream.uri] = publisher.node
        self._open.discard(stream.uri)
        for on_link in self._on_link:
            on_link(publisher, True)
        return publisher

    def lost(self, publisher: Publisher) -> None:
        self._standing.pop(publisher.uri, None)
        self._open.add(publisher.uri)
        for on_link in self._on_link:
            on_link(publisher, False)


class _Stream:
    """One TCPROS connection, our side of a subscriber, as it is read."""

    def __init__(self, subscription: Subscription, uri: str) -> None:
        loop = asyncio.get_running_loop()
        self.uri = uri
        self.messages = 0
        self.error: ProtocolError | None = None
        self.greeted: asyncio.Future[None] = loop.create_future()
        self.lost: asyncio.Future[None] = loop.create_future()
        self._subscription = subscription
        self._decoder = TcprosDecoder(subscription._keep, subscription._up_to)
        self._publisher: Publisher | None = None
        self._newest_ns = 0  # when the newest message came

    def received(self, data: memoryview, after_ns: int, arrived_ns: int) -> bool:
        decoder = self._decoder
        try:
            messages = decoder.receive(data)
        except ProtocolError as error:
            raise ProtocolError("it speaks no TCPROS", str(error)) from error
        publisher = self._publisher
        if publisher is None and decoder.header is not None:
            publisher = self._publisher = self._subscription.greeted(self, decoder.header)
            _set(self.greeted)
        if publisher is not None and messages:
            self.messages += len(messages)
            times_ns = spread(max(after_ns, self._newest_ns), arrived_ns, len(messages))
            self._newest_ns = arrived_ns
            for message, time_ns in zip(messages, times_ns, strict=True):
                for on_message in self._subscription._on_message:
                    on_message(publisher, message, time_ns)
        return decoder.within or decoder.longest > LARGE

    def ended(self, error: Exception | None) -> None:
        if self.lost.done():
            return
        if isinstance(error, ProtocolError):
            self.error = error
        elif error is not None and not isinstance(error, OSError):
            log.error("ROS 1: what came on %s from %s", self._subscription.topic, self.uri, exc_info=error)
        _set(self.greeted)
        _set(self.lost)
        if self._publisher is not None:
            self._subscription.lost(self._publisher)


def spread(after_ns: int, newest_ns: int, count: int) -> Iterable[int]:
    """Return when messages came of which only the newest one's time is known: evenly, after that."""
    if count < 2:
        return (newest_ns,) * count
    span_ns = max(0, newest_ns - after_ns)
    return (newest_ns - span_ns * left // count for left in range(count - 1, -1, -1))


def _set(future: asyncio.Future[None]) -> None:
    if not future.done():
        future.set_result(None)


async def _connected(host: str, port: int) -> socket.socket:
    """Return a connection that does not block.

    Raises:
        OSError, UnicodeError: none of the addresses takes one.
    """
    loop = asyncio.get_running_loop()
    found = await loop.getaddrinfo(host, port, type=socket.SOCK_STREAM)
    for number, (family, kind, protocol, _, address) in enumerate(found, 1):
        with ExitStack() as unless_it_stands:
            wire = unless_it_stands.enter_context(socket.socket(family, kind, protocol))
            wire.setblocking(False)
            wire.setsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE, 1)
            for option, value in KEEPALIVE:
                wire.setsockopt(socket.IPPROTO_TCP, option, value)
            try:
                await loop.sock_connect(wire, address)
            except OSError:
                if number == len(found):
                    raise
                continue
            unless_it_stands.pop_all()
            return wire
    raise OSError(f"{host} has no address")
