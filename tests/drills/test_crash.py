"""kill -9 in the middle of drills: whatever was killed, whenever, nothing that was planted is left."""

from __future__ import annotations

import contextlib
import random
import subprocess
import sys
import time
from collections import Counter
from pathlib import Path
from typing import Any

import pytest
from tests.drills.drilled_robot import DrilledRobot, drilled_robot
from tests.forked import popen
from tests.waiting import until

from robomend.planning.faults import fault_name
from robomend_client.rest import ClientError

FAULTS: tuple[tuple[str, str | None, str | None], ...] = (
    ("node-killed", "lidar_node", None),
    ("node-frozen", "lidar_node", None),
    ("node-mute", "lidar_node", None),
    ("node-killed", "mapping", None),
    ("node-frozen", "mapping", None),
    ("node-mute", "mapping", None),
    ("topic-dropped", "lidar_node", "scan"),
    ("topic-delayed", "mapping", "map"),
    ("device-off", "lidar", None),
    ("device-off", "base", None),
    ("channel-short", "lidar", None),
    ("channel-open", "base", None),
    ("board-mute", None, None),
)


def one_round(robot: DrilledRobot, rng: random.Random, victim: str) -> tuple[str, str, str]:
    """Drill, kill the victim at a random moment, start it again; return fault, state at that moment, end."""
    kind, component, topic = rng.choice(FAULTS)
    name = fault_name(kind, component, topic)
    if victim == "command":
        command, drill = by_command(robot, name)
    else:
        drill = robot.start_drill(kind, component, bound_s=8.0, detect_s=4.0, topic=topic)
    time.sleep(rng.uniform(0.0, 2.0))  # a random moment
    at = "?"
    with contextlib.suppress(ClientError), robot.client as client:
        at = client.drill(drill["id"])["state"]
    if victim == "command":
        command.kill()
        command.wait()
    else:
        robot.kill(victim)
        time.sleep(rng.uniform(0.0, 0.5))  # likewise
        robot.start_agent() if victim == "agent" else robot.start_service()
    ended = robot.ended(drill["id"])
    assert ended["undone"], ended
    # The agent's own undo, and a repair of what its kill broke, may still be under way.
    until(lambda: not robot.leftovers(), f"nothing is left of {ended}: {robot.leftovers()}", 60.0)
    robot.until_healthy()
    return name, at, ended["state"]


def by_command(robot: DrilledRobot, fault: str) -> tuple[subprocess.Popen[bytes], dict[str, Any]]:
    """Begin a drill by `robomend drill`; return its process, and the drill."""
    with robot.client as client:
        before = {one["id"] for one in client.drills("r1")["items"]}

        def new() -> list[dict[str, Any]]:
            return [one for one in client.drills("r1")["items"] if one["id"] not in before]

        words = ("drill", "r1", "--url", robot.url, "--fault", fault, "--yes", "--bound-s", "8")
        command = popen(
            [sys.executable, "-m", "robomend", *words], stderr=subprocess.DEVNULL, stdout=subprocess.DEVNULL
        )
        until(new, "the command has begun a drill", 90.0)
        return command, new()[0]


def drilled_and_killed(robot: DrilledRobot, drills: int) -> None:
    seed = random.randrange(1 << 30)
    rng = random.Random(seed)
    found: list[tuple[str, str, str, str]] = []
    for number in range(drills):
        victim = ("agent", "service", "command")[number % 3]
        try:
            found.append((victim, *one_round(robot, rng, victim)))
        except AssertionError as error:
            raise AssertionError(f"seed {seed}, drill {number}, {victim}: {error}") from error
    counted = Counter((victim, at, end) for victim, _, at, end in found)
    print(len(found), sorted(counted.items()), Counter(name for _, name, _, _ in found))


@pytest.mark.timeout(3600)
def test_killed_at_random_moments_nothing_is_left(robot: DrilledRobot, long: bool) -> None:
    drilled_and_killed(robot, 50 if long else 2)


@pytest.mark.long
@pytest.mark.timeout(3600)
def test_nor_where_nodes_outlive_the_agent(tmp_path: Path) -> None:
    with drilled_robot(tmp_path, keep=True) as robot:
        drilled_and_killed(robot, 50)
