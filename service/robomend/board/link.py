"""A live link to one power board: the only file of the service with a socket to it.

    CONNECTING ──► CONNECTED ◄──► SILENT ──┐
        ▲ ▲            │                   │
        │ └────────────┴► DISCONNECTED ◄───┘      close() at any point ──► CLOSED
        └────────────────────┘ (back-off)

The link keeps a connection as long as it is open, and asks the board for measurements at `broadcast_hz`.
Silence is unknown, never "unchanged": after three missed broadcasts the state is SILENT and the snapshot
empty; after ten the connection is dropped, as a half-open one looks just the same. Reconnection backs off
from 0.1 s to 5 s with jitter, so that a fleet does not come back in step.

One command is outstanding at a time; callers queue. A command that gets no answer in time raises
BoardTimeout: whether the board acted is unknown, and as acknowledges carry no id, a late one would be taken
for the next command's. So the connection is replaced. Whatever the board did shows in its next
measurements.

Every wait has a time-out. Links share nothing, so that one loop can hold any number of them.
"""

from __future__ import annotations

import asyncio
import logging
import os
import random
import time
from collections.abc import AsyncGenerator, Callable, Iterator
from dataclasses import dataclass
from enum import StrEnum
from types import TracebackType

from robomend.board.codec import (
    Broadcast,
    ChannelReading,
    Code,
    Measurements,
    Request,
    Specification,
    SwitchChannel,
)
from robomend.board.session import Answered, Command, Session
from robomend.errors import (
    BoardError,
    BoardRefused,
    BoardTimeout,
    BoardUnreachable,
)

# --- what is known of the board at one moment; when nothing is, why.


@dataclass(frozen=True, slots=True)
class Snapshot:
    """Every channel's reading at a time, or None: unknown, which is neither on nor off."""

    time_ns: int  # integer nanoseconds since the epoch, this computer's clock on receipt
    channels: tuple[ChannelReading, ...] | None
    reason: str = ""  # why it is unknown


logger = logging.getLogger(__name__)

READ_SIZE = 1 << 16
BACKLOG = 64  # snapshots kept for a reader that lags; then the oldest go
MISSED = 3  # broadcasts missed in a row: the board is silent
MISSED_MANY = 10  # … : the connection is dropped
SLICES = 4  # in which it is waited for measurements
LEAST_SILENCE_S = 0.5  # at high rates, a hiccup of either computer is not silence
LEAST_DEAD_S = 2.0

REFUSALS = {
    Code.UNKNOWN_CHANNEL: "it has no such channel: compare the model's channels with the board's",
    Code.BAD_VALUE: "it does not accept the value",
    Code.CHANNEL_FAULTY: "the channel is faulty (a relay that sticks, a short): look at its wiring",
    Code.UNKNOWN_COMMAND: "it does not know the command: is it an older board?",
}


class LinkState(StrEnum):
    """How the link stands."""

    CONNECTING = "connecting"
    CONNECTED = "connected"  # measurements come
    SILENT = "silent"  # connected, but no measurements: the channels are unknown
    DISCONNECTED = "disconnected"  # waiting for the next attempt
    CLOSED = "closed"


def backoff(least_s: float, most_s: float) -> Iterator[float]:
    """Yield the waits between attempts: doubling up to the most, each shortened at random by up to a half."""
    delay_s = least_s
    while True:
        yield delay_s * random.uniform(0.5, 1.0)
        delay_s = min(2 * delay_s, most_s)


class BoardLink:
    """Keeps one board connected; give it to everything that needs this board.

    Start it with `async with BoardLink(...)` or `start()`. `on_state` runs in the event loop and must
    not block.
    """

    def __init__(
        self,
        host: str,
        port: int,
        *,
        broadcast_hz: int = 5,
        connect_timeout_s: float = 3.0,
        command_timeout_s: float = 2.0,
        backoff_s: tuple[float, float] = (0.1, 5.0),
        on_state: Callable[[LinkState, str], None] | None = None,
    ) -> None:
        if not 1 <= broadcast_hz <= 255:
            raise ValueError(f"broadcast_hz is {broadcast_hz}; the board takes 1 to 255")
        if not 1 <= port <= 65535:
            raise ValueError(f"port is {port}; a board listens on one from 1 to 65535")
        self.host = host
        self.port = port
        self.broadcast_hz = broadcast_hz
        self._connect_timeout_s = connect_timeout_s
        self._command_timeout_s = command_timeout_s
        self._backoff_s = backoff_s
        self._silence_s = max(MISSED / broadcast_hz, LEAST_SILENCE_S)
        self._dead_s = max(MISSED_MANY / broadcast_hz, LEAST_DEAD_S, 2 * self._silence_s)
        self._on_state = on_state
        self._readers: set[asyncio.Queue[Snapshot | None]] = set()
        self._task: asyncio.Task[None] | None = None
        self._turn = asyncio.Lock()
        self._ready = asyncio.Event()
        self._session: Session | None = None
        self._writer: asyncio.StreamWriter | None = None
        self._answer: asyncio.Future[Answered] | None = None
        self._heard_at = 0.0
        self._measured = False  # on this connection
        self.specification: Specification | None = None
        self.state = LinkState.CONNECTING
        self.reason = "not yet connected"
        self.snapshot = Snapshot(time.time_ns(), None, self.reason)

    def __repr__(self) -> str:
        return f"BoardLink({self.host}:{self.port}, {self.state})"

    @property
    def channels(self) -> int | None:
        """How many channels the board has; None until it was reached once."""
        return len(self.specification.channels) if self.specification else None

    # --- life ------------------------------------------------------------------------------------------

    def start(self) -> None:
        """Connect, and stay connected until close()."""
        if self._task is None and self.state is not LinkState.CLOSED:
            self._task = asyncio.create_task(self._run(), name=f"board {self.host}:{self.port}")

    async def close(self) -> None:
        """Drop the connection and end every wait; idempotent."""
        if self.state is LinkState.CLOSED:
            return
        task, self._task = self._task, None
        if task is not None:
            task.cancel()
            await asyncio.wait([task], timeout=1.0)
        self._drop("the link was closed")
        self._enter(LinkState.CLOSED, "the link was closed")
        self._ready.set()  # wakes the commands that wait for a connection, to tell them
        for queue in self._readers:
            _put(queue, None)

    async def __aenter__(self) -> BoardLink:
        self.start()
        return self

    async def __aexit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        await self.close()

    # --- what callers ask for --------------------------------------------------------------------------

    async def switch(self, channel: int, on: bool, timeout_s: float | None = None) -> None:
        """Switch a channel on or off; returns when the board has acknowledged. Repeating it does no harm.

        Raises:
            BoardUnreachable: no connection within the time; the board did not get the command.
            BoardRefused: the board said no, with the reason.
            BoardTimeout: no answer within the time; whether the board acted is unknown.
        """
        if not 0 <= channel <= 255:
            raise self._refusal(f"switch channel {channel}", Code.UNKNOWN_CHANNEL)
        await self._command(SwitchChannel(channel, int(on)), f"switch channel {channel}", timeout_s)

    async def request(self, timeout_s: float | None = None) -> Snapshot:
        """Ask for measurements now and return them; raises as switch does."""
        await self._command(Request(), "send measurements", timeout_s)
        return self.snapshot

    async def wait_connected(self, timeout_s: float) -> None:
        """Return as soon as commands can be sent; BoardUnreachable if that takes longer."""
        try:
            async with asyncio.timeout(timeout_s):
                await self._ready.wait()
        except TimeoutError:
            raise self._unreachable() from None
        if self.state is LinkState.CLOSED:
            raise self._unreachable()

    async def measurements(self) -> AsyncGenerator[Snapshot, None]:
        """Yield the present snapshot, then each new one, until the link is closed.

        A reader that lags by more than BACKLOG snapshots misses the oldest, never the newest. Silence ends
        in a snapshot of its own, so that the wait for the next one is bounded.
        """
        queue: asyncio.Queue[Snapshot | None] = asyncio.Queue(BACKLOG)
        _put(queue, self.snapshot)
        if self.state is LinkState.CLOSED:
            return
        self._readers.add(queue)
        try:
            while (snapshot := await queue.get()) is not None:
                yield snapshot
        finally:
            self._readers.discard(queue)

    # --- commands --------------------------------------------------------------------------------------

    async def _command(self, command: Command, doing: str, timeout_s: float | None) -> None:
        timeout_s = self._command_timeout_s if timeout_s is None else timeout_s
        answer: asyncio.Future[Answered] | None = None
        try:
            async with asyncio.timeout(timeout_s), self._turn:
                await self.wait_connected(timeout_s)
                session, writer = self._session, self._writer
                if session is None or writer is None:  # lost between the event and now
                    raise self._unreachable()
                frame = session.send(command)
                answer = self._answer = asyncio.get_running_loop().create_future()
                try:
                    writer.write(frame)
                    answered = await answer
                finally:
                    if not answer.done() or answer.cancelled():
                        self._drop(f"a command was given up: {doing}")
                    self._answer = None
        except TimeoutError:
            if answer is None:
                raise self._unreachable() from None
            raise BoardTimeout(
                f"the board at {self.host}:{self.port} did not answer within {timeout_s:g} s: {doing};"
                " whether it acted is unknown, its next measurements will show"
            ) from None
        if not answered.ok:
            raise self._refusal(doing, answered.code)

    def _refusal(self, doing: str, code: int) -> BoardRefused:
        why = REFUSALS.get(Code(code)) if code in REFUSALS else None
        sentence = why or "its manual says what that means"
        return BoardRefused(
            f"the board at {self.host}:{self.port} refused to {doing} (code {code}): {sentence}"
        )

    def _unreachable(self) -> BoardUnreachable:
        if self._ready.is_set() and self.state is not LinkState.CLOSED:
            why = "another command was still waiting for its answer"
        else:
            why = self.reason
        return BoardUnreachable(f"no command reached the board at {self.host}:{self.port}: {why}")

    # --- the connection --------------------------------------------------------------------------------

    async def _run(self) -> None:
        delays = backoff(*self._backoff_s)
        while True:
            try:
                await self._converse()
            except TimeoutError:
                reason = f"no answer within {self._connect_timeout_s:g} s: is it a power board?"
            except (OSError, UnicodeError, BoardError) as error:
                reason = _said(error)
            except Exception as error:  # a bug must not leave the last snapshot standing as if it were true
                logger.exception("board %s:%s: the link failed", self.host, self.port)
                reason = f"the link failed: {error!r}"
            finally:
                measured, self._measured = self._measured, False
                self._close_writer()
            self._drop(reason)
            if measured:  # it did work: the next attempt comes soon
                delays = backoff(*self._backoff_s)
            await asyncio.sleep(next(delays))

    async def _converse(self) -> None:
        """Hold one connection; it always ends in an exception that says why."""
        self._enter(LinkState.CONNECTING, self.reason)
        session = Session()
        async with asyncio.timeout(self._connect_timeout_s):
            reader, self._writer = await asyncio.open_connection(self.host, self.port)
            while session.specification is None:
                await self._read(reader, session)
            self._writer.write(session.send(Broadcast(self.broadcast_hz)))
            answered = None
            while answered is None:
                answered = await self._read(reader, session)
        if not answered.ok:
            raise self._refusal(f"broadcast at {self.broadcast_hz} Hz", answered.code)
        self.specification, self._session = session.specification, session
        self._enter(LinkState.CONNECTED, "")
        self._ready.set()
        loop = asyncio.get_running_loop()
        self._heard_at, missed = loop.time(), 0
        while True:
            patience_s = self._dead_s if self.state is LinkState.SILENT else self._silence_s
            before_s = self._heard_at
            try:
                # It is waited for in parts: where this service was itself held up, only one of them is over
                # at once, and what waits in the socket is read before the next.
                async with asyncio.timeout(patience_s / SLICES):
                    await self._read(reader, session)
            except TimeoutError:
                missed += 1
            if self._heard_at > before_s:
                missed = 0
            if missed < SLICES:
                continue
            missed = 0
            if self.state is LinkState.SILENT:
                raise BoardUnreachable(f"no measurements for {self._dead_s:g} s") from None
            self._enter(LinkState.SILENT, f"no measurements for {self._silence_s:g} s")
            self._publish(Snapshot(time.time_ns(), None, self.reason))

    async def _read(self, reader: asyncio.StreamReader, session: Session) -> Answered | None:
        """Take what has come, at least one byte of it; return the answer if one was among it."""
        answered = None
        data = await reader.read(READ_SIZE)
        if not data:
            raise BoardUnreachable("the board closed the connection")
        for event in session.receive(data):
            match event:
                case Measurements():
                    self._heard_at = asyncio.get_running_loop().time()
                    self._measured = True
                    if self.state is LinkState.SILENT:
                        self._enter(LinkState.CONNECTED, "")
                    self._publish(Snapshot(time.time_ns(), event.channels))
                case Answered():
                    answered = event
                    if self._answer is not None and not self._answer.done():
                        self._answer.set_result(event)
        return answered

    def _drop(self, reason: str) -> None:
        """Give the connection up at once: from here on nothing is known and nothing is sent."""
        self._close_writer()
        self._session = None
        self._ready.clear()
        if self._answer is not None and not self._answer.done():
            self._answer.set_exception(
                BoardTimeout(f"{self.host}:{self.port}: {reason}; whether the board acted is unknown")
            )
        if self.state not in (LinkState.DISCONNECTED, LinkState.CLOSED):
            self._enter(LinkState.DISCONNECTED, reason)
        if self.snapshot.channels is not None:
            self._publish(Snapshot(time.time_ns(), None, reason))

    def _close_writer(self) -> None:
        if self._writer is not None:
            self._writer.transport.abort()
            self._writer = None

    # --- telling ---------------------------------------------------------------------------------------

    def _enter(self, state: LinkState, reason: str) -> None:
        if (state, reason) == (self.state, self.reason):
            return
        news = state is not LinkState.CONNECTING and reason != self.reason  # else a line an attempt
        level = logging.INFO if news else logging.DEBUG
        logger.log(level, "board %s:%s %s %s", self.host, self.port, state, reason)
        self.state, self.reason = state, reason
        if self._on_state is not None:
            try:
                self._on_state(state, reason)
            except Exception:  # a bug of whoever listens must not end the link
                logger.exception("board %s:%s: a state callback failed", self.host, self.port)

    def _publish(self, snapshot: Snapshot) -> None:
        self.snapshot = snapshot
        for queue in self._readers:
            _put(queue, snapshot)


def _said(error: Exception) -> str:
    """Return why there is no connection, in words: of the system's errors without numbers and addresses."""
    if isinstance(error, OSError) and error.errno is not None and error.errno > 0:
        return os.strerror(error.errno)
    if isinstance(error, OSError) and error.strerror:  # of a name that nobody knows
        return error.strerror
    return str(error) or type(error).__name__


def _put(queue: asyncio.Queue[Snapshot | None], snapshot: Snapshot | None) -> None:
    if queue.full():
        queue.get_nowait()
    queue.put_nowait(snapshot)
