"""The hardware observer (HObs): the board's measurements as literals. Pure: the time comes with the snapshot.

For a device m on a channel it says on(m) or not on(m), from the channel's state, and where the device's
steady current is configured, ok(current,m) or not ok(current,m). That is the paper's "the knowledge that a
particular component draws a certain amount of current", written as the language writes a property with an
argument, like ok(CPU,node). So the user's rules can range over it: `not ab(H) -> ok(current,H)`.

A current is judged only where a judgement means something: while the channel is on, `settle_s` after it was
seen to come on (inrush is not a fault), and only when the last `agreeing` readings say the same (a spike is
not a fault either). Until then the last judgement stays; there is none at first. When the board is silent
there is no literal at all, and every judgement starts anew after.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from robomend.board.codec import ChannelReading
from robomend.board.snapshot import Snapshot
from robomend_client.literals import Atom, Literal

SETTLE_S = 0.5
AGREEING = 3
TOLERANCE = 0.25  # of the expected current, where no tolerance is given
LEAST_TOLERANCE_A = 0.05  # below this the board's sensors say nothing


@dataclass(frozen=True, slots=True)
class Wiring:
    """Where a device hangs on the board, and what it draws when it works."""

    channel: int
    expected_current_a: float | None = None
    tolerance_a: float | None = None  # by default TOLERANCE of the expected current

    @property
    def band_a(self) -> float:
        """How far from the expected current a reading may be."""
        if self.tolerance_a is not None:
            return self.tolerance_a
        return max(TOLERANCE * (self.expected_current_a or 0.0), LEAST_TOLERANCE_A)


@dataclass(slots=True)
class _Judgement:
    """What is held of one device's current, and the readings that speak for or against it."""

    on_since_ns: int
    verdict: bool | None = None
    streak: bool | None = None
    readings: int = 0

    def add(self, within: bool, agreeing: int) -> None:
        self.readings = self.readings + 1 if within is self.streak else 1
        self.streak = within
        if self.readings >= agreeing:
            self.verdict = within


class HardwareObserver:
    """Turns one robot's snapshots into literals; feed it every snapshot in order."""

    def __init__(
        self, wiring: Mapping[str, Wiring], *, settle_s: float = SETTLE_S, agreeing: int = AGREEING
    ) -> None:
        self._wiring = dict(wiring)
        self._settle_ns = round(settle_s * 1e9)
        self._agreeing = agreeing
        self._judgements: dict[str, _Judgement] = {}

    def observe(self, snapshot: Snapshot) -> frozenset[Literal]:
        """Return everything that the snapshot says, not only what changed; nothing where the board is silent.

        A device on a channel that the board does not have gets no literal: nothing is known of it.
        """
        if snapshot.channels is None:
            self._judgements.clear()
            return frozenset()
        literals: set[Literal] = set()
        for name, wiring in self._wiring.items():
            if wiring.channel >= len(snapshot.channels):
                continue
            reading = snapshot.channels[wiring.channel]
            literals.add(Literal(Atom("on", (name,)), reading.on))
            verdict = self._judge(name, wiring, reading, snapshot.time_ns)
            if verdict is not None:
                literals.add(Literal(Atom("ok", ("current", name)), verdict))
        return frozenset(literals)

    def _judge(self, name: str, wiring: Wiring, reading: ChannelReading, now_ns: int) -> bool | None:
        if wiring.expected_current_a is None:
            return None
        if not reading.on:
            self._judgements.pop(name, None)
            return None
        judgement = self._judgements.setdefault(name, _Judgement(now_ns))
        if reading.current_a is None:  # the sensor fails: what was held is no longer known
            self._judgements[name] = _Judgement(judgement.on_since_ns)
            return None
        if now_ns - judgement.on_since_ns >= self._settle_ns:
            within = abs(reading.current_a - wiring.expected_current_a) <= wiring.band_a
            judgement.add(within, self._agreeing)
        return judgement.verdict
