"""The hardware observer (HObs): the power board's measurements as literals.

For a device m on a channel it says on(m) or not on(m), from the channel's state, and where the device's
steady current is configured, ok(current,m) or not ok(current,m). That is the paper's "the knowledge that a
particular component draws a certain amount of current", written as the language writes a property with an
argument, like ok(CPU,node). So the user's rules can range over it: `not ab(H) -> ok(current,H)`.

A current is judged only where a judgement means something: while the channel is on, `settle_s` after it was
seen to come on (inrush is not a fault), and only when the last `agreeing` readings say the same (a spike is
not a fault either). Until then the last judgement stays; there is none at first. When the board is silent
(a sample None, or none for `lifetime_s`) there is no literal at all, and every judgement starts anew after.

A sample is the list of the board's channels: objects with `on` and `current_a`, mappings with these keys,
or pairs.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from robomend_client.literals import Atom, Literal
from robomend_client.observers.base import NOTHING, Evidence, WrongKind, finite, ns, positive
from robomend_client.observers.reading import Judgement
from robomend_client.readings import Reading, Symptom

BOARD = "board"
"""The source whose samples are the board's channels."""

TOLERANCE = 0.25  # of the expected current, where no tolerance is given
LEAST_TOLERANCE_A = 0.05  # below this the board's sensors say nothing


@dataclass(frozen=True, slots=True)
class Wiring:
    """Where a device hangs on the board, and what it draws when it works.

    Attributes:
        channel: the device's channel of the power board.
        expected_current_a: what it draws when it works, in amperes; without it no current is judged.
        tolerance_a: how far its current may be from that, in amperes; by default a quarter, 0.05 at least.
    """

    channel: int
    expected_current_a: float | None = None
    tolerance_a: float | None = None

    @property
    def band_a(self) -> float:
        """How far from the expected current a reading may be."""
        if self.tolerance_a is not None:
            return self.tolerance_a
        return max(TOLERANCE * (self.expected_current_a or 0.0), LEAST_TOLERANCE_A)


@dataclass(frozen=True)
class BoardReadings:
    """How measurements are judged.

    Attributes:
        settle_s: for so many seconds after its channel came on, a device's current is not judged.
        agreeing: measurements in a row that say the same, for a verdict on a current.
        lifetime_s: measurements that are older than so many seconds say nothing.
        rate_hz: how often the board speaks, in readings per second; only for the delays that are declared.
    """

    settle_s: float = 0.5
    agreeing: int = 3
    lifetime_s: float = 3.0
    rate_hz: float = 5.0

    def __post_init__(self) -> None:
        positive(lifetime_s=self.lifetime_s, rate_hz=self.rate_hz)
        if not 0 <= self.settle_s <= 3600:
            raise ValueError(f"settle_s must be from 0 to 3600, not {self.settle_s:g}")
        if not 1 <= self.agreeing <= 1000:
            raise ValueError(f"agreeing must be from 1 to 1000, not {self.agreeing}")


class HardwareObserver:
    """Turns one board's measurements into literals; feed it every one, in order."""

    def __init__(
        self, wiring: Mapping[str, Wiring], expected: BoardReadings | None = None, source: str = BOARD
    ) -> None:
        """
        Args:
            wiring: device → its channel, and what it draws.
            expected: of the measurements.
            source: where the measurements come from.
        """
        expected = expected or BoardReadings()
        self.sources = frozenset((source,))
        self.period_ns = 0
        self._devices = [_Device(name, where, expected.agreeing) for name, where in wiring.items()]
        self.atoms = tuple(atom for device in self._devices for atom in device.atoms)
        self.detection_s = expected.agreeing / expected.rate_hz
        judged = any(device.judged for device in self._devices)
        # The first measurement shows that the channel is on, and from then on it settles.
        first_s = 1 / expected.rate_hz
        self.settling_s = first_s + (self.detection_s + expected.settle_s + first_s if judged else 0.0)
        self._settle_ns = ns(expected.settle_s)
        self._lifetime_ns = ns(expected.lifetime_s)
        self.reset(0)

    def reset(self, time_ns: int) -> None:
        self._measured_ns: int | None = None
        self._said = NOTHING
        for device in self._devices:
            device.reset()

    def feed(self, source: str, time_ns: int, value: object) -> None:
        """Take in all channels, or None: nothing is known of the board.

        A device on a channel that the board does not have gets no literal: nothing is known of it.
        """
        if value is None:
            self.reset(time_ns)
            return
        if not isinstance(value, Sequence) or isinstance(value, str | bytes):
            raise WrongKind("a list of channels is", value)
        if self._measured_ns is not None and time_ns - self._measured_ns >= self._lifetime_ns:
            self.reset(time_ns)
        self._measured_ns = time_ns
        said: list[Literal] = []
        for device in self._devices:
            if device.channel < len(value):
                on, current_a = _reading(value[device.channel])
                said += device.measured(time_ns, on, current_a, self._settle_ns)
        now = tuple(said)
        if now != self._said:
            self._said = now

    def due_ns(self) -> int | None:
        return None if self._measured_ns is None else self._measured_ns + self._lifetime_ns

    def check(self, now_ns: int) -> tuple[Literal, ...]:
        due_ns = self.due_ns()
        return NOTHING if due_ns is None or now_ns >= due_ns else self._said

    def evidence(self, atom: Atom, now_ns: int) -> Evidence:
        assert self._measured_ns is not None
        device = next(device for device in self._devices if atom in device.atoms)
        if atom.predicate == "on":
            state = Reading("on" if device.on else "off")
            return Evidence(self._measured_ns, None if device.on else device.was_on_ns, state)
        return device.current.evidence._replace(reading=device.reading)


class _Device:
    """What is held of one device."""

    def __init__(self, name: str, wiring: Wiring, agreeing: int) -> None:
        self.channel = wiring.channel
        self.judged = wiring.expected_current_a is not None
        self.atoms = (Atom("on", (name,)), *([Atom("ok", ("current", name))] if self.judged else []))
        self._expected_a = wiring.expected_current_a or 0.0
        self._band_a = wiring.band_a
        self.current = Judgement(agreeing)
        self.reset()

    def reset(self) -> None:
        self.on: bool | None = None
        self.was_on_ns: int | None = None
        self._on_since_ns = 0
        self.current.reset()

    def measured(
        self, time_ns: int, on: bool, current_a: float | None, settle_ns: int
    ) -> tuple[Literal, ...]:
        """Return what a measurement says, with those before it."""
        if on and not self.on:
            self._on_since_ns = time_ns
        if not on or current_a is None:  # without power, or with a sensor that fails, nothing is known of it
            self.current.reset()
        elif self.judged and time_ns - self._on_since_ns >= settle_ns:
            good = abs(current_a - self._expected_a) <= self._band_a
            self.current.add(time_ns, good, read=current_a)
        self.on = on
        if on:
            self.was_on_ns = time_ns
        verdict = self.current.at(time_ns)
        switched = Literal(self.atoms[0], on)
        return (switched,) if verdict is None else (switched, Literal(self.atoms[1], verdict))

    @property
    def reading(self) -> Reading | None:
        """The current that the verdict rests on."""
        read = self.current.read
        if not isinstance(read, float):
            return None
        limit = f"{self._expected_a:g} ± {self._band_a:g}"
        return Reading(read, "A", limit, Symptom.VALUE if self.current.bad else None)


def _reading(channel: Any) -> tuple[bool, float | None]:
    """Return state and current of one channel."""
    if isinstance(channel, Mapping):
        on, current_a = channel["on"], channel.get("current_a")
    elif isinstance(channel, Sequence):
        on, current_a = channel[0], channel[1]
    else:
        on, current_a = channel.on, channel.current_a
    return bool(on), finite(current_a)
