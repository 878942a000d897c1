"""Worker processes: the same bytes as without them, whatever dies; a log that kills is left out."""

from __future__ import annotations

import fcntl
import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path

import pytest
from tests.robomend_batch.recordings import steady, write
from tests.robomend_batch.running import PROGRAM, TEDUSAR, batch_run, logs, ndjson, tree
from tests.robomend_batch.test_kill import many_logs
from tests.waiting import until

from robomend_batch.starting import started as started_workers
from robomend_batch.starting import usable_cores


def line(out: Path, *given: str | Path) -> list[str]:
    return [*PROGRAM, "run", *map(str, given), "--model", TEDUSAR, "-o", str(out), "--quiet"]


def children(pid: int) -> list[int]:
    """Return the worker processes of a run, but not what keeps account of semaphores for it."""
    with suppress(OSError):
        found = [int(child) for child in Path(f"/proc/{pid}/task/{pid}/children").read_text().split()]
        return [child for child in found if b"spawn_main" in Path(f"/proc/{child}/cmdline").read_bytes()]
    return []


def first_parts(running: subprocess.Popen[bytes], out: Path) -> None:
    """Wait until a run has begun to write."""
    until(
        lambda: running.poll() is not None or len(list((out / "results").glob("*.parquet"))) >= 2,
        "the first parts",
        60,
    )


@pytest.fixture
def started() -> Iterator[list[subprocess.Popen[bytes]]]:
    """Runs that end with the test."""
    running: list[subprocess.Popen[bytes]] = []
    yield running
    for one in running:
        with suppress(ProcessLookupError):
            os.killpg(one.pid, signal.SIGKILL)
        one.wait(60)


def caught(
    folder: Path, outs: Path, workers: int, started: list[subprocess.Popen[bytes]]
) -> tuple[subprocess.Popen[bytes], Path, list[int]]:
    """Start runs until one is caught at work; return it, its folder and its workers, all of it stopped."""
    for attempt in range(10):
        out = outs / str(attempt)
        asked = line(out, folder, "--workers", str(workers))
        running = subprocess.Popen(asked, start_new_session=True)
        started.append(running)
        first_parts(running, out)
        with suppress(ProcessLookupError):
            os.killpg(running.pid, signal.SIGSTOP)
        if (found := children(running.pid)) and not (out / "logs.ndjson").exists():
            return running, out, found
        with suppress(ProcessLookupError):
            os.killpg(running.pid, signal.SIGKILL)
    raise AssertionError("it was always faster")


def test_workers_leave_the_bytes_of_one_process_though_one_of_them_is_killed(
    tmp_path: Path, started: list[subprocess.Popen[bytes]]
) -> None:
    folder = many_logs(tmp_path / "logs")
    assert batch_run(tmp_path / "none", folder) == 0
    running, out, workers = caught(folder, tmp_path, 2, started)
    os.kill(workers[0], signal.SIGKILL)
    os.killpg(running.pid, signal.SIGCONT)
    assert running.wait(100) == 0
    assert tree(out) == tree(tmp_path / "none")


def test_a_log_that_kills_its_worker_three_times_is_left_out_and_named(tmp_path: Path) -> None:
    (tmp_path / "deadly.py").write_text(
        "import os, signal\n"
        "def deadly(value: float) -> bool:\n"
        "    if value > 1:\n"
        f"        open({str(tmp_path / 'deaths')!r}, 'a').write('x')\n"
        "        os.kill(os.getpid(), signal.SIGKILL)\n"
        "    return True\n"
    )
    observers = tmp_path / "observers.yaml"
    observers.write_text('scan: {kind: "deadly.py:deadly", source: "temperature:data"}\n')
    for name, value in (("a", 0.5), ("b", 2.0), ("c", 0.5)):
        write(tmp_path / f"{name}.bag", steady("temperature", 5, 1.0, value))
    given: list[str | Path] = [*(tmp_path / f"{name}.bag" for name in "abc"), "--observers", observers]
    given += ["--workers", "1"]
    asked = line(tmp_path / "out", *given)
    done = subprocess.run(asked, capture_output=True, text=True, timeout=100, check=False)
    assert done.returncode == 3, done.stderr
    states = {Path(log["log"]).name: log["state"] for log in logs(tmp_path / "out")}
    assert states == {"a.bag": "ok", "b.bag": "lost", "c.bag": "ok"}
    assert "it cost 3 workers: killed by SIGKILL" in done.stderr
    assert (tmp_path / "deaths").read_text() == "xxx"


def test_workers_end_with_their_run(tmp_path: Path, started: list[subprocess.Popen[bytes]]) -> None:
    running, _, workers = caught(many_logs(tmp_path / "logs"), tmp_path, 1, started)
    running.kill()
    running.wait(60)
    with suppress(ProcessLookupError):
        os.killpg(running.pid, signal.SIGCONT)
    until(lambda: not any(alive(pid) for pid in workers), "their end")


def alive(pid: int) -> bool:
    with suppress(OSError):
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    return False


def test_two_runs_do_not_work_in_one_folder(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    log, out = ndjson(tmp_path / "a.ndjson", (0, "ok(odom)")), tmp_path / "out"
    out.mkdir()
    held = os.open(out, os.O_RDONLY)
    fcntl.flock(held, fcntl.LOCK_EX)
    assert batch_run(out, log) == 2
    assert "another run is at work in it" in capsys.readouterr().err
    os.close(held)
    assert batch_run(out, log) == 0


@pytest.mark.parametrize("workers", ["0", "1"])
def test_a_full_disk_ends_a_run_that_can_be_gone_on_with(workers: str, tmp_path: Path) -> None:
    folder = many_logs(tmp_path / "logs", lines=500)
    assert batch_run(tmp_path / "whole", folder) == 0
    full = ["prlimit", "--fsize=8000", *line(tmp_path / "out", folder, "--workers", workers)]
    done = subprocess.run(full, capture_output=True, text=True, timeout=100, check=False)
    assert done.returncode == 3, done.stderr
    assert "make room" in done.stderr
    assert batch_run(tmp_path / "out", folder) == 0
    assert tree(tmp_path / "out") == tree(tmp_path / "whole")


def stays_on(pid: int | None, core: int) -> None:
    assert pid is not None
    until(lambda: os.sched_getaffinity(pid) == {core}, f"core {core}")


@pytest.mark.skipif(not hasattr(os, "sched_getaffinity"), reason="processes cannot be kept on a core here")
def test_as_many_workers_as_cores_stay_on_one_each() -> None:
    cores = os.sched_getaffinity(0)
    with started_workers(usable_cores()) as workers:
        for worker in workers:
            stays_on(worker.process.pid, sorted(cores)[worker.place])
        assert len({worker.place for worker in workers}) == len(cores)
    assert os.sched_getaffinity(0) == cores


def test_what_workers_load_is_not_loaded_by_the_run_before_they_are_begun() -> None:
    code = "import sys, robomend_batch.run_command, robomend_batch.starting; print('numpy' in sys.modules)"
    assert subprocess.check_output([sys.executable, "-c", code], text=True, timeout=60) == "False\n"
