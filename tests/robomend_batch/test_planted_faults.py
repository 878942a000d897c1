"""Faults that an independent generator planted are found, each in its time, and nothing else is."""

from __future__ import annotations

from pathlib import Path

from tests.robomend_batch.robot_generator import BEGIN_S, generate
from tests.robomend_batch.running import batch_run, intervals

from robomend_client.observers.base import SECOND

MODEL = """
robomend: 1
name: mapper_robot
nodes:
  base: {publishes: {odom: []}}
  scanner: {publishes: {scan: []}}
  mapper: {publishes: {map: [scan]}}
  motor: {}
properties: {motor_temperature: {}}
rules: ["not ab(motor) -> ok(motor_temperature)"]
"""

OBSERVERS = """
topics:
  odom: {rate_hz: 20, tolerance_hz: 4}
  scan: {rate_hz: 10, tolerance_hz: 3}
  map: {rate_hz: 2, tolerance_hz: 0.6}
observers:
  motor_temperature: {kind: property, source: "motor:data", high: 80, agreeing: 3}
"""

DELAY_S = 6.0
"""Of the slowest: a window of ten maps at 2 Hz, and a check."""

LOGS = 12


def test_every_planted_fault_is_found_and_nothing_in_stretches_without_one(tmp_path: Path) -> None:
    model, observers = tmp_path / "model.yaml", tmp_path / "observers.yaml"
    model.write_text(MODEL)
    observers.write_text(OBSERVERS)
    folder = tmp_path / "logs"
    folder.mkdir()
    drives = dict(generate(folder, seed) for seed in range(LOGS))
    assert batch_run(tmp_path / "out", folder, "--observers", observers, model=model) == 0
    told = intervals(tmp_path / "out")
    planted = right = 0
    for file, truth in drives.items():
        found = [
            (one["start_ns"] / SECOND - BEGIN_S, one["end_ns"] / SECOND - BEGIN_S, one["bad"])
            for one in told
            if one["log"] == str(file) and one["state"] == "faulty"
        ]
        for fault in truth:
            start_s, end_s = fault["start_s"], fault["end_s"]
            here = [(a, b, bad) for a, b, bad in found if b > start_s and a < end_s + DELAY_S]
            planted += 1
            assert here, f"{file.name}: {fault} was not found"
            assert min(a for a, _, _ in here) <= start_s + DELAY_S
            longest = max(here, key=lambda one: one[1] - one[0])
            right += longest[2] == [[fault["component"]]]
        for a, b, bad in found:
            near = [t for t in truth if a >= t["start_s"] and b <= t["end_s"] + DELAY_S]
            assert near, f"{file.name}: {bad} from {a:.2f} to {b:.2f} s is no fault"
    assert planted >= LOGS
    assert right >= 0.95 * planted, f"{right} of {planted}"
