"""How far a run is, told while a long log is in hand."""

from __future__ import annotations

from io import StringIO
from pathlib import Path

import polars as pl
import pytest
from tests.robomend_batch.running import TEDUSAR

from robomend.diagnosis.result import Options
from robomend.model.loading import load_model
from robomend_batch import progress
from robomend_batch.one_log import Setup
from robomend_batch.pool import in_this_process, in_workers
from robomend_batch.progress import FILE_S, Progress


def test_a_log_in_hand_counts_as_far_as_it_is_read(monkeypatch: pytest.MonkeyPatch) -> None:
    now_s = [100.0]
    monkeypatch.setattr(progress, "monotonic", lambda: now_s[0])
    told = StringIO()
    shown = Progress(2, 50_000_000, stream=told)
    now_s[0] += FILE_S
    shown.reading("long", 0.25, 40_000_000)
    now_s[0] += FILE_S
    shown.reading("long", 0.75, 40_000_000)
    now_s[0] += FILE_S
    shown.finished("long", 40_000_000)
    assert told.getvalue().splitlines() == [
        "0 of 2 logs, 10 of 50 MB, 1.0 MB/s, 0:40 left",
        "0 of 2 logs, 30 of 50 MB, 1.5 MB/s, 0:13 left",
        "1 of 2 logs, 40 of 50 MB, 1.3 MB/s, 0:08 left",
    ]


@pytest.mark.parametrize("workers", [0, 1])
def test_whoever_has_a_log_in_hand_says_how_much_of_it_is_read(workers: int, tmp_path: Path) -> None:
    rows = 400_000
    log = tmp_path / "long.parquet"
    literals = ["ok(scan)", "not ok(scan)"] * (rows // 2)
    pl.DataFrame({"time": range(0, rows * 10**6, 10**6), "literal": literals}).write_parquet(log)
    (tmp_path / "out" / "results").mkdir(parents=True)
    setup = Setup(load_model(TEDUSAR), Options(conflicts=False), tmp_path / "out")
    told: list[tuple[str, float]] = []

    def note(name: str, share: float) -> None:
        told.append((name, share))

    names = [str(log)]
    done = list(in_workers(setup, names, 1, note) if workers else in_this_process(setup, names, note))
    assert [name for name, _ in done] == names
    assert told[0][0] == names[0]
    assert 0 < told[0][1] < 0.5
    assert [share for _, share in told] == sorted(share for _, share in told)
