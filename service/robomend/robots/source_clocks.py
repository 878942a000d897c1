"""The clocks of those who report: how far each is from the service's, and when what they say was, by ours.

The offset of a source is the least of (arrival − stamp) over its latest batches: what the fastest batch
needed on its way is all that it is wrong by. A batch that waited on a disk looks old, and is. As long as few
were heard, a stamp in the past is taken as it is: whether a clock is behind or a batch was late, one cannot
tell, and to take old evidence for young would be the worse mistake. A stamp ahead of us is a clock that is
ahead.
"""

from __future__ import annotations

from collections import OrderedDict, deque

LATEST = 16
"""Batches of a source that are looked at."""

ENOUGH = 4
"""Batches after which a clock that is behind is believed to be."""

SPREAD_NS = 250_000_000
"""… if so many of them needed the same time on their way, within this."""

MOST_SOURCES = 64


class SourceClocks:
    """The sources of one robot."""

    __slots__ = ("_delays",)

    def __init__(self) -> None:
        self._delays: OrderedDict[str, deque[int]] = OrderedDict()

    def offset_ns(self, source: str, time_ns: int, arrival_ns: int) -> int:
        """Take a batch's stamp and its arrival; return what brings the source's times to our clock."""
        delays = self._delays.get(source)
        if delays is None:
            delays = self._delays[source] = deque(maxlen=LATEST)
            while len(self._delays) > MOST_SOURCES:
                self._delays.popitem(last=False)
        delays.append(arrival_ns - time_ns)
        least = min(delays)
        if least > 0:
            alike = sorted(delays)[:ENOUGH]
            if len(alike) < ENOUGH or alike[-1] - least > SPREAD_NS:
                least = 0
        return least
