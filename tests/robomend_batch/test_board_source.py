"""What the power board measured, as the source of observers: live, and in recordings of the same."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
from tests.robomend_batch.recordings import EPOCH_NS, Sample, write
from tests.robomend_batch.running import batch_run, intervals, logs

from robomend_client.bridges.measured import measured
from robomend_client.observers import Driver
from robomend_client.observers.base import SECOND
from robomend_client.observers.kinds import read_observers
from robomend_client.yaml_reader import read

MODEL = """
robomend: 1
name: base
hardware: {jaguar: {channel: 0}}
properties: {jaguar_draws: {}, pack: {}, fan: {}}
rules: ["not ab(jaguar) -> ok(jaguar_draws)", "not ab(jaguar) -> ok(pack)"]
"""

OBSERVERS = """
observers:
  jaguar_draws: {kind: property, from: ros1, source: "board:current(jaguar)", high: 3, agreeing: 2}
  pack: {kind: property, from: board, source: "board:voltage(0)", low: 20}
  devices: {kind: hardware, from: ros1, wiring: {jaguar: {channel: 0, expected_current_a: 1.5}}}
"""


@pytest.fixture
def model(tmp_path: Path) -> Path:
    (tmp_path / "base.yaml").write_text(MODEL)
    return tmp_path / "base.yaml"


def row(current: float, voltage: float, on: bool = True) -> dict[str, Any]:
    return {"id": 0, "dev_connected": "jaguar", "status": int(on), "current": current, "voltage": voltage}


def drive() -> list[Sample]:
    """At 4 Hz: from 3 s on too much current, from 6 s on too little voltage, switched off at 9 s."""
    times = [number / 4 for number in range(48)]
    return [
        (at, "board_measurments", [row(5.0 if 3 <= at < 5 else 1.5, 12.0 if 6 <= at < 8 else 24.0, at < 9)])
        for at in times
    ]


def told(out: Path) -> list[tuple[int, str, object, list[str]]]:
    """Return the beginnings of intervals in which something is known, what is told, and of what literals."""
    found = [
        (one["start_ns"], one["state"], one["bad"], sorted(one["observations"])) for one in intervals(out)
    ]
    return [one for one in found if one[3]]


@pytest.mark.parametrize("name", ["a.bag", "a.mcap"])
def test_what_was_judged_live_of_the_boards_measurements_is_what_a_recording_of_them_says(
    name: str, model: Path, tmp_path: Path
) -> None:
    observers = tmp_path / "agent.yaml"
    observers.write_text(OBSERVERS)
    specs = read_observers(read(observers), tmp_path)
    driver = Driver([spec.make() for spec in specs], EPOCH_NS)
    live: list[tuple[int, str]] = []
    for at_s, _, rows in drive():
        at_ns = EPOCH_NS + round(at_s * SECOND)
        for source in sorted(driver.sources):
            changes = driver.sample(source, at_ns, measured(source, rows), at_ns)
            live += [(change.time_ns, str(change.value)) for change in changes if change.value is not None]
    assert {"not ok(jaguar_draws)", "not ok(pack)", "not on(jaguar)"} <= {text for _, text in live}
    assert "not ok(current,jaguar)" in {text for _, text in live}

    log = write(tmp_path / name, drive())
    assert batch_run(tmp_path / "out", log, "--observers", observers, model=model) == 0
    said = tmp_path / "live.ndjson"
    said.write_text("".join(json.dumps({"time": at_ns, "literal": text}) + "\n" for at_ns, text in live))
    assert batch_run(tmp_path / "live", said, model=model) == 0
    found = told(tmp_path / "out")
    assert [(one, state) for one, state, *_ in found if state == "faulty"] == [
        (one, state) for one, state, *_ in told(tmp_path / "live") if state == "faulty"
    ]
    starts = [(start - EPOCH_NS) / SECOND for start, state, *_ in found if state == "faulty"]
    assert starts[0] == 3.25  # the second measurement that says so
    assert 6.0 in starts


def test_a_device_that_the_board_does_not_have_is_told_and_costs_what_rests_on_it(
    model: Path, tmp_path: Path
) -> None:
    observers = tmp_path / "agent.yaml"
    observers.write_text(
        OBSERVERS + '  fan: {kind: property, from: ros1, source: "board:current(fan)", low: 0}\n'
    )
    log = write(tmp_path / "a.bag", drive())
    assert batch_run(tmp_path / "out", log, "--observers", observers, model=model) == 0
    (record,) = logs(tmp_path / "out")
    (problem,) = record["problems"]
    assert problem["reason"] == "no current of fan: no channel of the board has a device of that name"
    assert (problem["count"], problem["bad"]) == (48, False)
    assert problem["place"].endswith("board_measurments")
    seen = {text for *_, said in told(tmp_path / "out") for text in said}
    assert "not ok(pack)" in seen
    assert not any("fan" in text for text in seen)
