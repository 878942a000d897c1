"""Processes of this computer: who has a connection open, and whether it works.

The network notices a killed or frozen process when its lease is over, 10 s and more later; the system knows
at once.
"""

from __future__ import annotations

import os
import socket
from collections.abc import Callable, Collection, Iterable, Iterator
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

MOST_PROCESSES = 4096
STATE, STARTED = 0, 19
"""Places in /proc/PID/stat, after the name."""


@dataclass(frozen=True)
class Process:
    """A process; its number may be given to another one when it has ended."""

    pid: int
    started: str

    def works(self) -> bool:
        """Return whether it is there, and neither stopped nor dead."""
        found = _stat(self.pid)
        return found is not None and found[STARTED] == self.started and found[STATE] not in "TtZX"

    def why(self) -> dict[str, str]:
        """Return why it does not work, as the node observer takes it."""
        found = _stat(self.pid)
        if found is None or found[STARTED] != self.started or found[STATE] not in "Tt":
            return {"why": f"its process {self.pid} has ended", "symptom": "ended"}
        stopped = "traced by a debugger" if found[STATE] == "t" else "stopped by a signal (SIGSTOP)"
        return {"why": f"its process {self.pid} is {stopped}", "symptom": "halted"}


def has_open(ports: Callable[[int, int], bool], tables: Iterable[str], likely: int = 0) -> Process | None:
    """Return the process that has a socket with these ports open; None: nobody that we may see.

    Args:
        ports: says of a local and a remote port whether the socket is meant.
        tables: of /proc/net: udp, tcp, …
        likely: a process that is asked first.
    """
    sockets = {f"socket:[{inode}]" for inode in _inodes(ports, tables)}
    if not sockets:
        return None
    for pid in (likely, *_all_pids()):
        if pid and _holds(pid, sockets):
            found = _stat(pid)
            return None if found is None else Process(pid, found[STARTED])
    return None


def has_file_open(file: Path) -> str:
    """Return which process has a file open, for people; empty: nobody that we may see."""
    named = {str(file.resolve())}
    for pid in _all_pids():
        if _holds(pid, named):
            with suppress(OSError):
                return f"{Path(f'/proc/{pid}/comm').read_text().strip()} ({pid})"
    return ""


def is_ours(address: str) -> bool:
    """Return whether an address, as a number, is one of this computer's."""
    family = socket.AF_INET6 if ":" in address else socket.AF_INET
    try:
        with socket.socket(family, socket.SOCK_DGRAM) as probe:
            probe.bind((address, 0))
    except (OSError, ValueError):
        return False
    return True


def _inodes(ports: Callable[[int, int], bool], tables: Iterable[str]) -> Iterator[str]:
    """Yield what /proc calls the sockets that are meant."""
    for table in tables:
        with suppress(OSError):
            for line in Path("/proc/net", table).read_text().splitlines()[1:]:
                columns = line.split()
                local, remote = (int(address.rpartition(":")[2], 16) for address in columns[1:3])
                if ports(local, remote):
                    yield columns[9]


def _all_pids() -> list[int]:
    return [int(name) for name in os.listdir("/proc") if name.isdigit()][:MOST_PROCESSES]


def _holds(pid: int, sockets: Collection[str]) -> bool:
    try:
        names = os.listdir(f"/proc/{pid}/fd")
    except OSError:  # it has ended, or it is somebody else's
        return False
    for name in names:
        with suppress(OSError):
            if os.readlink(f"/proc/{pid}/fd/{name}") in sockets:
                return True
    return False


def _stat(pid: int) -> list[str] | None:
    try:
        text = Path(f"/proc/{pid}/stat").read_text()
    except OSError:
        return None
    return text.rpartition(")")[2].split()
