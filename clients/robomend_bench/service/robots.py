"""Robots that faults come to and leave: each change of theirs changes the diagnosis, whatever was before.

Every node of the model is running or not, and every switchable device on or off: by the six schemes each
literal has a conflict of its own, so each change of one must show in the diagnosis. Which literal changes is
drawn by chance, so that the robots of a fleet are in different states and few questions are asked twice.
"""

from __future__ import annotations

import json
import random
from collections import deque

LITERALS = (
    "running(jaguar_node)",
    "running(hokuyo_node)",
    "running(laser_alignment_node)",
    "running(imu_node)",
    "running(joy_node)",
    "running(jaguar_teleop_node)",
    "running(hector_mapping)",
    "running(rviz)",
    "running(laser_alignment_control)",
    "on(jaguar)",
    "on(hokuyo)",
    "on(laser_alignment)",
)
"""Of examples/tedusar.yaml."""


RECENT = 3
"""Literals left alone for so many changes: what is diagnosed together must not cancel out."""


class SimulatedRobot:
    """One robot: what its observers would say, and what the service must know in the end."""

    def __init__(self, name: str, seed: int, *, faults: int, recent: int = RECENT) -> None:
        """About `faults` literals are false at a time, at most; of `recent` + 1 changes each is another's."""
        self.name = name
        self.path = f"/api/v1/robots/{name}/observations"
        self.revision = 0  # after the changes that were sent
        self.holds = dict.fromkeys(LITERALS, True)
        self.kept = 0  # revision after the changes that the service has accepted
        self.known: dict[str, bool] = {}  # what it knows by them
        self._random = random.Random(f"{name} {seed}")
        self._faults = faults
        self._recent: deque[str] = deque(maxlen=recent)

    def sound(self) -> list[str]:
        """Return what a healthy robot reports: the state before the first change."""
        self.is_at(1)
        self.known = dict.fromkeys(LITERALS, True)
        return list(LITERALS)

    def is_at(self, revision: int) -> None:
        """The service knows the robot at this revision."""
        self.revision = self.kept = revision

    def accepted(self, said: list[str]) -> bool:
        """The service has accepted an observation. Return whether that was news to it: what came before may
        have been refused.
        """
        told = {sentence.removeprefix("not "): not sentence.startswith("not ") for sentence in said}
        news = not told.items() <= self.known.items()
        self.known |= told
        self.kept += news
        return news

    def change(self) -> list[str]:
        """Return the observation of a change: a fault that comes, or one that goes."""
        false = [name for name, holds in self.holds.items() if not holds and name not in self._recent]
        true = [name for name, holds in self.holds.items() if holds and name not in self._recent]
        many = list(self.holds.values()).count(False) >= self._faults
        goes = not true or (bool(false) and (many or self._random.random() < 0.5))
        name = self._random.choice(false if goes else true)
        self._recent.append(name)
        self.holds[name] = goes
        self.revision += 1
        return [name if goes else f"not {name}"]

    def take_back(self) -> None:
        """Undo the latest change: the service has refused it."""
        name = self._recent[-1]
        self.holds[name] = not self.holds[name]
        self.revision -= 1

    def expected(self) -> frozenset[str]:
        """Return OBS as it must be once all is accepted."""
        return _literals(self.holds)

    def acknowledged(self) -> frozenset[str]:
        """Return OBS as it must be now."""
        return _literals(self.known)


def _literals(holds: dict[str, bool]) -> frozenset[str]:
    return frozenset(name if positive else f"not {name}" for name, positive in holds.items())


def body(observations: list[str]) -> bytes:
    """Return a batch as JSON."""
    return json.dumps({"observations": observations}).encode()
