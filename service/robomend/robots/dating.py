"""What the observations of a batch rest on, by the service's clock.

A batch says it beside its observations (`since`, `onset`), by the clock of its source. Where it does not, the
batch's time counts less what an observer usually needs from a change to its verdict; but what is read off
(on, running) is as young as the reading, and good news that follows bad rests on what came after the bad.
"""

from __future__ import annotations

from collections import OrderedDict, deque
from collections.abc import Callable, Sequence
from typing import NamedTuple

import structlog

from robomend.entry import Entry
from robomend.errors import InputError
from robomend.observations.obs import Obs
from robomend.observations.pending import GUARD_NS
from robomend.planning.prediction import OBSERVED_FACTS
from robomend_client.literals import Literal

# --- the clocks of those who report: how far each is from the service's, and when what they say was, by ours.
#
# The offset of a source is the least of (arrival − stamp) over its latest batches: what the fastest batch
# needed on its way is all that it is wrong by. A batch that waited on a disk looks old, and is. As long as
# few were heard, a stamp in the past is taken as it is: whether a clock is behind or a batch was late, one
# cannot tell, and to take old evidence for young would be the worse mistake. A stamp ahead of us is a clock
# that is ahead; it is right again once ENOUGH batches in a row have come as fast as if it were.
#
# Where a source is far behind us, the times of its batches are brought to our clock, as OBS is ordered by
# them. So it is too, and at once, where our own clock is ahead of the computer's: it was set back, and goes
# on from where it was (robomend_client.clock), so that correct stamps would count as old. Jumps are logged.

log = structlog.get_logger("robomend.robots.dating")

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

LATE_NS = 30 * 10**9
"""What is silent for longer beyond its lifetime is not a bit late, however long it may live."""

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

    def late_until_ns(self, entry: Entry) -> int:
        """Return until when who said this may only be late with saying it again: for one more lifetime.

        0: it has no lifetime.
        """
        if entry.expires_ns is None:
            return 0
        lives_ns = entry.expires_ns - entry.time_ns - self.lives_on_ns(entry.source)
        return entry.expires_ns + min(max(0, lives_ns), LATE_NS)

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


TIMES, WITHIN_NS = 3, 60 * 10**9
"""So often in so long a source contradicts itself, until it is taken for two of one name."""

RestsOn = Callable[[Literal, int], tuple[int, int | None]]
"""A literal and the position of its sentence -> since and onset."""


class Twins:
    """Sources of a robot that contradict themselves: as a rule two agents of one name.

    An observer that changes its mind has evidence from after what it said before. Who says the opposite by
    evidence from before that, again and again, is somebody else.
    """

    __slots__ = ("_heard",)

    def __init__(self) -> None:
        self._heard: OrderedDict[str, deque[int]] = OrderedDict()

    def heard(self, source: str, at_ns: int) -> None:
        """A source contradicted itself."""
        times = self._heard.setdefault(source, deque(maxlen=TIMES))
        times.append(at_ns)
        self._heard.move_to_end(source)
        while len(self._heard) > MOST_SOURCES:
            self._heard.popitem(last=False)

    def names(self, now_ns: int) -> list[str]:
        """Return the sources that are two, as it seems."""
        return sorted(
            source
            for source, times in self._heard.items()
            if len(times) == TIMES and times[0] > now_ns - WITHIN_NS
        )


class Dating(NamedTuple):
    """What is needed of a robot to date its observations."""

    obs: Obs  # looked at, not changed
    clocks: SourceClocks  # they learn from the stamps
    usual_ns: int  # what an observer needs that does not say so
    twins: Twins | None = None  # told of what contradicts what its source said

    def of(
        self,
        source: str,
        time_ns: int,
        arrival_ns: int,
        observations: int,
        since: Sequence[int | None],
        onset: Sequence[int | None],
    ) -> RestsOn:
        """Return how the observations of one batch are dated.

        Raises:
            InputError: there are not as many values as observations, or one is after the batch.
        """
        for name, values in (("since", since), ("onset", onset)):
            if not values:
                continue
            check_parallel(name, values, observations)
            late = next((n for n, value in enumerate(values) if value is not None and value > time_ns), None)
            if late is not None:
                raise InputError(
                    f"{name}[{late}]: {values[late]} is after the time of the batch, {time_ns}: what a "
                    "verdict rests on was there before it was said"
                )
        offset_ns = self.clocks.offset_ns(source, time_ns, arrival_ns)

        def rests_on(literal: Literal, position: int) -> tuple[int, int | None]:
            since_ns = since[position] if since else None
            onset_ns = onset[position] if onset else None
            held = self.obs.word(literal.atom, source)
            same = held is not None and held.literal == literal
            fact = literal.atom.predicate in OBSERVED_FACTS
            turns = since_ns is not None and held is not None and not same and held.source == source
            if since_ns is None:
                turned = literal.positive and held is not None and not same
                since_ns = time_ns if turned or fact else time_ns - self.usual_ns
            since_ns += offset_ns
            if onset_ns is not None:
                onset_ns += offset_ns
            if turns and self.twins is not None and held is not None and held.since_ns is not None:
                began_ns = since_ns if onset_ns is None else onset_ns
                if began_ns < held.since_ns - GUARD_NS and time_ns + offset_ns > held.time_ns:
                    self.twins.heard(source, arrival_ns)
            if onset_ns is not None:
                return since_ns, onset_ns
            # It goes on: `since` moves with it, the onset stays. What is well only while somebody looked.
            if held is not None and same and (held.fresh(arrival_ns) or not literal.positive):
                return since_ns, held.onset_ns or held.since_ns
            return since_ns, since_ns if fact else None

        return rests_on


def check_parallel(name: str, values: Sequence[object], observations: int) -> None:
    """Refuse a list of a batch that does not run parallel to its observations. InputError."""
    if values and len(values) != observations:
        raise InputError(
            f"{name}: {len(values)} values for {observations} observations; give one for each, null where "
            "there is none"
        )
