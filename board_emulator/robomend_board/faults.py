"""Faults on demand: their names, parameters and limits, and what those of the line do to outgoing bytes.

A fault of a channel or of the supply changes what the board is (robomend_board.board); a fault of the line
changes what its clients receive. To add one: a row in FAULTS, its effect in board.py or in Line, a case in
robomend_board.server, a test that shows it, and a row in docs/board.md.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import StrEnum
from typing import Any


class Scope(StrEnum):
    """What a fault is of."""

    CHANNEL = "channel"
    SUPPLY = "supply"
    LINE = "line"


class FaultError(ValueError):
    """A fault that does not exist, or parameters it does not take."""


@dataclass(frozen=True, slots=True)
class Parameter:
    """A number with its default and its range."""

    default: float
    least: float
    most: float
    whole: bool = False


@dataclass(frozen=True, slots=True)
class FaultKind:
    """One row of the table."""

    scope: Scope
    does: str
    parameters: Mapping[str, Parameter] = field(default_factory=dict)


FAULTS: dict[str, FaultKind] = {
    "stuck": FaultKind(Scope.CHANNEL, "the relay does not move any more: where it is, or at on or off"),
    "open": FaultKind(Scope.CHANNEL, "the cable is broken: voltage, but no current"),
    "short": FaultKind(Scope.CHANNEL, "over-current; the channel trips and cannot be switched on"),
    "brown-out": FaultKind(
        Scope.SUPPLY, "the supply gives less; devices stop below their least", {"volts": Parameter(15, 0, 24)}
    ),
    "late": FaultKind(Scope.LINE, "every frame comes later by this time", {"delay_s": Parameter(0.5, 0, 60)}),
    "split": FaultKind(
        Scope.LINE,
        "frames come in pieces of this size, with pauses between",
        {"size": Parameter(7, 1, 1000, whole=True), "pause_s": Parameter(0.001, 0, 1)},
    ),
    "mute": FaultKind(Scope.LINE, "nothing is sent any more; connections stay open"),
    "refuse": FaultKind(Scope.LINE, "new connections are refused"),
    "garbage": FaultKind(
        Scope.LINE,
        "this many bytes that are no frame go to every client, once",
        {"size": Parameter(32, 1, 4096, whole=True)},
    ),
    "drop": FaultKind(Scope.LINE, "every connection is dropped, once"),
}


@dataclass(frozen=True, slots=True)
class Fault:
    """A fault as asked for, checked."""

    name: str
    channel: int | None = None
    at: bool | None = None  # where a relay sticks; None: where it is
    parameters: Mapping[str, float] = field(default_factory=dict)

    @property
    def kind(self) -> FaultKind:
        return FAULTS[self.name]


def parse_fault(request: Mapping[str, Any], channels: int) -> Fault:
    """Return the fault that {"fault": name, "channel": …, parameters …} asks for.

    Raises:
        FaultError: with what is allowed.
    """
    name = request.get("fault")
    kind = FAULTS.get(name) if isinstance(name, str) else None
    if kind is None or not isinstance(name, str):
        raise FaultError(f"there is no fault {name!r}; there are {', '.join(FAULTS)}")
    allowed = {"fault", *kind.parameters}
    if kind.scope is Scope.CHANNEL:
        allowed |= {"channel", "at"} if name == "stuck" else {"channel"}
    if unknown := set(request) - allowed:
        takes = ", ".join(sorted(allowed - {"fault"})) or "nothing"
        raise FaultError(f"{name} takes no {', '.join(sorted(unknown))}; it takes {takes}")
    channel = parse_channel(request, channels) if kind.scope is Scope.CHANNEL else None
    at = request.get("at")
    if at not in (None, "on", "off"):
        raise FaultError(f'at is {at!r}; it is "on" or "off"')
    values = {key: _number(key, request.get(key), rule) for key, rule in kind.parameters.items()}
    return Fault(name, channel, None if at is None else at == "on", values)


def parse_channel(request: Mapping[str, Any], channels: int) -> int:
    """Return the request's channel; FaultError if the board has no such one."""
    if "channel" not in request:
        raise FaultError(f"channel is missing; the board has 0 to {channels - 1}")
    channel = request["channel"]
    if isinstance(channel, bool) or not isinstance(channel, int) or not 0 <= channel < channels:
        raise FaultError(f"channel is {channel!r}; the board has 0 to {channels - 1}")
    return channel


def _number(name: str, value: Any, rule: Parameter) -> float:
    if value is None:
        return rule.default
    number = isinstance(value, int | float) and not isinstance(value, bool)
    if not number or not rule.least <= value <= rule.most or (rule.whole and value != int(value)):
        kind = "a whole number" if rule.whole else "a number"
        raise FaultError(f"{name} is {value!r}; it is {kind} from {rule.least:g} to {rule.most:g}")
    return float(value)


@dataclass(slots=True)
class Line:
    """The lasting faults of the line, shared by all connections."""

    delay_s: float = 0.0
    size: int = 0  # of the pieces; 0: frames are whole
    pause_s: float = 0.0
    mute: bool = False
    refuse: bool = False

    @property
    def clean(self) -> bool:
        """Whether frames go out whole and at once."""
        return not (self.delay_s or self.size or self.mute)

    def pieces(self, frame: bytes) -> list[tuple[float, bytes]]:
        """Return what is sent of a frame: (seconds from now, bytes), in order; nothing when mute."""
        if self.mute:
            return []
        size = self.size or len(frame)
        starts = range(0, len(frame), size)
        return [(self.delay_s + i * self.pause_s, frame[at : at + size]) for i, at in enumerate(starts)]

    def set(self, fault: Fault) -> None:
        """Apply a lasting fault of the line."""
        match fault.name:
            case "late":
                self.delay_s = fault.parameters["delay_s"]
            case "split":
                self.size, self.pause_s = int(fault.parameters["size"]), fault.parameters["pause_s"]
            case "mute":
                self.mute = True
            case "refuse":
                self.refuse = True

    def clear(self, name: str) -> None:
        """Take a lasting fault of the line away."""
        match name:
            case "late":
                self.delay_s = 0.0
            case "split":
                self.size, self.pause_s = 0, 0.0
            case "mute":
                self.mute = False
            case "refuse":
                self.refuse = False

    def active(self) -> dict[str, dict[str, float]]:
        """Return the lasting faults that are on, with their parameters."""
        found: dict[str, dict[str, float]] = {}
        if self.delay_s:
            found["late"] = {"delay_s": self.delay_s}
        if self.size:
            found["split"] = {"size": self.size, "pause_s": self.pause_s}
        if self.mute:
            found["mute"] = {}
        if self.refuse:
            found["refuse"] = {}
        return found
