"""The emulator on the network: one board, any number of clients, each with its own broadcast.

One misbehaving client must not hold up the others. A client that does not read is dropped when MAX_UNSENT
bytes wait for it; one that sends without end gets its turn, TURN messages at a time; and there are at most
`max_clients`.
"""

from __future__ import annotations

import asyncio
import logging
import random
import socket
from collections import deque
from collections.abc import Callable
from typing import cast

from robomend.board.codec import (
    DELIMITER,
    Acknowledge,
    Broadcast,
    Code,
    Decoder,
    Measurements,
    Message,
    Request,
    SwitchChannel,
    Unreadable,
    encode,
)
from robomend.errors import BoardError
from robomend_board.board import Board, ChannelState
from robomend_board.faults import FAULTS, Fault, FaultError, Line, Scope

# --- the board's half of a conversation: commands in, replies out. Sans-io, the mirror of
# robomend.board.session.


class Conversation:
    """One client's connection. Each has its own broadcast rate; all share the board."""

    def __init__(self, board: Board) -> None:
        self._board = board
        self._decoder = Decoder()
        self.broadcast_hz = 0

    def greeting(self) -> Message:
        """Return what the board says first."""
        return self._board.specification()

    def receive(self, data: bytes) -> None:
        """Take bytes from the client; then call replies until it returns None."""
        self._decoder.receive(data)

    def replies(self, now_s: float) -> list[Message] | None:
        """Carry out the next command and return what to send; None until more bytes arrive.

        Raises:
            RemoteProtocolError: the bytes are no frame; drop the connection.
        """
        match self._decoder.next_message():
            case None:
                return None
            case Broadcast(frequency_hz):
                self.broadcast_hz = frequency_hz
                return [Acknowledge(Code.OK)]
            case Request():
                return [Acknowledge(Code.OK), self._board.measure(now_s)]
            case SwitchChannel(channel, state):
                return [Acknowledge(self._board.switch(channel, state, now_s))]
            case Unreadable(code=code):
                return [Acknowledge(code)]
            case _:  # a message that only boards send
                return [Acknowledge(Code.UNKNOWN_COMMAND)]


logger = logging.getLogger(__name__)

MAX_UNSENT = 1 << 16  # bytes waiting for one client, beyond the kernel's buffer
KERNEL_BUFFER = 1 << 14  # … which is kept small, so that a slow client shows soon
TURN = 32  # commands of one client in a row

Watcher = Callable[[dict[int, ChannelState]], None]


class Emulator:
    """One board, its line and all who are connected. `keep` gets the relays whenever one has moved."""

    def __init__(
        self,
        board: Board,
        *,
        keep: Callable[[tuple[bool, ...]], None] = lambda relays: None,
        max_clients: int = 16,
        seed: int = 0,
    ) -> None:
        self.board = board
        self.line = Line()
        self.clients: set[Client] = set()
        self.watchers: set[Watcher] = set()
        self.max_clients = max_clients
        self.dropped = 0  # clients that did not read
        self._keep = keep
        self._random = random.Random(seed)
        self._loop = asyncio.get_running_loop()
        self._relays = board.relays()
        self._states = board.states(self.now_s())
        self._trip: asyncio.TimerHandle | None = None
        self._listener: asyncio.Server | None = None
        self.host = ""
        self.port = 0

    def now_s(self) -> float:
        """Return the time that the board is told."""
        return self._loop.time()

    async def listen(self, host: str, port: int) -> None:
        """Open the port to clients; OSError if it is taken."""
        self._listener = await self._loop.create_server(lambda: Client(self), host, port)
        self.host, self.port = self._listener.sockets[0].getsockname()[:2]

    async def close(self) -> None:
        """Drop every client and close the port."""
        if self._listener is not None:
            self._listener.close()
        if self._trip is not None:
            self._trip.cancel()
        for client in tuple(self.clients):
            client.drop("the emulator ends")
        await asyncio.sleep(0)  # lets the transports close their sockets

    # --- what the control port does --------------------------------------------------------------------

    def switch(self, channel: int, on: bool) -> bool:
        """Move a relay although no client asked; False if it does not move."""
        code = self.board.switch(channel, int(on), self.now_s())
        self.settle()
        return not code

    async def set_fault(self, fault: Fault) -> None:
        """Apply a fault of any scope; OSError if a port cannot be opened again."""
        if fault.kind.scope is not Scope.LINE:
            self.board.set_fault(fault, self.now_s())
        elif fault.name == "drop":
            for client in tuple(self.clients):
                client.drop("a fault was asked for: drop")
        elif fault.name == "garbage":
            for client in tuple(self.clients):
                client.transmit(self._garbage(int(fault.parameters["size"])))
        else:
            self.line.set(fault)
        self._refuse()
        self.settle()

    async def clear(self, name: str, channel: int | None) -> None:
        """Take one fault away, or all of them with the name `all`."""
        for each in FAULTS if name == "all" else (name,):
            if each not in FAULTS:
                raise FaultError(f"there is no fault {each!r}; there are {', '.join(FAULTS)}, and all")
            if FAULTS[each].scope is Scope.LINE:
                self.line.clear(each)
            else:
                self.board.clear_fault(each, channel, self.now_s())
        if self._listener is None and not self.line.refuse and self.port:
            await self.listen(self.host, self.port)
        self.settle()

    def _refuse(self) -> None:
        if self.line.refuse and self._listener is not None:
            self._listener.close()
            self._listener = None

    def _garbage(self, size: int) -> bytes:
        noise = bytearray(self._random.randbytes(size))
        if noise[0] == DELIMITER:
            noise[0] ^= 0xFF
        return bytes(noise)

    # --- what follows from a change --------------------------------------------------------------------

    def settle(self) -> None:
        """Keep the relays and tell the watchers if anything changed; wake up again when a channel will trip.

        Called before a command is acknowledged: what a client was told survives a crash of the emulator.
        """
        states = self.board.states(self.now_s())
        relays = self.board.relays()
        if relays != self._relays:
            self._relays = relays
            try:
                self._keep(relays)
            except OSError:
                logger.exception("the relays could not be kept; the board goes on without")
        changed = {
            n: new for n, (old, new) in enumerate(zip(self._states, states, strict=True)) if old != new
        }
        self._states = states
        if changed:
            for watcher in tuple(self.watchers):
                watcher(changed)
        if self._trip is not None:
            self._trip.cancel()
            self._trip = None
        if (trip_s := self.board.next_trip_s()) is not None:
            self._trip = self._loop.call_at(trip_s, self.settle)

    def measure(self) -> Measurements:
        """Read the board now."""
        measured = self.board.measure(self.now_s())
        if tuple(reading.on for reading in measured.channels) != self._relays:
            self.settle()
        return measured


class Client(asyncio.Protocol):
    """One connection: feeds the conversation, keeps the broadcast's time, and sends through the line's
    faults.
    """

    def __init__(self, emulator: Emulator) -> None:
        self._emulator = emulator
        self._loop = asyncio.get_running_loop()
        self._conversation = Conversation(emulator.board)
        self._transport: asyncio.Transport | None = None
        self._broadcast: asyncio.TimerHandle | None = None
        self._next_broadcast_s = 0.0
        self._pending: deque[tuple[float, bytes]] = deque()  # due time, bytes; held back by the line's faults
        self._pending_bytes = 0
        self._sender: asyncio.TimerHandle | None = None
        self._paused = False  # while a client that sends without end waits for its next turn
        self.peer = ""

    @property
    def broadcast_hz(self) -> int:
        return self._conversation.broadcast_hz

    # --- asyncio.Protocol ------------------------------------------------------------------------------

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        transport = cast(asyncio.Transport, transport)  # uvloop's is one in all but its base class
        self._transport = transport
        self.peer = "{}:{}".format(*transport.get_extra_info("peername")[:2])
        if len(self._emulator.clients) >= self._emulator.max_clients:
            self.drop(f"there are {self._emulator.max_clients} clients already")
            return
        transport.get_extra_info("socket").setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, KERNEL_BUFFER)
        self._emulator.clients.add(self)
        logger.info("client %s connected", self.peer)
        self._send(self._conversation.greeting())

    def data_received(self, data: bytes) -> None:
        try:
            self._conversation.receive(data)
        except BoardError as error:
            self.drop(str(error))
            return
        self._converse()

    def connection_lost(self, error: Exception | None) -> None:
        logger.info("client %s is gone", self.peer)
        self._transport = None
        self._forget()

    # --- commands --------------------------------------------------------------------------------------

    def _converse(self) -> None:
        """Answer what has come, TURN commands at a time so that the other clients get their turn too."""
        for _ in range(TURN):
            if self._transport is None or self._transport.is_closing():
                return
            rate = self.broadcast_hz
            try:
                replies = self._conversation.replies(self._emulator.now_s())
            except BoardError as error:
                self.drop(str(error))
                return
            if replies is None:
                if self._paused:
                    self._paused = False
                    self._transport.resume_reading()
                return
            self._emulator.settle()
            for message in replies:
                self._send(message)
            if self.broadcast_hz != rate:
                self._start_broadcast()
        if self._transport is not None and not self._transport.is_closing():
            if not self._paused:
                self._paused = True
                self._transport.pause_reading()
            self._loop.call_soon(self._converse)

    # --- broadcast -------------------------------------------------------------------------------------

    def _start_broadcast(self) -> None:
        if self._broadcast is not None:
            self._broadcast.cancel()
            self._broadcast = None
        if self.broadcast_hz:
            self._next_broadcast_s = self._loop.time() + 1 / self.broadcast_hz
            self._broadcast = self._loop.call_at(self._next_broadcast_s, self._tick)

    def _tick(self) -> None:
        # From due time to due time, so that the rate does not drift; what was missed is left out.
        period_s = 1 / self.broadcast_hz
        self._next_broadcast_s = max(self._next_broadcast_s + period_s, self._loop.time())
        self._broadcast = self._loop.call_at(self._next_broadcast_s, self._tick)
        self._send(self._emulator.measure())

    # --- sending ---------------------------------------------------------------------------------------

    def _send(self, message: Message) -> None:
        self.transmit(encode(message))

    def transmit(self, frame: bytes) -> None:
        """Send bytes, as whole and as soon as the line's faults allow, and after all that was sent before."""
        if self._transport is None or self._transport.is_closing():
            return
        if self._emulator.line.clean and not self._pending:
            self._transport.write(frame)
        else:
            # First in, first out, whatever is due when: no piece overtakes one of an earlier frame.
            now_s = self._loop.time()
            for wait_s, piece in self._emulator.line.pieces(frame):
                self._pending.append((now_s + wait_s, piece))
                self._pending_bytes += len(piece)
            self._send_pending()
        if self._unsent() > MAX_UNSENT:
            self._emulator.dropped += 1
            self.drop(f"it does not read: {self._unsent()} bytes wait for it")

    def _unsent(self) -> int:
        kernel = self._transport.get_write_buffer_size() if self._transport else 0
        return self._pending_bytes + kernel

    def _send_pending(self) -> None:
        if self._sender is not None:
            self._sender.cancel()
            self._sender = None
        while self._pending and self._transport is not None and not self._transport.is_closing():
            due_s, piece = self._pending[0]
            if due_s > self._loop.time():
                self._sender = self._loop.call_at(due_s, self._send_pending)
                return
            self._pending.popleft()
            self._pending_bytes -= len(piece)
            self._transport.write(piece)

    def drop(self, reason: str) -> None:
        """Close the connection at once, unsent bytes and all."""
        if self._transport is not None:
            logger.info("client %s is dropped: %s", self.peer, reason)
            self._transport.abort()
        self._forget()

    def _forget(self) -> None:
        for timer in (self._broadcast, self._sender):
            if timer is not None:
                timer.cancel()
        self._broadcast = self._sender = None
        self._pending.clear()
        self._pending_bytes = 0
        self._emulator.clients.discard(self)
