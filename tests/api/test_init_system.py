"""An init system is told when requests are answered, and that the event loop turns."""

from __future__ import annotations

import os
import signal
import socket
from functools import partial
from pathlib import Path

import httpx
import pytest
from tests.api.test_process import served
from tests.forked import popen
from tests.waiting import until


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
