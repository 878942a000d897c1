"""One explanation for a whole log, or for each window of it."""

from __future__ import annotations

import json
import random
from pathlib import Path
from typing import Any

import pytest
from tests.robomend_batch.running import TEDUSAR, batch_run, intervals, ndjson, spans

from robomend.cli.commands import run as robomend
from robomend.diagnosis.result import Options
from robomend.diagnosis.snapshots import SnapshotEngine
from robomend.model.loading import load_model
from robomend_batch.commands import batch
from robomend_client.literals import Literal, parse_atom
from robomend_client.observers.base import SECOND

DRIVE = (
    *((0.0, "on(jaguar)"), (0.0, "on(hokuyo)"), (0.0, "ok(odom)"), (0.0, "ok(scan)")),
    *((2.0, "not ok(odom)"), (4.0, "ok(odom)"), (7.0, "not ok(scan)"), (8.0, "ok(scan)"), (10.0, "ok(scan)")),
)

BASE, LIDAR = ("jaguar", "jaguar_node"), ("hokuyo", "hokuyo_node")


def test_a_whole_log_has_one_explanation(tmp_path: Path) -> None:
    log = ndjson(tmp_path / "a.ndjson", *DRIVE)
    assert batch_run(tmp_path / "out", log, "--together", "log") == 0
    (one,) = intervals(tmp_path / "out")
    assert (one["start_ns"], one["end_ns"], one["state"]) == (0, 10 * SECOND, "faulty")
    assert sorted(map(sorted, one["bad"])) == sorted(sorted([a, b]) for a in BASE for b in LIDAR)
    assert sorted(one["observations"]) == ["not ok(odom)", "not ok(scan)"]
    assert sorted(map(sorted, one["conflicts"])) == [sorted(LIDAR), sorted(BASE)]
    assert (one["complete"], one["probability"]) == (True, None)


def test_the_report_says_what_was_seen_of_states_that_exclude_each_other(tmp_path: Path) -> None:
    lines = (
        (0.0, "ok(scan)"),
        (0.0, "not ok(map)"),
        (2.0, "ok(map)"),
        (3.0, "not ok(scan)"),
        (5.0, "ok(scan)"),
    )
    log = ndjson(tmp_path / "a.ndjson", *lines)
    out = tmp_path / "out"
    assert batch_run(out, log, "--together", "log") == 0
    (one,) = intervals(out)
    assert sorted(map(sorted, one["bad"])) == [sorted(["hector_mapping", name]) for name in LIDAR]
    assert robomend(["report", str(out)], batch) == 0
    page = (out / "report.html").read_text()
    assert "Seen in one window: not ok(scan), ok(scan), not ok(map)." in page


def test_a_window_in_which_nothing_is_known_is_unknown(tmp_path: Path) -> None:
    lines = [
        {"time": 0, "literal": "not ok(odom)", "lifetime": 1},
        {"time": 5 * SECOND, "literal": "ok(odom)", "lifetime": None},
    ]
    (tmp_path / "a.ndjson").write_text("".join(json.dumps(line) + "\n" for line in lines))
    assert batch_run(tmp_path / "out", tmp_path / "a.ndjson", "--together", "2s") == 0
    assert [span[:3] for span in spans(tmp_path / "out")] == [
        (0.0, 2.0, "faulty"),
        (2.0, 4.0, "unknown"),
        (4.0, 5.0, "healthy"),
    ]


def test_logs_that_speak_of_other_things_first_are_not_mixed_up(tmp_path: Path) -> None:
    ndjson(tmp_path / "a.ndjson", (0.0, "not ok(odom)"), (1.0, "ok(scan)"))
    ndjson(tmp_path / "b.ndjson", (0.0, "not ok(scan)"), (1.0, "ok(odom)"))
    assert batch_run(tmp_path / "out", tmp_path, "--together", "log") == 0
    assert [one["bad"] for one in intervals(tmp_path / "out")] == [
        [[name] for name in BASE],
        [[name] for name in LIDAR],
    ]


def test_time_that_goes_back_begins_anew(tmp_path: Path) -> None:
    log = ndjson(tmp_path / "a.ndjson", (50.0, "ok(odom)"), (60.0, "ok(odom)"), (0.0, "not ok(odom)"))
    assert batch_run(tmp_path / "out", log, "--together", "log") == 0
    told = [(one["segment"], one["start_ns"] / SECOND, one["state"]) for one in intervals(tmp_path / "out")]
    assert told == [(0, 50.0, "healthy"), (1, 0.0, "faulty")]


def test_what_no_fault_explains_is_told(tmp_path: Path) -> None:
    model = tmp_path / "model.yaml"
    model.write_text("robomend: 1\nname: m\nhardware: {a: {}}\nproperties: {p: {}}\nrules: ['ok(p)']\n")
    log = ndjson(tmp_path / "a.ndjson", (0.0, "ok(p)"), (1.0, "not ok(p)"), (2.0, "ok(p)"))
    assert batch_run(tmp_path / "out", log, "--together", "log", model=model) == 0
    (one,) = intervals(tmp_path / "out")
    assert (one["state"], one["bad"]) == ("contradictory", [])


@pytest.mark.parametrize("seed", range(4))
def test_windows_say_what_the_engine_says_of_all_their_states(seed: int, tmp_path: Path) -> None:
    system = load_model(TEDUSAR)
    chance = random.Random(seed)
    atoms = chance.sample(sorted(map(str, system.cnf.atom_variable)), 8)
    lines = [
        (0.5 * number, f"{'not ' if chance.random() < 0.3 else ''}{chance.choice(atoms)}")
        for number in range(40)
    ]
    log = ndjson(tmp_path / "a.ndjson", *lines)
    assert batch_run(tmp_path / "out", log, "--together", "4s") == 0
    engine = SnapshotEngine(system.cnf)
    told = intervals(tmp_path / "out")
    assert len(told) == 5
    for one in told:
        start_s, end_s = one["start_ns"] / SECOND, one["end_ns"] / SECOND
        obs: dict[Any, Literal] = {}
        snapshots = []
        for number, (time_s, text) in enumerate(lines):
            literal = Literal(parse_atom(text.removeprefix("not ")), not text.startswith("not "))
            obs[literal.atom] = literal
            until_s = lines[number + 1][0] if number + 1 < len(lines) else time_s + 1
            ends_here = number + 1 == len(lines) and one is told[-1]  # it lasts no time
            if until_s > start_s and (time_s < end_s or ends_here):
                snapshots.append([*obs.values()])
        expected = engine.diagnose(snapshots, Options(conflicts=False))
        assert sorted(map(sorted, one["bad"])) == sorted(sorted(d.bad) for d in expected.diagnoses)
    engine.close()


@pytest.mark.parametrize("span", ["30", "0s", "-1s"])
def test_what_is_no_span_is_refused(span: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    log = ndjson(tmp_path / "a.ndjson", *DRIVE)
    assert batch_run(tmp_path / "out", log, "--together", span) == 2
    assert "is neither `log` nor a time such as 30s" in capsys.readouterr().err
