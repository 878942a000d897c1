"""The clocks of those who report: how far each is from the service's, and when what they say was, by ours.

The offset of a source is the least of (arrival − stamp) over its latest batches: what the fastest batch
needed on its way is all that it is wrong by. A batch that waited on a disk looks old, and is. As long as few
were heard, a stamp in the past is taken as it is: whether a clock is behind or a batch was late, one cannot
tell, and to take old evidence for young would be the worse mistake. A stamp ahead of us is a clock that is
ahead; it is right again once ENOUGH batches in a row have come as fast as if it were.

Where a source is far behind us, the times of its batches are brought to our clock, as OBS is ordered by them.
So it is too, and at once, where our own clock is ahead of the computer's: it was set back, and goes on from
where it was (robomend_client.clock), so that correct stamps would count as old. Jumps are told in the log.
"""

from __future__ import annotations

from collections import OrderedDict, deque

import structlog

log = structlog.get_logger("robomend.robots.source_clocks")

LATEST = 16
"""Batches of a source that are looked at."""

ENOUGH = 4
"""Batches after which a clock that is behind is believed to be."""

SPREAD_NS = 250_000_000
"""… if so many of them needed the same time on their way, within this."""

RIGHT_NS = 10**9
"""Within this of the time of its arrival, a batch may be stamped by a clock that is right."""

FAR_NS = 60 * 10**9
"""So far apart, clocks are no longer taken for equal where observations are ordered."""

MOST_SOURCES = 64


class SourceClocks:
    """The sources of one robot."""

    __slots__ = ("_behind", "_delays", "_offsets", "_robot")

    def __init__(self, robot: str = "") -> None:
        self._robot = robot
        self._delays: OrderedDict[str, deque[int]] = OrderedDict()
        self._behind: dict[str, int] = {}  # sources that are far behind
        self._offsets: dict[str, int] = {}  # of each, as it was found last

    def offset_ns(self, source: str, time_ns: int, arrival_ns: int) -> int:
        """Take a batch's stamp and its arrival; return what brings the source's times to our clock."""
        delays = self._delays.get(source)
        if delays is None:
            delays = self._delays[source] = deque(maxlen=LATEST)
            while len(self._delays) > MOST_SOURCES:
                oldest, _ = self._delays.popitem(last=False)
                self._behind.pop(oldest, None)
                self._offsets.pop(oldest, None)
        delays.append(arrival_ns - time_ns)
        least = min(delays)
        if least < -RIGHT_NS and len(delays) > ENOUGH:
            latest = [*delays][-ENOUGH:]
            if min(latest) >= 0 and max(latest) <= RIGHT_NS:
                delays.clear()
                delays.extend(latest)
                least = min(latest)
        if least > 0:
            alike = sorted(delays)[:ENOUGH]
            if len(alike) < ENOUGH or alike[-1] - least > SPREAD_NS:
                least = 0
        behind_ns = least if least > FAR_NS else 0
        if behind_ns or source in self._behind:
            self._note(source, behind_ns)
        self._offsets[source] = least
        return least

    def sources(self) -> frozenset[str]:
        """Return whose clocks are followed."""
        return frozenset(self._delays)

    def spread_ns(self) -> int | None:
        """Return by how much the latest batches of any source differed in how long they were on their way.

        None: of one of them too few were heard.
        """
        if not self._delays or any(len(delays) < ENOUGH for delays in self._delays.values()):
            return None
        return max(max(delays) - min(delays) for delays in self._delays.values())

    def lives_on_ns(self, source: str) -> int:
        """Return what is added to the end of what a source says, so that its lifetime is one by our clock.

        Else what comes from a clock that is behind by more than it is dead on arrival, and what comes from
        one that is ahead outlives its source. Where times are brought to our clock, it is in there already.
        """
        return self._offsets.get(source, 0) - self.behind_ns(source)

    def behind_ns(self, source: str) -> int:
        """Return how far a source is behind our clock; 0 where it is not far."""
        return self._behind.get(source, 0)

    def _note(self, source: str, behind_ns: int) -> None:
        before = self._behind.get(source, 0)
        if abs(behind_ns - before) > FAR_NS:
            seconds = round(behind_ns / 1e9)
            log.warning("clock jumped", robot=self._robot, source=source, behind_s=seconds)
        if behind_ns:
            self._behind[source] = behind_ns
        elif before:
            del self._behind[source]
