"""The observers of one agent, live: where the driver meets the clock.

    feeders ──samples──► watch ──► driver ──changes──► reporter
                           ▲
                     each beat (beats.py)

The driver's time is the agent's clock (clock.py), so that what goes to the service needs no conversion. The
beat asks the observers that are due, and shows whether the agent itself was late: time in which it did not
run, or over which the computer's clock was set, is told to the driver as time that nobody looked at. It is
not taken for silence of the robot; and what came in meanwhile, all at once, is not taken for its rate.
"""

from __future__ import annotations

import asyncio
import logging
import time
from collections.abc import Callable, Collection, Iterable, Sequence
from operator import itemgetter
from pathlib import Path

from robomend_client.agent.feeds import Reads
from robomend_client.beats import BEAT_NS, MOST_LATE, Lateness
from robomend_client.clock import Clock
from robomend_client.literals import Atom
from robomend_client.observers import SECOND, Change, Contact, Driver, Observer, Verdict, ns
from robomend_client.observers.base import Listener
from robomend_client.observers.recording import Recording

log = logging.getLogger(__name__)

LATE_NS = ns(0.15)
"""The agent was late when it has not looked at the clock for this long; three beats."""

DRAIN_NS, LONGEST_DRAIN_NS = ns(0.02), ns(0.3)
"""After that, what waited in sockets is let in before anything is judged: a tenth of the time that it was."""


STARVED = (
    "this computer is overloaded (others want its processors, or this process may not use them): "
    "what comes late is unknown"
)


class Watch:
    """See the module."""

    def __init__(
        self,
        observers: Iterable[Observer],
        clock: Clock,
        on_changes: Callable[[Sequence[Change]], None],
        lenient: Collection[Atom] = (),
        recording: tuple[Path, int] | None = None,
        seen: Callable[[str, int, object], None] | None = None,
        listeners: Collection[Listener] = (),
        starved: float | None = MOST_LATE,
    ) -> None:
        """
        Args:
            starved: the part of the time, see beats.py; None: this computer never counts as starved.
            seen: told of each sample: source, time, value.
            listeners: of the driver.
            recording: a file and its bound in bytes; what the observers are fed with is written down there.

        Raises:
            OSError: the recording cannot be written.
        """
        self._clock = clock
        self._on_changes = on_changes
        self._readers: dict[Reads, frozenset[str]] = {}
        self._seen = seen
        self._gathered: list[tuple[int, str, object]] | None = None  # while they are read
        self._lateness = None if starved is None else Lateness(starved)
        self.starved_ns: int | None = None  # since when it is
        self.starved_changed = asyncio.Event()
        began, start_ns = time.monotonic_ns(), clock.now_ns()
        self._recording = Recording(recording[0], start_ns, recording[1]) if recording else None
        if self._recording is not None:
            listeners = [*listeners, self._recording]
        self.driver = Driver(observers, start_ns, lenient=lenient, listeners=listeners)
        self._looked = (start_ns, began)

    def read(self, reader: Reads, sources: Collection[str]) -> None:
        """Have a feed deliver what came by now before anything is judged; `sources` are what it feeds."""
        self._readers[reader] = frozenset(sources)

    def look(self, sources: Iterable[str], sight: Contact) -> None:
        """A feed has stopped looking at these sources, or looks at them again."""
        for source in sources:
            self.sample(source, sight)

    def sample(self, source: str, value: object = None, time_ns: int | None = None) -> None:
        """A feeder has something; `time_ns` is its own stamp, if it has one."""
        if self._gathered is not None:
            time_ns = self._look() if time_ns is None else time_ns
            self._gathered.append((time_ns, source, value))
            if self._seen is not None:
                self._seen(source, time_ns, value)
            return
        now_ns = self._look()
        if self.driver.next_ns is not None and now_ns >= self.driver.next_ns:
            self._read()
            now_ns = self._look()
        if self._seen is not None:
            self._seen(source, now_ns if time_ns is None else time_ns, value)
        self._tell(self.driver.sample(source, now_ns if time_ns is None else time_ns, value, now_ns))

    def settle(self, n: int, atoms: Collection[Atom]) -> None:
        """The service wants these atoms judged anew, from now on."""
        self._read()
        self._tell(self.driver.advance(self._look()))
        self._tell(self.driver.settle(n, atoms))

    def standing(self) -> list[Verdict]:
        """Return what holds now, with its present evidence."""
        self._read()
        self._tell(self.driver.advance(self._look()))
        return self.driver.standing()

    async def run(self) -> None:
        """Keep the beat, for ever."""
        while True:
            self._read()
            now_ns = self._look()
            self._tell(self.driver.advance(now_ns))
            beat_ns = (now_ns // BEAT_NS + 1) * BEAT_NS  # the observers' grid has many of its ticks there
            next_ns = min(beat_ns, self.driver.next_ns or beat_ns)
            wait_s, began_s = max(0, next_ns - now_ns) / SECOND, time.monotonic()
            await asyncio.sleep(wait_s)
            self._was_late(time.monotonic() - began_s - wait_s)

    def close(self) -> None:
        """End the recording."""
        if self._recording is not None:
            self._recording.close(self.driver.now_ns)

    def _read(self) -> None:
        """Take in what has come by now, in its order in time, before the ticks that were due since then."""
        if not self._readers:
            return
        gathered = self._gathered = []
        for reader, sources in tuple(self._readers.items()):
            try:
                reader.read_now()
            except Exception:  # a feed may be anybody's
                log.exception("the feed %s failed, and is not read any more", type(reader).__name__)
                del self._readers[reader]
                self.look(sources, Contact.LOST)
        self._gathered = None
        now_ns = self._look()
        gathered.sort(key=itemgetter(0))
        driver = self.driver
        for time_ns, source, value in gathered:
            changes = driver.sample(source, time_ns, value, min(max(time_ns, driver.now_ns), now_ns))
            if changes:
                self._on_changes(changes)

    def _was_late(self, late_s: float) -> None:
        """Tell the driver whether this computer is starved: then what others do is late as well."""
        if self._lateness is None:
            return
        starved = self._lateness.look(max(0.0, late_s))
        if starved is (self.starved_ns is None):
            log.info("%s", STARVED if starved else "this computer is overloaded no more")
            self._read()
            now_ns = self._look()
            self.starved_ns = now_ns if starved else None
            self.starved_changed.set()
            self._tell(self.driver.starved(starved, now_ns))

    def _look(self) -> int:
        """Return the time; tell the driver of time in which nobody looked."""
        began, now_ns = time.monotonic_ns(), self._clock.now_ns()
        before_ns, before = self._looked
        self._looked = (now_ns, began)
        if now_ns < before_ns - SECOND:  # it follows the computer's clock again
            log.warning("the clock went back by %.1f s: all is observed anew", (before_ns - now_ns) / SECOND)
            self._tell(self.driver.restart(now_ns))
        elif now_ns - before_ns > LATE_NS:
            at = time.monotonic_ns()  # it may have been held up between these
            ahead_ns = now_ns - before_ns - (at - before)
            if ahead_ns > LATE_NS:
                log.warning("the clock was set ahead by %.1f s", ahead_ns / SECOND)
            else:
                log.debug("nobody looked for %.2f s", (at - before) / SECOND)
            drain_ns = min(max((now_ns - before_ns) // 10, DRAIN_NS), LONGEST_DRAIN_NS)
            self._tell(self.driver.lapse(now_ns + drain_ns))
        return now_ns

    def _tell(self, changes: Sequence[Change]) -> None:
        if changes:
            self._on_changes(changes)
