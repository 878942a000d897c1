"""`robomend serve` as a process: announced, refused, ended, killed."""

from __future__ import annotations

import json
import os
import re
import resource
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from functools import partial
from pathlib import Path
from typing import Any

import httpx
import pytest
from tests.api.conftest import TEDUSAR
from tests.forked import popen
from tests.waiting import until

from robomend.cli.serve import OPEN_FILES


def command(*arguments: str) -> list[str]:
    """Return the command line of one robomend command."""
    return [sys.executable, "-c", "from robomend.cli.main import main; main()", *arguments]


@contextmanager
def served(
    data: Path, *arguments: str, start: Callable[..., Any] = popen
) -> Iterator[tuple[subprocess.Popen[str], str]]:
    """Run the service and yield its process and URL; `start` as in tests/forked.py."""
    log = (data / "log").open("w")
    process = start(
        command("serve", "--port", "0", "--announce", "--data", str(data), *arguments),
        stdout=subprocess.PIPE,
        stderr=log,
        text=True,
    )
    try:
        assert process.stdout is not None
        line = process.stdout.readline()
        assert line, (data / "log").read_text()
        yield process, json.loads(line)["url"]
    finally:
        process.kill()
        process.wait(60)
        log.close()


started = partial(served, start=subprocess.Popen)
"""The same from nothing: what is tested here."""


def told(folder: Path, *arguments: str, **environment: str) -> tuple[int, str, str]:
    """Run a command that ends; return its exit code and what it printed and told."""
    with (folder / "out").open("w+") as out, (folder / "err").open("w+") as err:
        ran = popen(command(*arguments), stdout=out, stderr=err, env={**os.environ, **environment})
        code = ran.wait(300)
        return code, (folder / "out").read_text(), (folder / "err").read_text()


def workers_of(pid: int) -> list[int]:
    """Return the processes whose parent is `pid`."""
    found = []
    for stat in Path("/proc").glob("[0-9]*/stat"):
        try:
            fields = stat.read_text().rpartition(")")[2].split()
        except OSError:
            continue  # it ended meanwhile
        if int(fields[1]) == pid:
            found.append(int(stat.parent.name))
    return found


def alive(pid: int) -> bool:
    """Return whether a process runs and is no zombie."""
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except OSError:
        return False


def test_a_signal_ends_it_in_order_with_open_streams(tmp_path: Path) -> None:
    with (
        started(tmp_path) as (process, url),
        httpx.stream("GET", f"{url}/api/v1/events", timeout=60) as stream,
    ):
        lines = stream.iter_lines()
        next(lines)
        process.send_signal(signal.SIGTERM)
        assert list(lines)[-1] == ""  # the stream was ended, not broken
        assert process.wait(60) == 0


def test_a_kill_ends_its_workers_too_and_loses_nothing(tmp_path: Path) -> None:
    with started(tmp_path) as (process, url), httpx.Client(base_url=f"{url}/api/v1", timeout=60) as http:
        http.put("/models/tedusar", json={"source": TEDUSAR})
        http.put("/robots/r1", json={"model": "tedusar"})
        question = {"model": "tedusar", "observations": ["not ok(scan)"]}
        assert http.post("/diagnoses", json=question).status_code == 200
        workers = workers_of(process.pid)
        assert workers
        for number in range(20):
            sentence = "ok(map)" if number % 2 else "not ok(map)"
            answer = http.post("/robots/r1/observations", json={"observations": [sentence]})
            assert answer.status_code == 200
        os.kill(process.pid, signal.SIGKILL)
        process.wait(60)
        until(lambda: not any(map(alive, workers)), "no worker outlives the service")
    with served(tmp_path) as (process, url):
        found = httpx.get(f"{url}/api/v1/robots/r1", timeout=60).json()
        assert found["revision"] == 20
        current = httpx.get(f"{url}/api/v1/robots/r1/diagnosis?after=19&wait_s=60", timeout=90).json()
        assert current["result"]["diagnoses"][0]["bad"] == []


def test_it_does_not_listen_to_others_without_a_key(tmp_path: Path) -> None:
    arguments = ("serve", "--port", "0", "--host", "0.0.0.0", "--data", str(tmp_path), "--announce")
    code, _, refusal = told(tmp_path, *arguments)
    assert code == 2
    assert "robomend keys create" in refusal
    key = told(tmp_path, "keys", "create", "--role", "viewer", "--data", str(tmp_path))[1].strip()
    with served(tmp_path, "--host", "0.0.0.0") as (_, url):
        assert httpx.get(f"{url}/api/v1/robots", timeout=60).status_code == 401
        head = {"Authorization": f"Bearer {key}"}
        assert httpx.get(f"{url}/api/v1/robots", headers=head, timeout=60).status_code == 200
        stopped = httpx.post(f"{url}/api/v1/stop", headers=head, json={}, timeout=60)
        assert stopped.status_code == 403
    assert key not in (tmp_path / "log").read_text()


def test_config_tells_where_each_value_comes_from(tmp_path: Path) -> None:
    file = tmp_path / "robomend.yaml"
    file.write_text("port: 1234\nlog_level: debug\ndatabase: postgresql://u:secret@h/d\n")
    asked = ("config", "--config", str(file), "--data", str(tmp_path), "--format", "json")
    _, shown, _ = told(tmp_path, *asked, ROBOMEND_PORT="4321", ROBOMEND_DATA="elsewhere")
    table = json.loads(shown)
    assert table["port"] == {"value": 4321, "source": "environment ROBOMEND_PORT"}
    assert table["log_level"] == {"value": "debug", "source": str(file)}
    assert table["data"] == {"value": str(tmp_path), "source": "flag"}
    assert table["max_streams"]["source"] == "default"
    assert "secret" not in shown


def test_workers_are_refused_with_what_takes_their_place(tmp_path: Path) -> None:
    file = tmp_path / "robomend.yaml"
    file.write_text("workers: 2\n")
    cases: tuple[tuple[list[str], dict[str, str]], ...] = (
        (["--workers", "2"], {}),
        (["--config", str(file)], {}),
        ([], {"ROBOMEND_WORKERS": "2"}),
    )
    for arguments, environment in cases:
        code, _, refusal = told(tmp_path, "serve", "--data", str(tmp_path), *arguments, **environment)
        assert code == 2
        assert "robomend@.service" in refusal


def test_a_port_that_is_taken_is_said_to_be(tmp_path: Path) -> None:
    with served(tmp_path) as (_, url):
        port = url.rsplit(":", 1)[1]
        code, _, refusal = told(tmp_path, "serve", "--port", port, "--data", str(tmp_path / "other"))
    assert code == 2
    assert "another service" in refusal


def test_it_takes_more_connections_than_the_usual_soft_limit_allows(tmp_path: Path) -> None:
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    resource.setrlimit(resource.RLIMIT_NOFILE, (min(512, hard), hard))
    try:
        with started(tmp_path) as (process, _):
            found = resource.prlimit(process.pid, resource.RLIMIT_NOFILE)
    finally:
        resource.setrlimit(resource.RLIMIT_NOFILE, (soft, hard))
    wanted = OPEN_FILES if hard == resource.RLIM_INFINITY else min(OPEN_FILES, hard)
    assert found == (wanted, hard)


SILENT = 1500
"""More than a process with 1024 descriptors can have open."""


@pytest.mark.parametrize(
    "says",
    [
        pytest.param(b"", id="nothing"),
        pytest.param(b"GET /heal", id="ours", marks=pytest.mark.long),
        pytest.param(b"GET /api/v1/robots HTTP/1.1\r\n", id="head"),
    ],
)
def test_a_stop_is_taken_at_the_limit_of_descriptors(tmp_path: Path, says: bytes) -> None:
    """Whoever fills it with connections that say nothing, or begin, keeps nobody from the red button."""
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    limited = partial(
        subprocess.Popen, preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_NOFILE, (1024, 1024))
    )
    resource.setrlimit(resource.RLIMIT_NOFILE, (hard, hard))
    try:
        with served(tmp_path, start=limited) as (_, url), ExitStack() as idle:
            address = ("127.0.0.1", int(url.rsplit(":", 1)[1]))
            taken: list[float] = []
            for number in range(SILENT):
                one = idle.enter_context(socket.create_connection(address, timeout=60))
                one.sendall(says)
                if number % 500 == 499:
                    began = time.monotonic()
                    stopped = httpx.post(f"{url}/api/v1/stop", json={"reason": str(number)}, timeout=60)
                    assert stopped.json()["active"]
                    assert httpx.get(f"{url}/healthz", timeout=60).status_code == 200
                    until(lambda: httpx.get(f"{url}/readyz", timeout=60).status_code == 200, "ready", 60)
                    taken.append(time.monotonic() - began)
            print("seconds:", taken)
            # Those that were silent for the longest made room, and whoever comes is answered.
            until(
                lambda: httpx.get(f"{url}/version-info", timeout=60).status_code == 200, "no room is made", 60
            )
            assert "cannot accept" not in (tmp_path / "log").read_text()
    finally:
        resource.setrlimit(resource.RLIMIT_NOFILE, (soft, hard))


def test_whoever_sends_what_is_no_request_fills_no_log(tmp_path: Path) -> None:
    wires = {
        "Invalid HTTP request": b"no request\r\n\r\n",
        "Unsupported upgrade": (
            b"GET / HTTP/1.1\r\nHost: localhost\r\nConnection: close, upgrade\r\nUpgrade: h2c\r\n\r\n"
        ),
    }
    with served(tmp_path) as (_, url):
        address = ("127.0.0.1", int(url.rsplit(":", 1)[1]))

        def send(wire: bytes) -> None:
            with socket.create_connection(address, timeout=60) as connection:
                connection.sendall(wire)
                assert connection.recv(100).startswith(b"HTTP/1.1 ")

        for _ in range(300):
            for wire in wires.values():
                send(wire)
        time.sleep(1.1)  # the next of a kind, in a later second, says how many were left out
        for wire in wires.values():
            send(wire)
    lines = [json.loads(line) for line in (tmp_path / "log").read_text().splitlines()]
    seconds = {line["timestamp"][:19] for line in lines}
    for text in wires:
        written = [line["event"] for line in lines if text in line["event"]]
        assert len(written) <= 10 * (len(seconds) + 1)
        left_out = sum(int(found[1]) for event in written if (found := re.search(r"\((\d+) more", event)))
        assert len(written) + left_out == 301


def test_the_watchdog_hears_of_a_service_that_turns(tmp_path: Path) -> None:
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as line:
        line.bind(str(tmp_path / "s"))
        line.settimeout(60)
        environment = {**os.environ, "NOTIFY_SOCKET": str(tmp_path / "s"), "WATCHDOG_USEC": "400000"}
        with served(tmp_path, start=partial(popen, env=environment)) as (process, url):
            assert line.recv(100) == b"READY=1"
            assert [line.recv(100) for _ in range(3)] == [b"WATCHDOG=1"] * 3
            assert httpx.get(f"{url}/healthz", timeout=60).status_code == 200
            _halt(process.pid)
            line.setblocking(False)
            _drain(line)
            with pytest.raises(BlockingIOError):  # whoever stands still says nothing more
                line.recv(100)


def test_a_log_that_nobody_reads_any_more_holds_up_nobody(tmp_path: Path) -> None:
    """Whoever reads its stderr has ended; that its loop was held is a line that cannot be written."""
    read, write = os.pipe()
    announced = command("serve", "--port", "0", "--announce", "--data", str(tmp_path))
    process = popen(announced, stdout=subprocess.PIPE, stderr=write, text=True)
    os.close(write)
    try:
        url = json.loads(process.stdout.readline())["url"]
        os.close(read)

        def ticks() -> float:
            lines = httpx.get(f"{url}/metrics", timeout=60).text.splitlines()
            name = "robomend_loop_delay_seconds_count "
            return float(next(line for line in lines if line.startswith(name)).split()[1])

        before = ticks()
        _halt(process.pid)
        time.sleep(0.5)  # time itself: so long its loop is held
        os.kill(process.pid, signal.SIGCONT)
        until(lambda: ticks() > before + 20, "its loop is watched on")
        assert httpx.get(f"{url}/api/v1/robots", timeout=60).status_code == 200
    finally:
        process.kill()
        process.wait(60)
        process.stdout.close()


def _halt(pid: int) -> None:
    """Stop a process, and return when it stands still."""
    os.kill(pid, signal.SIGSTOP)
    state = Path(f"/proc/{pid}/stat")
    until(lambda: state.read_text().rpartition(")")[2].split()[0] == "T", "it runs on")


def _drain(line: socket.socket) -> None:
    """Read what was said before."""
    try:
        while line.recv(100):
            pass
    except BlockingIOError:
        pass
