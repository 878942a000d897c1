"""SUAVE, the managed system of kas-lab/suave, simulated from what is published of its nodes.

    water visibility   2.5 ± 1.25 m, of whole seconds, period 80 s, in the diagnostics each 0.2 s
    spiral             flies 3, 2 or 1 m high: expected from 3.25 m, from 2.25 m, and below
    thruster 1         fails at 35 s: one status says so; in the mode for that it is recovered 5 s later

A mode is asked for by change_mode, and the mode manager says so on mode_request_info.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field

from robomend_bench.faults.condition import Act
from robomend_client.actions import OK

SEARCH, MOTION = "f_generate_search_path", "f_maintain_motion"
MODES = {
    SEARCH: ("fd_spiral_high", "fd_spiral_medium", "fd_spiral_low"),
    MOTION: ("fd_all_thrusters", "fd_recover_thrusters"),
}
ACTS = tuple(Act("change_mode", (system, mode)) for system, modes in MODES.items() for mode in modes)

PERIOD_S, LASTS_S, FAILS_S, RECOVERS_S = 80.0, 110.0, 35.0, 5.0
SAYS_S = 0.2
ANSWERS_S = 0.05


@dataclass
class Suave:
    """See the module. Time is passed in; it runs so many times as fast, from `start` on."""

    speed: float = 1.0
    messages: list[tuple[str, float, Mapping[str, object]]] = field(default_factory=list)
    modes: dict[str, str] = field(
        default_factory=lambda: {SEARCH: "fd_spiral_low", MOTION: "fd_all_thrusters"}
    )
    asked: list[str] = field(default_factory=list)  # the modes that were asked for
    wrong_s: float = 0.0  # for how long it flew at another altitude than expected, of its own time
    failed_s: float | None = None
    recovering_s: float | None = None  # when its recovery was asked for
    recovered: bool = False
    _start_s: float = math.inf
    _now_s: float = 0.0
    _said_s: float = -math.inf

    def start(self) -> None:
        """The mission begins."""
        self._start_s = self._now_s

    @property
    def mission_s(self) -> float:
        """The time of the mission; below 0: it has not begun."""
        return (self._now_s - self._start_s) * self.speed

    @property
    def visibility(self) -> float:
        """How far it sees now, in metres."""
        return 2.5 + 1.25 * math.cos(2 * math.pi * math.floor(self.mission_s) / PERIOD_S)

    @property
    def expected(self) -> str:
        """The mode by which it should search now."""
        high, medium, low = MODES[SEARCH]
        return high if self.visibility >= 3.25 else medium if self.visibility >= 2.25 else low

    def advance(self, now_s: float) -> None:
        """Let time pass, and say what the nodes say."""
        if not self.messages and math.isinf(self._said_s):
            for system, mode in self.modes.items():
                self._say_mode(system, mode, now_s)
        passed_s, self._now_s = (now_s - self._now_s) * self.speed, now_s
        if self.mission_s < 0:
            self._said_s = now_s
            return
        if self.mission_s < LASTS_S and self.modes[SEARCH] != self.expected:
            self.wrong_s += passed_s
        if self.failed_s is None and self.mission_s >= FAILS_S:
            self.failed_s = self.mission_s
            self._say_status(
                "thruster_monitor: Thruster status", 2, ("c_thruster_1", "FALSE"), ("c_thruster_1", "ERROR")
            )
        asked_s = self.recovering_s
        if asked_s is not None and not self.recovered and self.mission_s > asked_s + RECOVERS_S:
            self.recovered = True
            self._say_status("", 0, *((f"c_thruster_{number}", "RECOVERED") for number in range(1, 7)))
        if (now_s - self._said_s) * self.speed >= SAYS_S:
            self._said_s = now_s
            name = "water_visibility_observer: Water visibility measurement"
            self._say_status(name, 0, ("water_visibility", f"{self.visibility:.4f}"))

    def _say_status(self, name: str, level: int, *values: tuple[str, str]) -> None:
        pairs = [{"key": key, "value": value} for key, value in values]
        status = {"name": name, "level": level, "values": pairs}
        self.messages.append(("diagnostics", self._now_s, {"status": [status]}))

    def _say_mode(self, system: str, mode: str, at_s: float) -> None:
        self.messages.append((f"{system}/mode_request_info", at_s, {"goal_mode.label": mode}))

    def running(self) -> frozenset[str]:
        """Return the nodes whose processes are there."""
        return frozenset(f"{system}_node" for system in MODES)

    def begin(self, act: Act) -> float:
        """Ask for a mode; return how long the answer takes."""
        system, mode = act.parameters
        self.modes[system] = mode
        self.asked.append(mode)
        self._say_mode(system, mode, self._now_s)
        if mode == "fd_recover_thrusters" and self.recovering_s is None and self.failed_s is not None:
            self.recovering_s = self.mission_s
        return ANSWERS_S

    def code(self, act: Act) -> int:
        """Return the answer of an act that has ended."""
        return OK
