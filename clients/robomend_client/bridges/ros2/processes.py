"""The process of a participant, where it runs on this computer: the system knows at once that it ended.

DDS itself notices a killed or frozen process when its lease is over, 10 or 20 s later. A participant says at
which address it takes messages: if that is one of ours, the process is the one that has the port open.
"""

from __future__ import annotations

import os
import socket
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

from robomend_client.bridges.ros2.discovered import Participant

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


def find(participant: Participant) -> Process | None:
    """Return the process of a participant; None if it is on another computer, or nobody's that we may see."""
    if not participant.port or not _is_ours(participant.address):
        return None
    sockets = {f"socket:[{inode}]" for inode in _inodes(participant.port)}
    if not sockets:
        return None
    for pid in (participant.pid, *_all_pids()):
        if pid and _has_open(pid, sockets):
            found = _stat(pid)
            return None if found is None else Process(pid, found[STARTED])
    return None


def _is_ours(address: str) -> bool:
    try:
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
            probe.bind((address, 0))
    except (OSError, ValueError):
        return False
    return True


def _inodes(port: int) -> set[str]:
    """Return what /proc calls the UDP sockets of a port."""
    found = set()
    for table in ("udp", "udp6"):
        with suppress(OSError):
            for line in Path("/proc/net", table).read_text().splitlines()[1:]:
                columns = line.split()
                if int(columns[1].rpartition(":")[2], 16) == port:
                    found.add(columns[9])
    return found


def _all_pids() -> list[int]:
    return [int(name) for name in os.listdir("/proc") if name.isdigit()][:MOST_PROCESSES]


def _has_open(pid: int, sockets: set[str]) -> bool:
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
