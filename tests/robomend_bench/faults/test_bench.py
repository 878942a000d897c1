"""Many trials side by side: what dies is told, and the rest goes on."""

from __future__ import annotations

import os
import signal
import sys
from contextlib import suppress
from pathlib import Path

from tests.terminal import Terminal
from tests.waiting import until


def test_ctrl_c_does_not_wait_for_a_service_that_takes_long_to_start(tmp_path: Path) -> None:
    where = {"PATH": f"{Path(sys.executable).parent}:{os.environ['PATH']}"}
    with Terminal("robomend-bench faults --trials 1 --stretches 0 --load 1", tmp_path, where) as begun:
        until(lambda: services(begun), "the service is being started", 120)
        for process in services(begun):
            os.kill(process, signal.SIGSTOP)  # as good as a computer that leaves it no processor time
        begun.ends_by_ctrl_c()


def services(begun: Terminal) -> list[int]:
    """Return the processes of `robomend serve` in a terminal."""
    found = []
    for process in begun.processes():
        with suppress(OSError):
            if b"--announce" in Path(f"/proc/{process}/cmdline").read_bytes():
                found.append(process)
    return found
