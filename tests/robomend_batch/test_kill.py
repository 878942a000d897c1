"""kill -9 in mid-run: the same command goes on, and what it leaves is what an undisturbed run leaves."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
from contextlib import suppress
from pathlib import Path

import pytest
from tests.robomend_batch.running import PROGRAM, TEDUSAR, batch_run, tree
from tests.waiting import until

LOGS = 12

LONG = 200_000


def many_logs(folder: Path, lines: int = 8000) -> Path:
    """Write logs that take some seconds together."""
    folder.mkdir()
    said = ["ok(odom)", "not ok(odom)", "ok(scan)", "not on(jaguar)", "on(jaguar)", "not ok(map)", "ok(map)"]
    for log in range(LOGS):
        text = [
            json.dumps({"time": time * 1000, "literal": said[(time * (log + 3) + time // 7) % len(said)]})
            for time in range(lines)
        ]
        (folder / f"{log:02}.ndjson").write_text("\n".join(text) + "\n")
    return folder


def long_log(file: Path, lines: int = LONG) -> Path:
    """Write one log; of the usual length it takes some seconds."""
    said = ["ok(odom)", "not ok(odom)", "ok(scan)", "not on(jaguar)", "on(jaguar)", "not ok(map)", "ok(map)"]
    with file.open("w") as written:
        for time in range(lines):
            literal = said[(time * 3 + time // 7) % len(said)]
            written.write(f'{{"time": {time * 1000}, "literal": "{literal}"}}\n')
    return file


@pytest.fixture(scope="module")
def undisturbed(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, dict[str, bytes]]:
    folder = tmp_path_factory.mktemp("kill")
    logs = many_logs(folder / "logs", 12_000)
    assert batch_run(folder / "out", logs) == 0
    return logs, tree(folder / "out")


def killed_in_the_middle(
    line: list[str], out: Path, files: str, count: int, by: signal.Signals = signal.SIGKILL
) -> bool:
    """Start a run and end it when it has written so many files; return whether it was not done yet."""
    said = out.with_suffix(".said")
    with said.open("w") as stderr:
        # tests may run where Ctrl-C is ignored, as behind `&`, and who is started there ignores it as well
        heeding = ["env", "--default-signal=INT", *line]
        running = subprocess.Popen(heeding, start_new_session=True, stderr=stderr)
    try:
        until(
            lambda: running.poll() is not None or len(list((out / "results").glob(files))) >= count,
            "the first files",
            60,
            closely=True,
        )
    finally:
        with suppress(ProcessLookupError):
            os.killpg(running.pid, by)
        running.wait(60)
    assert "Traceback" not in said.read_text()
    return not (out / "logs.ndjson").exists()


@pytest.mark.parametrize(("parts", "by"), [(1, signal.SIGKILL), (3, signal.SIGINT)])
def test_a_run_that_is_killed_is_finished_by_the_same_command(
    parts: int, by: signal.Signals, undisturbed: tuple[Path, dict[str, bytes]], tmp_path: Path
) -> None:
    logs, expected = undisturbed
    for attempt in range(10):
        out = tmp_path / str(attempt)
        line = [*PROGRAM, "run", str(logs), "--model", TEDUSAR, "-o", str(out), "--quiet"]
        if killed_in_the_middle(line, out, "*.parquet", parts, by):
            break
    else:
        pytest.fail("it was always faster")
    assert tree(out) != expected
    done = subprocess.run(line, timeout=120, check=False)
    assert done.returncode == 0
    assert tree(out) == expected


OFTEN = "from robomend_batch import main, unfinished; unfinished.EVERY_S = 0.1; main.main()"
"""The command, which notes how far it is so often that a log of a second is long."""


def test_a_long_log_is_gone_on_with_where_the_run_was_killed(tmp_path: Path) -> None:
    log = long_log(tmp_path / "long.ndjson")
    for attempt in range(10):
        out = tmp_path / str(attempt)
        run = ["run", str(log), "--model", TEDUSAR, "-o", str(out), "--quiet", "--workers", "0"]
        if killed_in_the_middle([sys.executable, "-c", OFTEN, *run], out, "*.state", 1):
            break
    else:
        pytest.fail("it was always faster")
    assert batch_run(out, log) == 0
    assert batch_run(tmp_path / "undisturbed", log) == 0
    assert tree(out) == tree(tmp_path / "undisturbed")
