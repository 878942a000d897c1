"""A robomend-agent as a process of its own, for tests that kill it."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

from tests.clients.service_double import eventually
from tests.forked import popen

SLEEPER = [sys.executable, "-c", "import time; time.sleep(1000)"]
WRITES_PID = "import os, sys, time; open(sys.argv[1], 'w').write(str(os.getpid())); "
DEAF = "import signal; signal.signal(signal.SIGTERM, signal.SIG_IGN); " + WRITES_PID + "time.sleep(1000)"
"""The beginning of a program that writes its number into the file given to it; one that ignores SIGTERM."""


def config(tmp_path: Path, url: str, processes: dict[str, Any], **more: Any) -> Path:
    """Write an agent's configuration (JSON is YAML) and return the file."""
    file = tmp_path / "agent.yaml"
    file.write_text(
        json.dumps(
            {
                "robot": "tedusar",
                "agent": "onboard",
                "service": {"url": url},
                "state_dir": str(tmp_path / "state"),
                "bus": {"listen": "tcp:127.0.0.1:0"},
                "report": {"heartbeat_s": 0.5, "lifetime_s": 2.5},
                "processes": processes,
                **more,
            }
        )
    )
    return file


@contextmanager
def agent(file: Path, environment: Mapping[str, str] | None = None) -> Iterator[subprocess.Popen[bytes]]:
    """Run the agent; SIGTERM at the end, and what it says goes to a file beside its configuration."""
    with (file.parent / "agent.log").open("ab") as log:
        command = [sys.executable, "-m", "robomend_client.agent.main", "--verbose", str(file)]
        process = popen(command, stderr=log, env=environment)
        try:
            yield process
        finally:
            if process.poll() is None:
                process.send_signal(signal.SIGTERM)
                process.wait(60)  # it has a lot to end, on a busy computer


def _state(pid: int) -> bytes:
    """Return the letter of a process's state; nothing where there is no such process."""
    try:
        return Path(f"/proc/{pid}/stat").read_bytes().rpartition(b")")[2].split()[0]
    except OSError:
        return b""


def alive(pid: int) -> bool:
    """Return whether a process exists and is no zombie."""
    return _state(pid) not in (b"", b"Z", b"X")


def halted(pid: int) -> bool:
    """Return whether a process is stopped by a signal."""
    return _state(pid) == b"T"


def pid_file(tmp_path: Path, name: str) -> int:
    """Return the pid that a test's process writes, once it has."""
    written = [""]

    def read() -> str:  # once: a process that is started anew empties it before it writes
        with suppress(FileNotFoundError):
            written[0] = (tmp_path / name).read_text()
        return written[0]

    eventually(read, f"a pid in {name}")
    return int(written[0])


def marked(mark: str) -> list[int]:
    """Return the live processes whose command line holds `mark`."""
    found = []
    for entry in Path("/proc").iterdir():
        if entry.name.isdigit() and int(entry.name) != os.getpid():
            try:
                command = (entry / "cmdline").read_bytes()
            except OSError:
                continue
            if mark.encode() in command and alive(int(entry.name)):
                found.append(int(entry.name))
    return found
