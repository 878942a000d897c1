"""An existing Dask cluster: a real scheduler and real workers, as processes, killed by hand."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from typing import Any

import pytest
from tests.robomend_batch.running import PROGRAM, TEDUSAR, batch_run, ndjson, tree
from tests.robomend_batch.test_kill import long_log, many_logs
from tests.waiting import until

from robomend.cli.commands import run
from robomend_batch import cluster
from robomend_batch.commands import batch

DASK = [sys.executable, "-m", "dask"]


@contextmanager
def process(line: list[str], folder: Path, **environment: str) -> Iterator[subprocess.Popen[bytes]]:
    """Run a program of its own process group until the block ends."""
    with (folder / "said.txt").open("ab") as said:
        started = subprocess.Popen(
            line,
            cwd=folder,
            stdout=said,
            stderr=said,
            start_new_session=True,
            env={**os.environ, **environment},
        )
    try:
        yield started
    finally:
        with suppress(ProcessLookupError):
            os.killpg(started.pid, signal.SIGKILL)
        started.wait(60)


class Cluster:
    """A scheduler, and workers to be started and killed."""

    def __init__(self, folder: Path, stack: ExitStack) -> None:
        self.folder = folder
        self._stack = stack
        file = folder / f"scheduler-{len(list(folder.iterdir()))}.json"
        options = ["--scheduler-file", str(file), "--port", "0", "--no-dashboard", "--host", "127.0.0.1"]
        self.scheduler = stack.enter_context(process([*DASK, "scheduler", *options], folder))
        until(file.exists, "the scheduler is up", 60)
        self.address = ""

        def announced() -> bool:
            import json

            with suppress(ValueError):
                self.address = json.loads(file.read_text())["address"]
            return bool(self.address)

        until(announced, "it says where it is", 60)

    def worker(self, **environment: str) -> subprocess.Popen[bytes]:
        """Start a worker; whoever asks the cluster waits for it."""
        options = ["--nthreads", "1", "--no-dashboard", "--no-nanny", "--host", "127.0.0.1"]
        line = [*DASK, "worker", self.address, *options, "--local-directory", str(self.folder)]
        return self._stack.enter_context(process(line, self.folder, **environment))


StartCluster = Callable[[], Cluster]


@pytest.fixture
def begin(tmp_path: Path) -> Iterator[StartCluster]:
    """Start clusters of a test's own."""
    folder = tmp_path / "dask"
    folder.mkdir()
    with ExitStack() as stack:
        yield lambda: Cluster(folder, stack)


@pytest.fixture(scope="module")
def shared(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Cluster]:
    """A cluster of one worker that stays."""
    with ExitStack() as stack:
        cluster = Cluster(tmp_path_factory.mktemp("dask"), stack)
        cluster.worker()
        yield cluster


def arguments(out: Path, logs: Path, address: str) -> list[str]:
    return ["run", str(logs), "--model", TEDUSAR, "--out", str(out), "--quiet", "--scheduler", address]


def parts(out: Path) -> int:
    return len(list((out / "results").glob("*.parquet")))


def test_a_cluster_leaves_what_one_process_leaves(shared: Cluster, tmp_path: Path) -> None:
    logs = many_logs(tmp_path / "logs", 200)
    (logs / "bad.ndjson").write_text("nonsense\n")
    assert batch_run(tmp_path / "here", logs) == 2
    assert run(arguments(tmp_path / "there", logs, shared.address), batch) == 2
    assert tree(tmp_path / "there") == tree(tmp_path / "here")
    assert (
        run(arguments(tmp_path / "there", logs, "tcp://127.0.0.1:1"), batch) == 2
    )  # nothing is left to ask for


def test_a_long_log_comes_back_in_pieces_and_is_the_same(
    shared: Cluster, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    log = long_log(tmp_path / "long.ndjson", 120_000)
    assert batch_run(tmp_path / "here", log) == 0
    monkeypatch.setattr(cluster, "SPAN_S", 0.05)
    assert run(arguments(tmp_path / "there", log, shared.address), batch) == 0
    assert tree(tmp_path / "there") == tree(tmp_path / "here")


def test_a_worker_that_sees_other_files_is_named_with_the_path(
    shared: Cluster, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    log = ndjson(tmp_path / "a.ndjson", (1, "ok(scan)"))
    monkeypatch.setattr("robomend_batch.cluster.stamp", lambda _: (1, 2))  # as this computer sees it
    assert run(arguments(tmp_path / "out", log, shared.address), batch) == 3
    assert f"sees another file {log}: mount it there under the same path" in capsys.readouterr().err


def test_what_cannot_be_reached_says_what_starts_one(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr("robomend_batch.cluster.CONNECT_S", 0.5)
    log = ndjson(tmp_path / "a.ndjson", (1, "ok(scan)"))
    for address in ("tcp://127.0.0.1:1", "nonsense"):
        assert run(arguments(tmp_path / "out", log, address), batch) == 3
        assert "dask scheduler" in capsys.readouterr().err
    assert run([*arguments(tmp_path / "out", log, "tcp://127.0.0.1:1"), "--workers", "2"], batch) == 2


def test_workers_of_another_version_are_refused(
    shared: Cluster, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    asked = ("robomend", "none-such")
    monkeypatch.setattr("robomend_batch.cluster.PACKAGES", asked)
    monkeypatch.setattr("importlib.metadata.version", lambda name: "9.9" if name == "robomend" else "none")
    log = ndjson(tmp_path / "a.ndjson", (1, "ok(scan)"))
    assert run(arguments(tmp_path / "out", log, shared.address), batch) == 3
    assert "robomend 0.1.0 (here 9.9)" in capsys.readouterr().err


def test_killed_workers_and_a_killed_scheduler_lose_only_what_was_in_hand(
    begin: StartCluster, tmp_path: Path
) -> None:
    logs = many_logs(tmp_path / "logs", 6000)  # so long that we see it on the way, on any computer
    assert batch_run(tmp_path / "here", logs) == 0
    out = tmp_path / "there"
    cluster = begin()
    first = cluster.worker()
    line = [*PROGRAM, *arguments(out, logs, cluster.address)]
    with process(line, tmp_path) as going:
        until(lambda: parts(out) >= 2, "the first logs are done", 90, closely=True)
        os.killpg(first.pid, signal.SIGKILL)
        cluster.worker()
        before = parts(out)

        def goes_on() -> bool:
            assert going.poll() is None, (tmp_path / "said.txt").read_text()
            return parts(out) >= min(before + 2, 11)

        until(goes_on, "another worker goes on", 90, closely=True)
        os.killpg(cluster.scheduler.pid, signal.SIGKILL)
        assert going.wait(100) == 3, (tmp_path / "said.txt").read_text()
        said = (tmp_path / "said.txt").read_text()
        assert "the same command goes on" in said
        assert "Traceback" not in said
    kept = {file.name: file.stat().st_mtime_ns for file in (out / "results").glob("*.parquet")}
    assert 4 <= len(kept) < 12
    another = begin()
    another.worker()
    assert run(arguments(out, logs, another.address), batch) == 0
    assert tree(out) == tree(tmp_path / "here")
    again = [name for name, at in kept.items() if (out / "results" / name).stat().st_mtime_ns != at]
    assert len(again) <= 1  # what came back as the scheduler died, and was not noted yet


def test_what_a_worker_had_found_when_it_died_is_found_again_by_another(
    begin: StartCluster, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    log = ndjson(tmp_path / "a.ndjson", (1, "ok(scan)"), (2, "not ok(scan)"))
    assert batch_run(tmp_path / "here", log) == 0
    there = begin()
    workers = [there.worker()]
    states = []
    records = cluster._records

    def after_a_kill(future: Any, *given: Any) -> Any:
        if len(workers) < 2:
            os.killpg(workers[0].pid, signal.SIGKILL)
            until(lambda: future.status == "lost", "the scheduler has noticed", 60)
            workers.append(there.worker())
        states.append(future.status)
        return records(future, *given)

    monkeypatch.setattr(cluster, "_records", after_a_kill)
    assert run(arguments(tmp_path / "there", log, there.address), batch) == 0
    assert states == ["lost", "finished"]
    assert tree(tmp_path / "there") == tree(tmp_path / "here")


@pytest.mark.parametrize("for_ever", [False, True])
def test_a_frozen_worker_is_asked_again_for_what_it_found_and_not_for_ever(
    begin: StartCluster,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    for_ever: bool,
) -> None:
    log = ndjson(tmp_path / "a.ndjson", (1, "ok(scan)"), (2, "not ok(scan)"))
    assert batch_run(tmp_path / "here", log) == 0
    there = begin()
    worker = there.worker()
    asked = []
    records = cluster._records

    def of_a_frozen_one(*given: Any) -> Any:
        asked.append(given)
        if len(asked) == 1:
            os.killpg(worker.pid, signal.SIGSTOP)
            monkeypatch.setattr(cluster, "CONNECT_S", 1.0)
        elif not for_ever:
            os.killpg(worker.pid, signal.SIGCONT)
        return records(*given)

    monkeypatch.setattr(cluster, "_records", of_a_frozen_one)
    assert run(arguments(tmp_path / "there", log, there.address), batch) == (3 if for_ever else 0)
    if for_ever:
        assert len(asked) == cluster.TRIES
        assert "no worker hands over what became of" in capsys.readouterr().err
    else:
        assert tree(tmp_path / "there") == tree(tmp_path / "here")


def test_a_scheduler_that_has_lost_its_only_worker_is_given_up(
    begin: StartCluster, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    there = begin()
    worker = there.worker()
    check = cluster._check_versions

    def last_seen(*given: Any) -> None:
        check(*given)
        os.killpg(worker.pid, signal.SIGKILL)

    monkeypatch.setattr(cluster, "_check_versions", last_seen)
    monkeypatch.setattr(cluster, "WORKERS_S", 1.0)
    log = ndjson(tmp_path / "a.ndjson", (1, "ok(scan)"))
    assert run(arguments(tmp_path / "out", log, there.address), batch) == 3
    assert "has named no worker for 1 s: start one" in capsys.readouterr().err
