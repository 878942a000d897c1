"""XML-RPC on asyncio, as the ROS master and all ROS 1 nodes speak it: one call a connection, bounded.

What can go wrong with a peer is told apart, because it means different things: nobody listens there any more
(the process has ended), it took the connection and does not answer (it is frozen, or busy), the way there is
blocked, or it answers garbage.
"""

from __future__ import annotations

import asyncio
import errno
import fcntl
import re
import socket
import struct
import termios
import xmlrpc.client
from collections.abc import Callable
from typing import Any
from urllib.parse import urlsplit
from xml.parsers.expat import ExpatError

from robomend_client.bridges.problems import Complaint
from robomend_client.python310 import timeout

CALL_S = 5.0
"""How long a call may take: a master that answers later than this is as good as none."""

LONGEST_ANSWER = 16 * 1024 * 1024
"""Bytes; the state of a robot of a thousand nodes has about one million."""

LONGEST_REQUEST = 1024 * 1024
LONGEST_HEAD = 16 * 1024
MOST_CLIENTS = 64
HUNG_UP = {errno.ECONNREFUSED, errno.ECONNRESET, errno.ECONNABORTED, errno.EPIPE}
ERROR_NUMBER = re.compile(r"\[Errno (\d+)\]")

Connection = tuple[asyncio.StreamReader, asyncio.StreamWriter]

UNREADABLE = (ValueError, LookupError, TypeError, AttributeError, ExpatError, xmlrpc.client.Error)
"""What xmlrpc.client raises for bytes that are no XML-RPC."""


class PeerError(Complaint):
    """A call did not succeed."""


class NobodyListens(PeerError):
    """The connection was refused, or taken and closed by a process that ended: there is none any more."""


class NoAnswer(PeerError):
    """It took the connection, and said nothing in time."""


class OutOfReach(PeerError):
    """Its host name is unknown, or no way leads there."""


class NoConnection(OutOfReach):
    """The connection was not made in time."""


class Garbage(PeerError):
    """It answered something else than XML-RPC, or hung up."""


class CallRefused(PeerError):
    """It understood the call, and refused it."""


def address_of(uri: str) -> tuple[str, int]:
    """Return host and port of a node's or a master's address.

    Raises:
        OutOfReach: it is none.
    """
    try:
        parts = urlsplit(uri)
        if parts.scheme in ("http", "rosrpc") and parts.hostname and parts.port:
            return parts.hostname, parts.port
    except ValueError:
        pass
    raise OutOfReach(f"{uri!r} is no address; it should be like http://HOST:PORT/")


async def connect(host: str, port: int, timeout_s: float) -> Connection:
    """Open a connection; whatever hinders it is NobodyListens or OutOfReach."""
    try:
        async with timeout(timeout_s):
            return await asyncio.open_connection(host, port)
    except TimeoutError as error:
        raise NoConnection(f"{host}:{port} takes no connection within {timeout_s:g} s") from error
    except (OSError, UnicodeError) as error:
        raise unreachable(host, port, error) from error


def unreachable(host: str, port: int, error: Exception) -> PeerError:
    """Return what an error means that came of connecting."""
    # Of a name with several addresses asyncio joins the errors into one text, without a number.
    numbers = {int(number) for number in ERROR_NUMBER.findall(str(error))}
    if isinstance(error, ConnectionError) or (numbers and numbers <= HUNG_UP):
        return NobodyListens(f"nobody listens at {host}:{port}")
    if isinstance(error, (socket.gaierror, UnicodeError)):
        return OutOfReach(f"the host name {host!r} is unknown here")
    return OutOfReach(f"{host}:{port} cannot be reached: {getattr(error, 'strerror', None) or error}")


def is_delivered(connection: Connection) -> bool:
    """Return whether the peer's computer has confirmed all that was sent, whatever the peer does with it."""
    wire = connection[1].get_extra_info("socket")
    try:
        (waiting,) = struct.unpack("i", fcntl.ioctl(wire.fileno(), termios.TIOCOUTQ, bytes(4)))
    except (OSError, ValueError):
        return True  # it is closed, or this system does not say
    return int(waiting) == 0


async def call(uri: str, method: str, *arguments: Any, timeout_s: float = CALL_S) -> Any:
    """Call a method of a peer and return its answer.

    Raises:
        PeerError: see its subclasses.
    """
    return read_answer(method, await fetch(uri, method, *arguments, timeout_s=timeout_s))


async def fetch(uri: str, method: str, *arguments: Any, timeout_s: float = CALL_S) -> bytes:
    """Call a method of a peer and return its answer unread; as `call`."""
    connection = await connect(*address_of(uri), timeout_s)
    return await _exchange(connection, method, *arguments, timeout_s=timeout_s)


async def ask(connection: Connection, method: str, *arguments: Any, timeout_s: float = CALL_S) -> Any:
    """Call a method over a fresh connection, which is closed then; as `call`."""
    return read_answer(method, await _exchange(connection, method, *arguments, timeout_s=timeout_s))


async def _exchange(connection: Connection, method: str, *arguments: Any, timeout_s: float) -> bytes:
    reader, writer = connection
    body = xmlrpc.client.dumps(arguments, method).encode()
    head = f"POST / HTTP/1.0\r\nHost: ros\r\nContent-Type: text/xml\r\nContent-Length: {len(body)}\r\n\r\n"
    try:
        async with timeout(timeout_s):
            writer.write(head.encode() + body)
            return await _body(reader, LONGEST_ANSWER)
    except TimeoutError as error:
        raise NoAnswer(f"{method} was not answered within {timeout_s:g} s") from error
    except (OSError, EOFError, asyncio.LimitOverrunError) as error:
        raise Garbage(f"{method}: hung up without an answer") from error
    except ValueError as error:
        raise Garbage(f"{method}: the answer is no HTTP", str(error)) from error
    finally:
        writer.close()


def read_answer(method: str, answer: bytes) -> Any:
    """Return what was answered.

    Raises:
        CallRefused, Garbage: it is a refusal, or no answer.
    """
    try:
        (result,), _ = xmlrpc.client.loads(answer)
    except xmlrpc.client.Fault as error:
        raise CallRefused(f"{method}: {error.faultString}") from error
    except UNREADABLE as error:
        raise Garbage(f"{method}: the answer is no XML-RPC", str(error)) from error
    return result


async def _body(reader: asyncio.StreamReader, longest: int) -> bytes:
    """Read one HTTP message and return what is in it.

    Raises:
        ValueError: it is none, or longer than that.
    """
    head = await reader.readuntil(b"\r\n\r\n")
    if len(head) > LONGEST_HEAD:
        raise ValueError(f"a head of {len(head)} bytes")
    length = None
    for line in head.split(b"\r\n")[1:]:
        name, _, value = line.partition(b":")
        if name.strip().lower() == b"content-length":
            length = int(value)
    if length is not None and not 0 <= length <= longest:
        raise ValueError(f"{length} bytes, and {longest} are read")
    if length is not None:
        return await reader.readexactly(length)
    found = b""
    while data := await reader.read(65536):
        found += data
        if len(found) > longest:
            raise ValueError(f"more than {longest} bytes")
    return found


class XmlRpcServer:
    """Answers calls; `answer` gets the method and its arguments, and returns what XML-RPC can carry."""

    def __init__(
        self, answer: Callable[[str, tuple[Any, ...]], Any], on_garbage: Callable[[str, str], None]
    ) -> None:
        """`on_garbage` is told of a caller that speaks no XML-RPC: its computer, and why."""
        self.port = 0
        self._answer = answer
        self._on_garbage = on_garbage
        self._server: asyncio.Server | None = None
        self._clients: set[asyncio.Task[Any]] = set()

    async def open(self, host: str) -> None:
        """Listen on a port that the system chooses."""
        self._server = await asyncio.start_server(self._serve, host, 0, limit=LONGEST_HEAD)
        self.port = self._server.sockets[0].getsockname()[1]

    async def close(self) -> None:
        if self._server is not None:
            self._server.close()
            for client in self._clients:
                client.cancel()
            await asyncio.gather(*self._clients, return_exceptions=True)

    async def _serve(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        task = asyncio.current_task()
        assert task is not None
        self._clients.add(task)
        try:
            if len(self._clients) <= MOST_CLIENTS:
                async with timeout(CALL_S):
                    await self._answer_one(reader, writer)
        except asyncio.CancelledError:
            pass  # the server is closing
        except (asyncio.LimitOverrunError, *UNREADABLE) as error:
            self._on_garbage(_computer(writer), str(error) or type(error).__name__)
        except asyncio.IncompleteReadError as error:
            if error.partial:  # who looks whether anybody listens says nothing
                self._on_garbage(_computer(writer), f"it hung up after {error.partial[:40]!r}")
        except OSError:  # it is gone, or says nothing for CALL_S
            pass
        finally:
            self._clients.discard(task)
            writer.close()

    async def _answer_one(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        arguments, method = xmlrpc.client.loads(await _body(reader, LONGEST_REQUEST))
        answer = self._answer(str(method), arguments)
        body = xmlrpc.client.dumps((answer,), methodresponse=True).encode()
        head = f"HTTP/1.0 200 OK\r\nContent-Type: text/xml\r\nContent-Length: {len(body)}\r\n\r\n"
        writer.write(head.encode() + body)
        await writer.drain()


def _computer(writer: asyncio.StreamWriter) -> str:
    """Return where a caller is; its port is another one each time."""
    peer = writer.get_extra_info("peername")
    return str(peer[0]) if peer else "somewhere"
