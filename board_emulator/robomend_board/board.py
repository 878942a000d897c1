"""The board itself: relays, sensors, loads and their faults. Pure: every method is told the time.

                 ┌── relay 0 ── load 0        the supply sags with the total current;
    supply ── R ─┼── relay 1 ── load 1        a load draws inrush, then its steady current, with noise;
                 └── …                        a channel above its limit for TRIP_S trips: its relay opens

The reported state of a channel is where its relay *is*, as sensed at the contact, not where it was sent:
that is how a stuck relay shows. A device is `powered` when its relay is closed, its cable whole and its
voltage sufficient; what it draws shows only in the current. Times are seconds of any clock that does not
run backwards.
"""

from __future__ import annotations

import math
import random
from collections.abc import Iterable
from dataclasses import dataclass

from robomend.board.codec import ChannelLimits, ChannelReading, Code, Measurements, Specification
from robomend_board.faults import Fault
from robomend_board.loads import SHORT_OHM, Load, Rig

TRIP_S = 0.05  # how long a channel bears more than its limit
VOLTAGE_NOISE_V = 0.01


@dataclass(slots=True)
class Channel:
    """One relay with its load."""

    load: Load
    closed: bool = False
    closed_at_s: float = -math.inf
    stuck: bool = False
    open: bool = False
    short: bool = False
    short_at_s: float = 0.0

    def trips_at_s(self) -> float:
        """Return when over-current opens the relay; inf if it does not."""
        if not self.closed or self.stuck:  # a welded contact does not trip
            return math.inf
        if self.short:
            return max(self.closed_at_s, self.short_at_s) + TRIP_S
        if self.open or self.load.overload_s() <= TRIP_S:
            return math.inf
        return self.closed_at_s + TRIP_S

    def move(self, closed: bool, now_s: float) -> None:
        if closed and not self.closed:
            self.closed_at_s = now_s
        self.closed = closed


@dataclass(frozen=True, slots=True)
class ChannelState:
    """What a device on the channel would notice."""

    on: bool  # the relay, as the board reports it
    powered: bool  # the device gets what it needs


class Board:
    """N channels on one supply."""

    def __init__(self, rig: Rig, on: Iterable[int] = (), seed: int = 0) -> None:
        """Power up with the relays in `on` closed, long enough ago for inrush to be over."""
        self._supply = rig.supply
        self._volts = rig.supply.voltage_v
        self._random = random.Random(seed)
        closed = frozenset(on)
        self.channels = tuple(Channel(load, number in closed) for number, load in enumerate(rig.loads))

    # --- what clients see ------------------------------------------------------------------------------

    def specification(self) -> Specification:
        return Specification(
            tuple(ChannelLimits(c.load.max_current_a, c.load.max_voltage_v) for c in self.channels)
        )

    def switch(self, number: int, state: int, now_s: float) -> Code:
        """Carry out a command; return the code of its acknowledge. Switching to where it is already is ok."""
        self.advance(now_s)
        if not 0 <= number < len(self.channels):
            return Code.UNKNOWN_CHANNEL
        if state not in (0, 1):
            return Code.BAD_VALUE
        channel = self.channels[number]
        if channel.closed == bool(state):
            return Code.OK
        if channel.stuck or (state and channel.short):  # the soft start notices the short
            return Code.CHANNEL_FAULTY
        channel.move(bool(state), now_s)
        return Code.OK

    def measure(self, now_s: float) -> Measurements:
        """Read every channel's sensors; the noise is drawn from the board's seed."""
        self.advance(now_s)
        nominal = [self._current_a(c, now_s) for c in self.channels]
        volts = self._loaded_v(sum(nominal))
        readings = []
        for channel, current_a in zip(self.channels, nominal, strict=True):
            current_a, voltage_v = (current_a, volts) if channel.closed else (0.0, 0.0)
            if current_a:
                current_a = max(current_a + self._random.gauss(0.0, channel.load.noise_a), 0.0)
            if voltage_v:
                voltage_v = max(voltage_v + self._random.gauss(0.0, VOLTAGE_NOISE_V), 0.0)
            readings.append(ChannelReading(channel.closed, current_a, voltage_v))
        return Measurements(tuple(readings))

    # --- what happens to it ----------------------------------------------------------------------------

    def advance(self, now_s: float) -> None:
        """Let time pass: channels that bore too much for too long trip."""
        for channel in self.channels:
            if channel.trips_at_s() <= now_s:
                channel.move(False, now_s)

    def next_trip_s(self) -> float | None:
        """Return when a channel will trip if nothing changes before."""
        return min((at for c in self.channels if (at := c.trips_at_s()) < math.inf), default=None)

    def set_fault(self, fault: Fault, now_s: float) -> None:
        """Apply a fault of a channel or of the supply."""
        self.advance(now_s)
        if fault.name == "brown-out":
            self._volts = fault.parameters["volts"]
        if fault.channel is None:
            return
        channel = self.channels[fault.channel]
        match fault.name:
            case "stuck":
                if fault.at is not None:
                    channel.move(fault.at, now_s)
                channel.stuck = True
            case "open":
                channel.open = True
            case "short":
                channel.short, channel.short_at_s = True, now_s

    def clear_fault(self, name: str, number: int | None, now_s: float) -> None:
        """Take a fault away; without a number, from every channel. What tripped stays off."""
        self.advance(now_s)
        if name == "brown-out":
            self._volts = self._supply.voltage_v
        for channel in self.channels if number is None else (self.channels[number],):
            match name:
                case "stuck":
                    channel.stuck = False
                case "open":
                    channel.open = False
                case "short":
                    channel.short = False

    # --- what is so ------------------------------------------------------------------------------------

    def relays(self) -> tuple[bool, ...]:
        """Return which relays are closed: what a board keeps when its own power goes."""
        return tuple(channel.closed for channel in self.channels)

    def states(self, now_s: float) -> tuple[ChannelState, ...]:
        """Return what the devices notice now, without drawing noise."""
        self.advance(now_s)
        volts = self._loaded_v(sum(self._current_a(c, now_s) for c in self.channels))
        return tuple(
            ChannelState(c.closed, c.closed and not c.open and not c.short and volts >= c.load.min_voltage_v)
            for c in self.channels
        )

    def faults(self) -> list[dict[str, object]]:
        """Return the faults of channels and supply, as they are asked for."""
        found: list[dict[str, object]] = []
        for number, channel in enumerate(self.channels):
            if channel.stuck:
                at = "on" if channel.closed else "off"
                found.append({"fault": "stuck", "channel": number, "at": at})
            if channel.open:
                found.append({"fault": "open", "channel": number})
            if channel.short:
                found.append({"fault": "short", "channel": number})
        if self._volts != self._supply.voltage_v:
            found.append({"fault": "brown-out", "volts": self._volts})
        return found

    def _current_a(self, channel: Channel, now_s: float) -> float:
        if not channel.closed or channel.open:
            return 0.0
        if channel.short:
            return self._volts / SHORT_OHM
        if self._volts < channel.load.min_voltage_v:
            return 0.0
        # Converters draw constant power: less voltage, more current.
        power_ratio = self._supply.voltage_v / self._volts if self._volts else 0.0
        return channel.load.current_a(now_s - channel.closed_at_s) * power_ratio

    def _loaded_v(self, total_a: float) -> float:
        return max(self._volts - self._supply.resistance_ohm * total_a, 0.0)
