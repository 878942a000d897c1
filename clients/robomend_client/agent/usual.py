"""What is usual of a topic: how it came while all was well, for bounds tighter than a first minute allows.

    samples ──► of 10 s ──► held back for as long ──► STATE_DIR/usual.json ──► robomend attach
                  └──────────────┴── dropped: it was bad, the computer was starved, or nobody looked

What ends in a fault is not usual, nor is what came just before. A file that an agent finds goes on.
"""

from __future__ import annotations

import asyncio
import json
import logging
from collections import deque
from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass
from pathlib import Path

from robomend_client.observers import SECOND, Change, Contact, GeneralObserver, ns
from robomend_client.observers.base import Listener
from robomend_client.ros_graph import UsualRate

log = logging.getLogger(__name__)

FILE = "usual.json"
BLOCK_NS = 10 * SECOND
WRITE_S = 60.0
MOST_BYTES = 1 << 22


@dataclass
class _Stretch:
    """A while in which all was well."""

    count: int = 0
    began_ns: int = 0
    ended_ns: int = 0
    longest_ns: int = 0
    shortest_span_ns: int = 0  # of a window of messages; 0: there was none
    longest_span_ns: int = 0


class _Topic:
    """One topic."""

    def __init__(self, observer: GeneralObserver, known: UsualRate | None) -> None:
        expected = observer.expected
        self.window = expected.messages
        self._pause_ns = None if expected.pause_s is None else ns(expected.pause_s)
        same = known is not None and known.window == self.window
        self.usual = known if known is not None and same else UsualRate(self.window)
        self.well = False
        self._counted: deque[int] = deque(maxlen=self.window)  # times, of which a pause is as long at most
        self.drop()

    def drop(self) -> None:
        """What was not yet taken was not usual; what comes next follows nothing."""
        self._counted.clear()
        self._last_ns: int | None = None
        self._held: _Stretch | None = None
        self._stretch: _Stretch | None = None

    def message(self, time_ns: int) -> None:
        """A message came."""
        stretch, last_ns, counted = self._stretch, self._last_ns, self._counted
        self._last_ns = time_ns
        if stretch is None or last_ns is None or time_ns < last_ns:
            counted.clear()
            counted.append(0)
            self._stretch = _Stretch(began_ns=time_ns, ended_ns=time_ns)
            return
        gap_ns = time_ns - last_ns
        stretch.count += 1
        stretch.ended_ns = time_ns
        stretch.longest_ns = max(stretch.longest_ns, gap_ns)
        counted.append(counted[-1] + (gap_ns if self._pause_ns is None else min(gap_ns, self._pause_ns)))
        if len(counted) == self.window:
            span_ns = counted[-1] - counted[0]
            stretch.longest_span_ns = max(stretch.longest_span_ns, span_ns)
            stretch.shortest_span_ns = min(stretch.shortest_span_ns or span_ns, span_ns)
        if time_ns - stretch.began_ns >= BLOCK_NS:
            if self._held is not None:
                self._take(self._held)
            self._held = stretch
            self._stretch = _Stretch(began_ns=time_ns, ended_ns=time_ns)

    def _take(self, stretch: _Stretch) -> None:
        old, intervals = self.usual, (self.window - 1) * SECOND
        slowest_hz, fastest_hz = old.slowest_hz, old.fastest_hz
        if stretch.longest_span_ns:
            slowest = intervals / stretch.longest_span_ns
            slowest_hz = min(slowest_hz or slowest, slowest)
            fastest_hz = max(fastest_hz, intervals / max(1, stretch.shortest_span_ns))
        self.usual = UsualRate(
            self.window,
            old.count + stretch.count,
            old.seconds + (stretch.ended_ns - stretch.began_ns) / SECOND,
            max(old.longest_s, stretch.longest_ns / SECOND),
            slowest_hz,
            fastest_hz,
        )


class Usual(Listener):
    """What a driver's topics do while they are well. Told of the driver's changes, too."""

    def __init__(self, folder: Path, observers: Iterable[object]) -> None:
        self._file = folder / FILE
        known = read_usual(self._file)
        self._topics = {
            one.topic: _Topic(one, known.get(one.topic))
            for one in observers
            if isinstance(one, GeneralObserver)
        }
        self._written: dict[str, UsualRate] = known

    def sample(self, source: str, time_ns: int, value: object, now_ns: int) -> None:
        one = self._topics.get(source)
        if one is not None and one.well:
            one.message(time_ns)

    def lapse(self, now_ns: int, until_ns: int) -> None:
        self._drop()

    def starved(self, now_ns: int, yes: bool) -> None:
        self._drop()

    def restart(self, now_ns: int) -> None:
        self._drop()

    def sight(self, now_ns: int, source: str, sight: Contact) -> None:
        if source in self._topics:
            self._topics[source].drop()

    def changed(self, changes: Iterable[Change]) -> None:
        """The observers have found this."""
        for change in changes:
            if change.atom.predicate != "ok" or len(change.atom.args) != 1:
                continue
            one = self._topics.get(change.atom.args[0])
            if one is not None:
                one.well = change.value is not None and change.value.positive
                one.drop()

    async def run(self) -> None:
        """Write it down now and then, for ever."""
        while True:
            await asyncio.sleep(WRITE_S)
            self.write()

    def write(self) -> None:
        """Write it down, if there is anything new."""
        usual = {topic: one.usual for topic, one in self._topics.items() if one.usual.count}
        if usual == self._written:
            return
        new = self._file.with_suffix(".new")
        try:
            new.write_text(json.dumps({topic: asdict(one) for topic, one in usual.items()}), "utf-8")
            new.replace(self._file)
        except OSError as error:
            log.warning("what is usual cannot be written down: %s", error)
        else:
            self._written = usual

    def _drop(self) -> None:
        for one in self._topics.values():
            one.drop()


def read_usual(file: Path) -> dict[str, UsualRate]:
    """Return what an agent has written down, by topics; of a file that cannot be read, nothing."""
    try:
        text = file.read_text("utf-8") if file.stat().st_size <= MOST_BYTES else ""
        found: Mapping[str, Mapping[str, float]] = json.loads(text)
        return {topic: UsualRate(**keys) for topic, keys in found.items()}  # type: ignore[arg-type]  # as written
    except FileNotFoundError:
        return {}
    except (OSError, ValueError, TypeError, AttributeError) as error:
        log.warning("%s is not read: %s", file, error)
        return {}
