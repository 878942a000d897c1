"""`--topics-hz`: robots whose topics all have one rate are the same otherwise, with the same faults."""

from __future__ import annotations

import json
import sys
from dataclasses import replace
from pathlib import Path

import pytest
import yaml

from robomend_bench.faults.classes import CLASSES
from robomend_bench.faults.command import choose
from robomend_bench.faults.condition import HEALTHY
from robomend_bench.faults.kinds import Fault, begun
from robomend_bench.faults.observing import PRESETS, HostObservers
from robomend_bench.faults.record import Diagnosed, Record, Trial
from robomend_bench.faults.robot import find_robot, robot_names
from robomend_bench.faults.scoring import score
from robomend_bench.faults.standins import play_with
from robomend_bench.faults.trial import Terms, scenario_of
from robomend_bench.main import main
from robomend_client.literals import Atom


def run(monkeypatch: pytest.MonkeyPatch, *arguments: str) -> int:
    monkeypatch.setattr(sys, "argv", ["robomend-bench", "faults", *arguments])
    try:
        main()
    except SystemExit as end:
        return int(end.code or 0)
    return 0


@pytest.mark.parametrize("name", robot_names())
def test_only_the_rates_differ(name: str) -> None:
    own, same = find_robot(name), find_robot(name, 10.0)
    assert {topic.rate_hz for topic in same.anatomy.topics.values()} == {10.0}
    for topic in own.anatomy.topics.values():
        there = same.anatomy.topics[topic.name]
        assert there.tolerance_hz / there.rate_hz == pytest.approx(topic.tolerance_hz / topic.rate_hz)
        assert replace(there, rate_hz=topic.rate_hz, tolerance_hz=topic.tolerance_hz) == topic
    assert replace(same.anatomy, topics=own.anatomy.topics) == own.anatomy
    assert (same.name, same.config) == (own.name, own.config)
    # What the service is told of it says so, too, and nothing else.
    told, before = yaml.safe_load(same.model), yaml.safe_load(own.model)
    rates = {topic: (value["rate_hz"], value["tolerance_hz"]) for topic, value in told["topics"].items()}
    assert rates == {t.name: (t.rate_hz, t.tolerance_hz) for t in same.anatomy.topics.values()}
    assert {**told, "topics": None} == {**before, "topics": None}


@pytest.mark.parametrize("name", robot_names())
def test_the_same_faults_can_be_planted(name: str) -> None:
    own, same = find_robot(name).anatomy, find_robot(name, 10.0).anatomy
    for described in CLASSES:
        assert described.faults(own) == described.faults(same), described.name


def test_the_observers_are_set_for_that_rate() -> None:
    def settling_s(topics_hz: float | None) -> set[float]:
        anatomy = find_robot("base", topics_hz).anatomy
        driver = HostObservers(anatomy, None, PRESETS["fast"], 0.0).driver
        return {driver.delays_s(Atom("ok", (name,)))[1] for name in anatomy.topics}

    assert len(settling_s(None)) > 1
    (at_5_hz,), (at_10_hz,) = settling_s(5.0), settling_s(10.0)
    assert at_10_hz < at_5_hz


def test_a_trial_has_its_scenario_at_any_rate_and_its_messages_at_that_one() -> None:
    trials = list(choose(60, 0, 1, robot_names(), ["hung-node", "mute-successor", "double"]))
    for trial in trials[:12]:
        own, same = (play_with("idle", trial, Terms("fast", topics_hz=hz)) for hz in (None, 10.0))
        assert own.faults == same.faults
        assert [fault for _, fault in same.faults] == list(scenario_of(trial).faults)
    # Five intervals until a topic is called good again take as long as five intervals do.
    trial = Trial("base", "hung-node", 1, 1)
    took_s = [
        score(play_with("knowing", trial, Terms("fast", topics_hz=hz)), find_robot("base", hz)).repaired_s
        or 0
        for hz in (5.0, 50.0)
    ]
    assert took_s[0] > took_s[1] + 0.5 > 0.5


def test_the_observers_delay_is_a_window_of_the_slowest_topic_there_is() -> None:
    assert [round(PRESETS["fast"].delay_s(hz), 9) for hz in (5.0, 10.0, 50.0)] == [2.1, 1.1, 0.6]
    assert Terms("fast").quiet_s == pytest.approx(4.1)
    assert Terms("fast", topics_hz=10.0).quiet_s == pytest.approx(3.1)

    def alarms(topics_hz: float | None) -> int:
        robot = find_robot("base", topics_hz)
        record = Record(Trial("base", "boot", 1, 1), "fast", end_s=15.0)
        record.states = [(-1.0, begun(robot.anatomy, Fault("planner", "dead"))), (0.2, HEALTHY)]
        record.diagnoses = [Diagnosed(-0.1, ((),)), Diagnosed(1.9, (("planner",),)), Diagnosed(2.0, ((),))]
        return score(record, robot).alarms

    assert alarms(None) == 0  # it was broken 1.7 s ago, and the observers' delay is 2.1 s
    assert alarms(10.0) == 1  # it is 1.1 s


def test_a_report_says_at_what_rate_it_was_and_how_to_play_a_trial_again(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    few = ("--trials", "2", "--stretches", "0", "--robots", "base", "--observers", "fast", "--agent", "idle")
    kept = ("--keep", str(tmp_path / "scores"))
    assert run(monkeypatch, *few, "--topics-hz", "10", *kept, "--out", str(tmp_path)) == 0
    shown = capsys.readouterr().out
    assert "stand-in idle, fast observers, every topic at 10 Hz, " in shown
    assert "--observers fast --topics-hz 10 --agent idle" in shown
    assert json.loads((tmp_path / "faults-fast.json").read_text())["topics_hz"] == 10.0
    # Scores at another rate are of another kind of run.
    assert run(monkeypatch, *few, *kept) == 2
    assert "topics_hz: 10.0 there, None now" in " ".join(capsys.readouterr().err.replace("│", " ").split())


def test_no_rate_is_taken_that_the_observers_are_not_set_for(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run(monkeypatch, "--topics-hz", "2", "--agent", "idle", "--trials", "1", "--stretches", "0") == 2
    assert "is not in the range" in " ".join(capsys.readouterr().err.replace("│", " ").split())
