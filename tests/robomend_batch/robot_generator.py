"""A generator of recordings that knows nothing of robomend: a drive with planted faults, and the truth.

    generate(folder, seed) ──► drive000.bag, drive000.json: [{"kind", "component", "start_s", "end_s"}, …]

Only the ROS message formats are shared with what is tested (the writer of rosbags). A robot has a base, a
laser scanner, a mapper that needs the scans, and a motor with a thermometer; messages jitter, and one in five
hundred is lost.
"""

from __future__ import annotations

import json
import random
import struct
from pathlib import Path
from typing import TypedDict

from rosbags.rosbag1 import Writer

BEGIN_S = 1_700_000_000
LENGTH_S = 120.0
MD5 = "fdb28210bfa9d7c91146260178d9a584"  # of std_msgs/Float64
RATES = {"odom": 20.0, "scan": 10.0, "map": 2.0, "motor": 5.0}

KINDS = {
    "base_dead": "base",  # its odometry is silent
    "scanner_dead": "scanner",  # no scans, and no maps of them
    "scanner_slow": "scanner",  # half of the scans, and half of the maps
    "mapper_dead": "mapper",  # no maps, though there are scans
    "motor_hot": "motor",  # its temperature is above 80
}


class Fault(TypedDict):
    """What was planted."""

    kind: str
    component: str
    start_s: float
    end_s: float


def generate(folder: Path, seed: int) -> tuple[Path, list[Fault]]:
    """Write a drive with none to three faults, one after another; return it and the truth."""
    chance = random.Random(seed)
    truth: list[Fault] = []
    at_s = chance.uniform(8, 15)
    for _ in range(chance.randrange(4)):
        kind = chance.choice(sorted(KINDS))
        end_s = at_s + chance.uniform(8, 15)
        truth.append({"kind": kind, "component": KINDS[kind], "start_s": at_s, "end_s": end_s})
        at_s = end_s + chance.uniform(12, 18)
    messages = []
    for topic, rate_hz in RATES.items():
        number = 0
        while number / rate_hz < LENGTH_S:
            time_s = number / rate_hz + chance.gauss(0, 0.04 / rate_hz)
            number += 1
            here = {fault["kind"] for fault in truth if fault["start_s"] <= time_s < fault["end_s"]}
            if chance.random() < 0.002 or missing(topic, here, number):
                continue
            value = chance.gauss(95 if "motor_hot" in here else 50, 1.5) if topic == "motor" else 0.0
            messages.append((max(time_s, 0.0), topic, value))
    messages.sort()
    file = folder / f"drive{seed:03}.bag"
    with Writer(file) as writer:
        connections = {
            topic: writer.add_connection(
                f"/{topic}", "std_msgs/msg/Float64", msgdef="float64 data\n", md5sum=MD5
            )
            for topic in RATES
        }
        for time_s, topic, value in messages:
            stamp_ns = BEGIN_S * 10**9 + round(time_s * 1e9)
            writer.write(connections[topic], stamp_ns, struct.pack("<d", value))
    (folder / f"drive{seed:03}.json").write_text(json.dumps(truth))
    return file, truth


def missing(topic: str, faults: set[str], number: int) -> bool:
    """Return whether a message is not sent because of a fault."""
    if topic == "odom":
        return "base_dead" in faults
    if topic == "scan":
        return "scanner_dead" in faults or ("scanner_slow" in faults and number % 2 == 0)
    if topic == "map":
        halved = "scanner_slow" in faults and number % 2 == 0
        return "scanner_dead" in faults or "mapper_dead" in faults or halved
    return False
