"""What the demo can play, told once: for the command, the screen, the pictures and the report. Pure."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Scenario:
    """What happens to the robot; play.py lets it happen."""

    name: str
    happens: str  # in a sentence, as it begins
    title: str  # of its picture
    victim: str  # the device that breaks
    goal_s: float | None = None  # until all is good and verified, where one was set
    needs_spare: bool = False  # a robot with a second laser range finder


POWER_UP = Scenario(
    "power-up",
    "everything is off and nothing runs; the robot is entrusted to the service",
    "Power-up: everything is off, nothing runs",
    victim="jaguar",
    goal_s=8.0,
)
SHUT_DOWN = Scenario(
    "shut-down",
    "the tracked base (jaguar) loses its power",
    "Shut-down: the tracked base loses its power",
    victim="jaguar",
    goal_s=3.0,
)
HUNG_DEVICE = Scenario(
    "hung-device",
    "the laser range finder (hokuyo) hangs: it has power, and says nothing until that is cut once",
    "Hung device: the laser range finder says nothing until its power is cut once",
    victim="hokuyo",
)
DEAD_LIDAR = Scenario(
    "dead-lidar",
    "the laser range finder (hokuyo) is dead; there is a second one",
    "Dead lidar: nothing brings it back, and a spare takes its place",
    victim="hokuyo",
    needs_spare=True,
)

SCENARIOS = {one.name: one for one in (POWER_UP, SHUT_DOWN, HUNG_DEVICE, DEAD_LIDAR)}
"""In the order in which they are played: a robot that is off comes first, one that lacks a device last."""

OF_THE_PAPER = (POWER_UP, SHUT_DOWN)
