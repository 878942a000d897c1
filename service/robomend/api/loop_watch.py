"""How long the event loop is held: by each request, and by whatever it is.

A request holds the loop from one `await` to the next; nothing else happens in that time. Each request's
longest hold goes into a histogram, in processor time, as a busy machine is no request's fault.

The loop gives a sign every 25 ms, by a timer of its own. How late it comes is what every request waits
before it begins. A thread looks seldom whether signs come, and wakes for none that is in time. Where one does
not come for a while, that is told in the log with the sign: how late it came, how much of that was processor
time, and where.

Where: the loop's thread looks at its own frames, in the handler of a signal that is only pretended (nothing
is interrupted) and comes as soon as the interpreter is between two instructions there. To look at them from
the other thread once broke the interpreter.
"""

from __future__ import annotations

import _thread
import asyncio
import signal
import threading
import time
from collections import deque
from collections.abc import Callable, Coroutine, Generator
from types import FrameType, coroutine
from typing import Any, TypeVar

import structlog

from robomend.end_sign import EndSign
from robomend.metrics import Metrics

T = TypeVar("T")

log = structlog.get_logger("robomend.loop")

EVERY_S = 0.025
"""Between two signs."""

HELD_S = 0.05
"""A hold that is told in the log."""

DELAYS = 40
"""Of the latest signs, kept: a second's."""

FROZEN_S = 10.0
"""Without a sign for so long, the process is of no use."""

LOOK = signal.SIGRTMAX
"""The signal that is pretended: one that nobody sends."""

FRAMES = 6
"""Of the place at which the loop was held, told."""


@coroutine
def timed(work: Coroutine[Any, Any, T], note: Callable[[float], None]) -> Generator[Any, Any, T]:
    """Run a coroutine; `note` is given the longest time of the processor that it took between two awaits."""
    call: Callable[[Any], Any] = work.send
    argument: Any = None
    longest = 0.0
    try:
        while True:
            began = time.thread_time()
            try:
                awaited = call(argument)
            except StopIteration as end:
                result: T = end.value
                return result
            finally:
                held_s = time.thread_time() - began
                if held_s > longest:
                    longest = held_s
            try:
                argument = yield awaited
                call = work.send
            except BaseException as error:  # noqa: BLE001  # what is thrown in goes where it was meant to
                call, argument = work.throw, error
    finally:
        note(longest)


class LoopWatch:
    """See the module: what the event loop says of itself, and the thread that looks at it from outside."""

    def __init__(self, metrics: Metrics, at_sign: Callable[[], None] = lambda: None) -> None:
        """`at_sign`: what is done by the way with each sign, which has the loop awake anyway."""
        self._metrics = metrics
        self._at_sign = at_sign
        self._watched_loop: asyncio.AbstractEventLoop | None = None
        self._ending = EndSign()
        self._due_s = time.monotonic()  # of the next sign
        self._used_s = 0.0  # processor time of the loop's thread, at the latest sign
        self._late_s: float | None = None  # when a sign was due that does not come
        self._where = ""
        self._timer: asyncio.TimerHandle | None = None
        self._delays: deque[float] = deque(maxlen=DELAYS)
        self._usual_s = 0.0  # their median
        self._worst_s = 0.0
        self._thread = threading.Thread(target=self._run, name="loop-watch", daemon=True)
        metrics.on_demand(
            "robomend_loop_delay_worst_seconds",
            "the longest that the event loop was held since the start",
            (),
            lambda: [((), max(self._worst_s, self.held_s))],
        )

    def start(self) -> None:
        """Watch the running event loop from now on; where it is held is known of the main thread's only."""
        self._watched_loop = asyncio.get_running_loop()
        if threading.current_thread() is threading.main_thread():
            signal.signal(LOOK, self._look)
        self._next_sign()
        self._thread.start()

    def close(self) -> None:
        """End the signs, and the thread; to be called by the event loop."""
        if self._timer is not None:
            self._timer.cancel()
        self._ending.set()
        if self._thread.is_alive():
            self._thread.join(1.0)

    @property
    def loop(self) -> asyncio.AbstractEventLoop:
        """The event loop that is watched: the service's own."""
        assert self._watched_loop is not None
        return self._watched_loop

    @property
    def held_s(self) -> float:
        """How long the loop has not given a sign; under EVERY_S means nothing."""
        return time.monotonic() - self._due_s + EVERY_S

    @property
    def frozen(self) -> bool:
        """Whether the loop has not turned for so long that nobody should wait for it."""
        return self.held_s > FROZEN_S

    @property
    def delay_s(self) -> float:
        """The delay of the signs lately (median of a second), or of the one that is awaited."""
        return max(self._usual_s, self.held_s - EVERY_S)

    def _next_sign(self) -> None:
        self._used_s = time.thread_time()
        self._due_s = time.monotonic() + EVERY_S
        self._timer = self.loop.call_later(EVERY_S, self._give_sign)

    def _give_sign(self) -> None:
        delay_s = max(0.0, time.monotonic() - self._due_s)
        self._note(delay_s)
        if self._late_s == self._due_s:
            used_s = time.thread_time() - self._used_s  # since the sign before, which was on time
            log.warning(
                "event loop held",
                ms=round(delay_s * 1000),
                processor_ms=round(min(delay_s, used_s) * 1000),
                where=self._where,
            )
        self._next_sign()
        self._at_sign()  # what it takes shows in how late the next sign is

    def _run(self) -> None:
        while not self._ending.wait(max(EVERY_S, self._due_s + HELD_S - time.monotonic())):
            due_s = self._due_s
            if due_s != self._late_s and time.monotonic() - due_s > HELD_S:
                self._where = ""
                self._late_s = due_s
                _thread.interrupt_main(LOOK)  # without our handler for it this does nothing

    def _note(self, delay_s: float) -> None:
        self._delays.append(delay_s)
        self._usual_s = sorted(self._delays)[len(self._delays) // 2]
        self._worst_s = max(self._worst_s, delay_s)
        self._metrics.loop_delay_s.observe(delay_s)

    def _look(self, _: int, frame: FrameType | None) -> None:
        """Note where the loop's thread is, innermost first, and which request it is about."""
        places: list[str] = []
        request = ""
        while frame is not None:
            if len(places) < FRAMES:
                code = frame.f_code
                module = frame.f_globals.get("__name__", "")
                places.append(f"{module}.{code.co_name}:{frame.f_lineno}")
            request = request or _request(frame)
            frame = frame.f_back
        self._where = " < ".join(places) + (f"; {request}" if request else "")


def _request(frame: FrameType) -> str:
    """Return the request that a frame of the edge is about."""
    if frame.f_globals.get("__name__") != "robomend.api.edge" or frame.f_code.co_name != "__call__":
        return ""
    scope = frame.f_locals.get("scope", {})
    return f"{scope.get('method', '')} {scope.get('path', '')}"
