"""Server-sent events: every client its own place in one log.

    store.subscribe ──► Hub ──┬─► pending frames of each stream ──► the client
                              └─► straight to a client that has everything else
    store.events(after) ─────────────────► a stream that resumes, or that fell behind

Frames are encoded once and shared. A client that reads slowly holds up nobody: when its pending frames are
too many they are dropped, and it goes on from the log after the last event that it got. A Last-Event-ID
that the log does not know (malformed, from another database, or pruned) replays from the oldest event kept,
after an event `gap`.
"""

from __future__ import annotations

import asyncio
import json
import time
from collections import deque
from collections.abc import AsyncIterator, Awaitable, Callable, Collection, Sequence
from dataclasses import dataclass
from json.encoder import encode_basestring_ascii

from starlette.responses import Response
from starlette.types import Receive, Scope, Send

from robomend.api.body import left
from robomend.api.problems import Problem
from robomend.metrics import Metrics
from robomend.store import Store, events
from robomend.store.encoding import to_json
from robomend_client.events import Event

PENDING = 1000
"""Frames kept for a client that is slow; beyond, it is served from the log."""

PAGE = 500
"""Events read from the log at once."""

STILL_S = 2.0
"""Between two looks whether a stream's key is still good; an idle stream looks with its next ping."""

RETRY_MS = 1000
"""How long a browser waits before it comes back."""

BRIEF_APART_S = 0.2
"""Between two writes to a page, of many: what comes meanwhile goes out together. A page asks for its parts no
more often, and each write to each of fifty pages is in the way of the robot whose change comes next."""

BRIEF_AT_ONCE = 5
"""Writes that nothing holds up: what follows one change, a diagnosis, a repair, its plan, comes at once."""

PING = b"event: ping\ndata: {}\n\n"

Frame = tuple[int, bytes]

Still = Callable[[], Awaitable[bool]]
"""Whether whoever opened a stream would be let in now."""


def encode(event: Event, brief: bool = False) -> bytes:
    """Return an event as it goes over the wire; `brief`: without its data."""
    robot = "null" if event.robot is None else encode_basestring_ascii(event.robot)
    data = "{}" if brief else to_json(event.data)
    text = f'{{"time_ns":{event.time_ns},"robot":{robot},"data":{data}}}'
    return f"id: {event.id}\nevent: {event.kind}\ndata: {text}\n\n".encode()


class Hub:
    """Hands each committed event to the streams that want it."""

    def __init__(self, store: Store, metrics: Metrics, *, most: int, ping_s: float) -> None:
        self.store = store
        self.ping_s = ping_s
        self.closing = False
        self._most = most
        self._metrics = metrics
        self._streams: dict[str | None, set[Stream]] = {}
        self.count = 0

    def start(self) -> None:
        """Listen to the store; belongs to its event loop."""
        self.store.subscribe(self._publish)

    def close(self) -> None:
        """End all streams, so that the server need not wait for them."""
        self.closing = True
        for streams in self._streams.values():
            for stream in streams:
                stream.wake.set()

    def open(
        self,
        robot: str | None,
        last_event_id: str | None,
        *,
        kinds: Collection[str] = (),
        about: str | None = None,
        brief: bool = False,
    ) -> Stream:
        """Return a stream that collects from now on. 503 when there are too many.

        Args:
            kinds: of events; none: all.
            about: leave out what is about another robot than this one.
            brief: events come without their data, and pings as events, which a page's script can see.
        """
        if self.closing:
            raise Problem(503, "the service is shutting down")
        if self.count >= self._most:
            self._metrics.refused.labels("streams").inc()
            raise Problem(
                503, f"{self._most} event streams are open; that is the limit", headers={"Retry-After": "5"}
            )
        stream = Stream(self, robot, last_event_id, Wanted(frozenset(kinds), about, brief))
        self._streams.setdefault(robot, set()).add(stream)
        self.count += 1
        self._metrics.streams.set(self.count)
        return stream

    def forget(self, stream: Stream) -> None:
        """Take a stream out that has ended."""
        streams = self._streams.get(stream.robot, set())
        if stream in streams:
            streams.remove(stream)
            self.count -= 1
            self._metrics.streams.set(self.count)
            if not streams:
                del self._streams[stream.robot]

    def _publish(self, events: tuple[Event, ...]) -> None:
        streams = self._streams
        if not streams:
            return
        frames = Frames(events)
        for stream in streams.get(None, ()):
            stream.offer(frames.all() if stream.wants_all else frames.of(stream.wanted))
        if len(streams) > (None in streams):
            for robot in {event.robot for event in events if event.robot is not None}:
                for stream in streams.get(robot, ()):
                    stream.offer(frames.of(stream.wanted, robot))


class Frames:
    """The events of a commit as they go over the wire; each is encoded once, if a stream wants it."""

    __slots__ = ("_all", "_events", "_made")

    def __init__(self, events: Sequence[Event]) -> None:
        self._events = events
        self._all: list[Frame] | None = None
        self._made: dict[tuple[int, bool], Frame] = {}

    def all(self) -> list[Frame]:
        """Return those for a stream that wants everything."""
        if self._all is None:
            self._all = [(event.id, encode(event)) for event in self._events]
        return self._all

    def of(self, wanted: Wanted, robot: str | None = None) -> list[Frame]:
        """Return those for another stream; `robot`: only that one's."""
        events = (event for event in self._events if robot is None or event.robot == robot)
        return [self._frame(event, wanted.brief) for event in events if wanted.covers(event)]

    def _frame(self, event: Event, brief: bool) -> Frame:
        made = self._made.get((event.id, brief))
        if made is None:
            made = self._made[event.id, brief] = (event.id, encode(event, brief))
        return made


@dataclass(frozen=True, slots=True)
class Wanted:
    """Which events a client asked for, and how; see Hub.open."""

    kinds: frozenset[str]
    about: str | None
    brief: bool

    def covers(self, event: Event) -> bool:
        """Return whether the client asked for this one."""
        return (not self.kinds or event.kind in self.kinds) and (
            self.about is None or event.robot is None or event.robot == self.about
        )


EVERYTHING = Wanted(frozenset(), None, brief=False)


class Stream:
    """One client's place in the log."""

    def __init__(self, hub: Hub, robot: str | None, last_event_id: str | None, wanted: Wanted) -> None:
        self.robot = robot
        self.wanted = wanted
        self.wants_all = wanted == EVERYTHING
        """No event is left out, and nothing of one: most streams are of this kind."""
        self.wake = asyncio.Event()
        self._hub = hub
        self._asked = last_event_id
        self._pending: deque[Frame] = deque()
        self._from_log = last_event_id is not None
        self._last = 0
        self._next_s = 0.0  # the place of the next write, of one that is paced

    def offer(self, frames: Sequence[Frame]) -> None:
        """Take the frames of a commit, or note that there are too many."""
        if self._from_log or not frames:
            return
        for frame in frames:
            if len(self._pending) >= PENDING:
                self._pending.clear()
                self._from_log = True
                break
            self._pending.append(frame)
        self.wake.set()

    async def frames(self) -> AsyncIterator[bytes]:
        """Yield what the client gets, until the service shuts down."""
        yield f"retry: {RETRY_MS}\n: robomend events\n\n".encode()
        if self._asked is not None:
            gap = await self._resume(self._asked)
            if gap is not None:
                yield gap
        while not self._hub.closing:
            if self._from_log:
                chunk = await self._catch_up()
            else:
                chunk = b"".join([frame for number, frame in self._pending if number > self._last])
                if self._pending:
                    self._last = max(self._last, self._pending[-1][0])
                    self._pending.clear()
            if chunk:
                yield chunk
                if self.wanted.brief:
                    await self._apart()
            elif not self._from_log:
                self.wake.clear()
                try:
                    async with asyncio.timeout(self._hub.ping_s):
                        await self.wake.wait()
                except TimeoutError:
                    yield PING if self.wanted.brief else b": ping\n\n"

    async def _apart(self) -> None:
        """Wait until more may go out, where much does."""
        now_s = time.monotonic()
        self._next_s = max(now_s, self._next_s) + BRIEF_APART_S
        wait_s = self._next_s - now_s - BRIEF_AT_ONCE * BRIEF_APART_S
        if wait_s > 0:
            await asyncio.sleep(wait_s)

    async def _resume(self, asked: str) -> bytes | None:
        """Find the place to go on from; return a gap event if that is not where the client was."""
        kept = await self._hub.store.read(events.kept)
        last = int(asked) if asked.isascii() and asked.isdigit() and len(asked) < 19 else -1
        if kept.oldest - 1 <= last <= kept.newest:
            self._last = last
            return None
        self._last = kept.oldest - 1
        rest = {"oldest": kept.oldest, "newest": kept.newest, "asked": asked[:100]}
        return f"event: gap\ndata: {json.dumps(rest)}\n\n".encode()

    async def _catch_up(self) -> bytes:
        """Return the next page of the log; at its end, go over to what comes."""
        self._pending.clear()
        self._from_log = False  # collect from here on: what is committed after the read below is offered
        page = await self._hub.store.read(events.after, self._last, robot=self.robot, limit=PAGE)
        if len(page) == PAGE:
            self._from_log = True
        if page:
            self._last = page[-1].id
        return b"".join(encode(event, self.wanted.brief) for event in page if self.wanted.covers(event))


class EventStream(Response):
    """The answer to GET …/events. It ends with the client, with the service, or when the client stalls."""

    media_type = "text/event-stream"

    def __init__(self, hub: Hub, stream: Stream, send_timeout_s: float, still: Still) -> None:
        super().__init__(headers={"Cache-Control": "no-store", "X-Accel-Buffering": "no"})
        del self.headers["content-length"]
        self._hub, self._stream, self._send_timeout_s = hub, stream, send_timeout_s
        self._still = still

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        scope["robomend.waits"] = True
        gone = asyncio.ensure_future(left(receive))
        writing = asyncio.create_task(self._write(send))
        try:
            await asyncio.wait({gone, writing}, return_when=asyncio.FIRST_COMPLETED)
        finally:
            self._hub.forget(self._stream)
            for task in (gone, writing):
                task.cancel()
            for outcome in await asyncio.gather(gone, writing, return_exceptions=True):
                # A client that stalls (TimeoutError) or goes away is no fault of ours; everything else is.
                if isinstance(outcome, Exception) and not isinstance(outcome, OSError):
                    raise outcome

    async def _write(self, send: Send) -> None:
        await send({"type": "http.response.start", "status": 200, "headers": self.raw_headers})
        looked_s = time.monotonic()
        async for chunk in self._stream.frames():
            if time.monotonic() - looked_s > STILL_S:
                if not await self._still():
                    break
                looked_s = time.monotonic()
            async with asyncio.timeout(self._send_timeout_s):
                await send({"type": "http.response.body", "body": chunk, "more_body": True})
        await send({"type": "http.response.body", "body": b"", "more_body": False})
