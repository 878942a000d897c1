"""Figures of the robot's side: what is counted is right, and every part runs."""

from __future__ import annotations

import json
import queue
from pathlib import Path

import pytest
from click.testing import CliRunner

from robomend_bench.robots import live, streams
from robomend_bench.robots.command import PARTS, command
from robomend_client.observers import GeneralObserver, Rate

SMALL = ("--samples", "1000", "--repeats", "1", "--messages", "1000", "--nodes", "2")


def test_every_part_gives_its_figures() -> None:
    done = CliRunner().invoke(command, [*SMALL, "--format", "json"], catch_exceptions=False)
    found = json.loads(done.stdout)
    assert found.keys() == PARTS.keys()
    assert all(speed["median"] > 0 for speed in found["speed"].values())
    assert 0.35 <= found["silence"]["median_s"] <= found["silence"]["max_s"]
    assert found["alarms"] == {"alarms": 0, "messages": 1000}
    assert found["live"]["killed"]["count"] == found["live"]["silent"]["count"] == 2
    assert found["live"]["silent"]["median_s"] >= 0.35
    assert found["live"]["alone_mb"] > 10


def test_an_unknown_part_is_refused() -> None:
    done = CliRunner().invoke(command, ["--only", "speed,wings"])
    assert done.exit_code == 2
    assert "'wings' is none of speed" in done.output


def test_an_observer_that_is_easily_alarmed_is_counted(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(
        streams, "GeneralObserver", lambda topic, rate: GeneralObserver(topic, Rate(10, silence_s=0.101))
    )
    assert streams.alarms(1000, seed=1) > 10


def test_what_is_never_told_is_an_error_that_names_it(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setattr(live, "WITHIN_S", 0.01)
    rig = object.__new__(live.Rig)
    rig._events, rig._holds = queue.Queue(), {"running(a)": True}
    with pytest.raises(live.NotTold, match=r"running\(b\): True"):
        rig.told({"running(a)": True, "running(b)": True})
