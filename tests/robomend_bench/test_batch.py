"""The figures of robomend-batch are measured on logs of the bench's own making."""

from __future__ import annotations

import json
import os
from pathlib import Path

import polars as pl
import pytest
from click.testing import CliRunner
from rosbags.rosbag1 import Reader

from robomend.cli.models import load
from robomend_bench.batch import drives
from robomend_bench.batch.command import command, on_cores, write_model, write_recording, write_states
from robomend_bench.batch.drives import BEGIN_S, Planted
from robomend_bench.batch.learning import Score, rate
from robomend_client.literals import parse_atom


def test_each_part_gives_its_figures() -> None:
    small = ["--only", "literals,recording", "--rows", "1000", "--megabytes", "1", "--repeats", "1"]
    done = CliRunner().invoke(command, [*small, "--format", "json", "--clock", "cpu"], catch_exceptions=False)
    found = json.loads(done.stdout)
    assert found["literals"].keys() == {"0.1%", "1.0%"}
    assert all(figures["rows_s"] > 0 for figures in found["literals"].values())
    assert found["recording"]["share"] > 0


@pytest.mark.parametrize("seed", [1, 2])
def test_the_model_to_measure_with_can_be_read_whatever_its_seed(seed: int, tmp_path: Path) -> None:
    atoms = write_model(tmp_path / "model.yaml", seed)
    system = load(str(tmp_path / "model.yaml"))
    assert {parse_atom(atom) for atom in atoms} <= system.cnf.atom_variable.keys()


@pytest.mark.skipif(not hasattr(os, "sched_setaffinity"), reason="there is no such call here")
def test_a_single_worker_is_measured_on_a_single_core() -> None:
    before = os.sched_getaffinity(0)
    with on_cores(1):
        assert len(os.sched_getaffinity(0)) == 1
        assert os.sched_getaffinity(0) <= before
    assert os.sched_getaffinity(0) == before


def test_what_is_learned_is_scored() -> None:
    small = ["--only", "learn", "--robots", "1", "--minutes", "1.5", "--format", "json"]
    found = json.loads(CliRunner().invoke(command, small, catch_exceptions=False).stdout)["learn"]
    assert (found["robots"], found["false_alarms"], found["planted"]) == (1, 0, {})


def test_a_fault_is_found_by_its_component_in_its_time() -> None:
    planted = [Planted("silent", "base", 100, 150), Planted("hot", "motor", 300, 350)]

    def told(start_s: float, end_s: float, *bad: list[str]) -> dict[str, object]:
        at = [round((BEGIN_S + seconds) * 1e9) for seconds in (start_s, end_s)]
        return {"start_ns": at[0], "end_ns": at[1], "state": "faulty" if bad else "healthy", "bad": [*bad]}

    score = Score()
    rate(score, [told(0, 103), told(103, 151, ["base"], ["imu"]), told(151, 400)], planted)
    assert (score.found, score.alone) == ({"silent": 1}, {"silent": 0})
    assert score.delays_s == [pytest.approx(3)]
    rate(score, [told(301, 340, ["motor"]), told(500, 501, ["base"]), told(501, 502, ["imu"])], planted)
    assert (score.planted, score.found) == ({"silent": 2, "hot": 2}, {"silent": 1, "hot": 1})
    assert score.alone["hot"] == 1
    assert score.stray == 1  # one episode, of two components


@pytest.mark.parametrize("seed", range(2))
def test_a_drive_has_the_faults_that_were_planted(seed: int, tmp_path: Path) -> None:
    robot = drives.robot(seed)
    node = robot.sources[0]
    planted = [Planted("silent", node.node, 20, 40)]
    file = drives.write(tmp_path / "drive.bag", robot, seed, 60, planted)
    with Reader(file) as reader:
        by_node = {
            getattr(c.ext, "callerid", None): c for c in reader.connections if c.topic == f"/{node.topic}"
        }
        times = [t / 1e9 - BEGIN_S for _, t, _ in reader.messages([by_node[f"/{node.node}"]])]
    assert [t for t in times if 21 < t < 40] == []
    assert sum(t < 20 for t in times) == pytest.approx(20 * node.rate_hz, rel=0.15)
    assert all(f.end_s - f.start_s >= 45 for f in drives.faults(robot, seed, 1800))


def test_a_log_has_as_many_states_as_it_says(tmp_path: Path) -> None:
    atoms = write_model(tmp_path / "model.yaml", 1)
    for distinct in (50, 20_000):
        write_states(tmp_path / "log.parquet", atoms, 20_000, distinct, 1)
        frame = pl.read_parquet(tmp_path / "log.parquet")
        assert len(frame) == 20_000
        assert frame.drop("time").n_unique() >= 0.9 * distinct


def test_a_recording_is_as_large_on_disk_as_it_is_said_to_be(tmp_path: Path) -> None:
    count = write_recording(tmp_path / "log.mcap", 3)
    assert count > 1000
    assert 3_000_000 <= (tmp_path / "log.mcap").stat().st_size < 5_000_000
