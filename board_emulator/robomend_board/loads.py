"""What hangs on the channels, and what feeds them: read from a file, or a plausible rescue robot.

    supply: {voltage_v: 24, resistance_ohm: 0.03}
    channels:
      7: {name: jaguar, steady_a: 3.0, inrush_a: 9.0, inrush_s: 0.12, noise_a: 0.05}

Channels that the file leaves out have nothing connected.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any, TypeVar

import yaml

NOMINAL_V = 24.0
SHORT_OHM = 0.4  # of a shorted device and its cable: 60 A at 24 V


class LoadsError(ValueError):
    """A file of loads at fault; the message names the file and the place in it."""


@dataclass(frozen=True, slots=True)
class Load:
    """One channel's device and limits. The current after switching on decays from inrush_a to steady_a."""

    name: str = ""
    steady_a: float = 0.0
    inrush_a: float = 0.0  # at the moment of switching on; not below steady_a
    inrush_s: float = 0.05  # time constant of the decay
    noise_a: float = 0.0  # standard deviation
    min_voltage_v: float = 18.0  # below this the device does not work
    max_current_a: float = 10.0  # the channel's limit: above it, it trips
    max_voltage_v: float = NOMINAL_V

    def current_a(self, since_on_s: float) -> float:
        """Return the current, without noise, at nominal voltage."""
        surge = max(self.inrush_a - self.steady_a, 0.0)
        return self.steady_a + surge * math.exp(-since_on_s / self.inrush_s)

    def overload_s(self) -> float:
        """Return how long after switching on the current stays above the channel's limit; inf if for good."""
        if self.steady_a > self.max_current_a:
            return math.inf
        if self.inrush_a <= self.max_current_a:
            return 0.0
        if self.steady_a == self.max_current_a:
            return math.inf  # it decays to the limit, never below
        surge = self.inrush_a - self.steady_a
        return self.inrush_s * math.log(surge / (self.max_current_a - self.steady_a))


@dataclass(frozen=True, slots=True)
class Supply:
    """A battery or power supply with an inner resistance: the voltage sags with the total current."""

    voltage_v: float = NOMINAL_V
    resistance_ohm: float = 0.03


@dataclass(frozen=True, slots=True)
class Rig:
    """All of it: the supply, and one load a channel."""

    supply: Supply
    loads: tuple[Load, ...]


RESCUE_ROBOT = (
    Load("sensor_head", 1.2, 3.0, 0.08, 0.03),
    Load("laser_alignment", 0.6, 1.8, 0.06, 0.02),
    Load("pc", 2.5, 6.0, 0.15, 0.10),
    Load("hokuyo", 0.4, 0.9, 0.05, 0.01),
    Load("kinect", 0.5, 1.0, 0.05, 0.02),
    Load("router", 0.3, 0.7, 0.04, 0.01),
    Load("thermal_camera", 0.2, 0.4, 0.04, 0.005),
    Load("jaguar", 3.0, 9.0, 0.12, 0.05),
)
"""The device map of the historic board; its channels 8 and 9 are free."""


def default_rig(channels: int) -> Rig:
    """Return the rescue robot's loads, as far as the channels go; the rest are free."""
    free = channels - len(RESCUE_ROBOT)
    return Rig(Supply(), (*RESCUE_ROBOT[:channels], *(Load() for _ in range(free))))


def read_rig(path: Path, channels: int) -> Rig:
    """Read a YAML (or JSON) file of loads.

    Raises:
        LoadsError: the file cannot be read, or says something that no board has.
    """
    try:
        document = yaml.safe_load(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise LoadsError(f"{path}: cannot be read: {error.strerror or error}") from error
    except (UnicodeDecodeError, yaml.YAMLError, RecursionError) as error:
        raise LoadsError(f"{path}: {error}") from error
    if not isinstance(document, dict) or not set(document) <= {"supply", "channels"}:
        raise LoadsError(f"{path}: expected a mapping with the keys supply and channels")
    supply = _checked(path, "supply", Supply, document.get("supply") or {})
    loads = [Load() for _ in range(channels)]
    listed = document.get("channels") or {}
    if not isinstance(listed, dict):
        raise LoadsError(f"{path}: channels: expected a mapping from channel numbers to loads")
    for key, value in listed.items():
        if not str(key).isdecimal() or int(key) >= channels:
            raise LoadsError(f"{path}: channels: {key!r} is none of the channels 0 to {channels - 1}")
        load = _checked(path, f"channels: {key}", Load, value)
        if load.inrush_s <= 0:
            raise LoadsError(f"{path}: channels: {key}: inrush_s must be above 0")
        loads[int(key)] = load
    return Rig(supply, tuple(loads))


Kind = TypeVar("Kind", Load, Supply)


def _checked(path: Path, place: str, kind: type[Kind], value: Any) -> Kind:
    names = [field.name for field in fields(kind)]
    if not isinstance(value, dict) or not set(value) <= set(names):
        raise LoadsError(f"{path}: {place}: expected a mapping with keys of {', '.join(names)}")
    numbers: dict[str, Any] = {}
    for name, given in value.items():
        if name == "name":
            numbers[name] = str(given)
        elif isinstance(given, bool) or not isinstance(given, int | float) or not 0 <= given < math.inf:
            raise LoadsError(f"{path}: {place}: {name} is {given!r}, not a number from 0 up")
        else:
            numbers[name] = float(given)
    return kind(**numbers)
