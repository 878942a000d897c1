"""What the observations of a batch rest on, by the service's clock.

A batch says it beside its observations (`since`, `onset`), by the clock of its source. Where it does not, the
batch's time counts less what an observer usually needs from a change to its verdict; but what is read off
(on, running) is as young as the reading, and good news that follows bad rests on what came after the bad.
"""

from __future__ import annotations

from collections import OrderedDict, deque
from collections.abc import Callable, Sequence
from typing import NamedTuple

from robomend.errors import InputError
from robomend.observations.obs import Obs
from robomend.observations.unconfirmed import GUARD_NS
from robomend.planning.prediction import OBSERVED_FACTS
from robomend.robots.source_clocks import MOST_SOURCES, SourceClocks
from robomend_client.literals import Literal

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
            if held is not None and same:  # it goes on: `since` moves with it, the onset stays
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
