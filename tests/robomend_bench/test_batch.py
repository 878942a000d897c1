"""The figures of robomend-batch are measured on logs of the bench's own making."""

from __future__ import annotations

import json
from pathlib import Path

import polars as pl
from click.testing import CliRunner

from robomend_bench.batch.command import command
from robomend_bench.batch.workload import write_model, write_states


def test_each_part_gives_its_figures() -> None:
    small = ["--only", "literals,recording", "--rows", "1000", "--megabytes", "1", "--repeats", "1"]
    done = CliRunner().invoke(command, [*small, "--format", "json", "--clock", "cpu"], catch_exceptions=False)
    found = json.loads(done.stdout)
    assert found["literals"].keys() == {"0.1%", "1.0%"}
    assert all(figures["rows_s"] > 0 for figures in found["literals"].values())
    assert found["recording"]["share"] > 0


def test_a_log_has_as_many_states_as_it_says(tmp_path: Path) -> None:
    atoms = write_model(tmp_path / "model.yaml", 1)
    for distinct in (50, 20_000):
        write_states(tmp_path / "log.parquet", atoms, 20_000, distinct, 1)
        frame = pl.read_parquet(tmp_path / "log.parquet")
        assert len(frame) == 20_000
        assert frame.drop("time").n_unique() >= 0.9 * distinct


def test_an_unknown_part_is_refused() -> None:
    done = CliRunner().invoke(command, ["--only", "wings"])
    assert done.exit_code == 2
    assert "'wings' is none of literals" in done.output
