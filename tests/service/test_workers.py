"""`robomend serve --workers`: several processes on one port; one dies, the parent dies, a signal ends all."""

from __future__ import annotations

import os
import signal
import subprocess
from pathlib import Path

import httpx
import pytest
from tests.api.conftest import TEDUSAR
from tests.api.test_process import alive, command, served, started, workers_of
from tests.forked import popen
from tests.waiting import until


def instances(data: Path) -> list[int]:
    """Return the processes that share the work of a service; whoever their parent is."""
    found = []
    for line in Path("/proc").glob("[0-9]*/cmdline"):
        try:
            words = line.read_text().split("\0")
        except OSError:
            continue  # it ended meanwhile
        if str(data) in words and "--parent-fd" in words:
            found.append(int(line.parent.name))
    return sorted(found)


def refusal(folder: Path, *arguments: str) -> tuple[int, str]:
    """Return the exit code of a command that is refused, and what it says."""
    with (folder / "said").open("w") as said:
        process = popen(command(*arguments), stdout=subprocess.DEVNULL, stderr=said)
        return process.wait(60), (folder / "said").read_text()


def test_a_worker_that_dies_is_replaced_and_nothing_acknowledged_is_lost(tmp_path: Path) -> None:
    with served(tmp_path, "--workers", "2") as (process, url):
        first = instances(tmp_path)
        assert len(first) == 2
        with httpx.Client(base_url=f"{url}/api/v1", timeout=20) as http:
            http.put("/models/tedusar", json={"source": TEDUSAR})
            assert http.put("/robots/r1", json={"model": "tedusar"}).status_code == 201
        accepted = 0
        for number in range(40):
            if number == 20:
                os.kill(first[0], signal.SIGKILL)
            sentence = "ok(map)" if number % 2 else "not ok(map)"
            try:  # each on a connection of its own, so that both workers are asked
                answer = httpx.post(
                    f"{url}/api/v1/robots/r1/observations", json={"observations": [sentence]}, timeout=20
                )
            except httpx.TransportError:
                continue  # it was with the one that died
            assert answer.status_code == 200
            accepted += 1
        assert accepted >= 38
        until(lambda: len(instances(tmp_path)) == 2, "nobody took the place of the dead worker")
        assert set(instances(tmp_path)) != set(first)
        found = httpx.get(f"{url}/api/v1/robots/r1/observations", timeout=20).json()
        assert accepted <= found["revision"] <= 40
        assert process.poll() is None


@pytest.mark.timeout(120)
def test_a_worker_that_hangs_is_killed_and_replaced(tmp_path: Path) -> None:
    with served(tmp_path, "--workers", "2") as (_, url):
        first = instances(tmp_path)
        with httpx.Client(base_url=f"{url}/api/v1", timeout=60) as http:
            http.put("/models/tedusar", json={"source": TEDUSAR})
            assert http.put("/robots/r1", json={"model": "tedusar"}).status_code == 201
        os.kill(first[0], signal.SIGSTOP)  # whatever it holds: a connection, a robot, the database's lock
        until(lambda: not alive(first[0]), "the worker that hangs was not killed", 60.0)
        until(lambda: len(instances(tmp_path)) == 2, "nobody took its place", 60.0)
        assert first[1] in instances(tmp_path)  # the other is as it was
        said = httpx.post(
            f"{url}/api/v1/robots/r1/observations", json={"observations": ["not ok(map)"]}, timeout=60
        )
        assert said.json()["revision"] == 1
        assert "worker hangs" in (tmp_path / "log").read_text()


def test_it_is_announced_once_and_a_signal_ends_all_workers_in_order_with_open_streams(
    tmp_path: Path,
) -> None:
    with served(tmp_path, "--workers", "2") as (process, url):
        workers = instances(tmp_path)
        assert httpx.get(f"{url}/readyz", timeout=20).status_code == 200
        with httpx.stream("GET", f"{url}/api/v1/events", timeout=20) as stream:
            lines = stream.iter_lines()
            next(lines)
            process.send_signal(signal.SIGTERM)
            assert list(lines)[-1] == ""
        assert process.wait(20) == 0
        assert process.stdout is not None
        assert process.stdout.read() == "", "it was announced once"
        assert not any(map(alive, workers))


def test_workers_do_not_outlive_their_parent(tmp_path: Path) -> None:
    with started(tmp_path, "--workers", "2") as (process, _):  # the kernel knows of parents, not of templates
        workers = workers_of(process.pid)
        family = [*workers, *(pid for worker in workers for pid in workers_of(worker))]
        os.kill(workers[0], signal.SIGSTOP)  # it cannot notice anything by itself
        os.kill(process.pid, signal.SIGKILL)
        process.wait(10)
        until(lambda: not any(map(alive, family)), "a worker outlived its parent")


def test_workers_that_cannot_start_end_the_parent_with_their_reason(tmp_path: Path) -> None:
    arguments = ("serve", "--port", "0", "--host", "0.0.0.0", "--workers", "2", "--data", str(tmp_path))
    code, said = refusal(tmp_path, *arguments)
    assert code == 2
    assert "robomend keys create" in said


def test_a_port_that_is_taken_is_said_to_be(tmp_path: Path) -> None:
    with served(tmp_path) as (_, url):
        port = url.rsplit(":", 1)[1]
        other = tmp_path / "other"
        arguments = ("serve", "--port", port, "--workers", "2", "--data", str(other))
        code, said = refusal(tmp_path, *arguments)
    assert code == 2
    assert "another service" in said
