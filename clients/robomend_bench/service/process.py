"""`robomend serve` as a process of its own, on a free port and a folder that goes away; what the kernel says
of processes, and percentiles.
"""

from __future__ import annotations

import json
import math
import os
import signal
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path

START_S = 300.0
"""It takes two; this is for a process that others leave next to no processor time."""


@dataclass
class Served:
    """A running service."""

    process: subprocess.Popen[str]
    url: str
    ready_s: float  # from its start to the announcement
    data: Path

    @property
    def pid(self) -> int:
        """The process that answers."""
        return self.process.pid

    def stop(self) -> int:
        """Ask it to end, wait, and return its exit code."""
        self.process.send_signal(signal.SIGTERM)
        return self.process.wait(30)

    def kill(self) -> None:
        """End it as a power cut would."""
        self.process.kill()
        self.process.wait(30)


class NotReady(Exception):
    """The service ended, or said nothing in time; the text has its log."""


def start(
    data: Path,
    arguments: Sequence[str] = (),
    *,
    begun: Callable[[subprocess.Popen[str]], None] = lambda process: None,
) -> Served:
    """Start the service on `data` and return when it has announced itself.

    `begun` is called with its process before that: whoever kills it meanwhile need not wait for it.

    Raises:
        NotReady: it did not.
    """
    program = [sys.executable, "-c", "from robomend.cli.main import main; main()"]
    log = (data / "log").open("a")
    began = time.perf_counter()
    with log:
        process = subprocess.Popen(
            [*program, "serve", "--port", "0", "--announce", "--data", str(data), *arguments],
            stdout=subprocess.PIPE,
            stderr=log,
            text=True,
            process_group=0,  # Ctrl-C is for the bench, which ends it
        )
    assert process.stdout is not None
    late = threading.Timer(START_S, process.kill)
    late.start()
    line = ""
    try:
        begun(process)
        line = process.stdout.readline()
    finally:
        late.cancel()
        if not line:  # it ended, was ended as it said nothing, or Ctrl-C came
            process.kill()
            process.wait(30)
            process.stdout.close()
    ready_s = time.perf_counter() - began
    if not line:
        raise NotReady((data / "log").read_text()[-2000:])
    return Served(process, json.loads(line)["url"], ready_s, data)


@contextmanager
def served(
    arguments: Sequence[str] = (), data: Path | None = None, *, orderly: bool = False
) -> Iterator[Served]:
    """Run a service; it is gone afterwards, and its folder too unless it was given.

    `orderly`: it is asked to end, so that the programs of its actions end before it; killed, it leaves them.
    """
    with tempfile.TemporaryDirectory(prefix="robomend-bench-") as folder:
        service = start(data or Path(folder), arguments)
        try:
            yield service
        finally:
            if orderly:
                with suppress(subprocess.TimeoutExpired):
                    service.stop()
            service.process.kill()
            service.process.wait(30)
            assert service.process.stdout is not None
            service.process.stdout.close()


def model_text() -> str:
    """Return the model of the measurements, the paper's robot."""
    from robomend.resources import resource

    return resource("examples", "tedusar.yaml").read_text(encoding="utf-8")


MB = 1e6


def latency(seconds: Sequence[float]) -> dict[str, float | None]:
    """Return the distribution of these durations, in milliseconds."""
    ordered = sorted(seconds)
    shares = {"p50_ms": 0.5, "p90_ms": 0.9, "p99_ms": 0.99, "max_ms": 1.0}
    taken = {name: _percentile_ms(ordered, share) for name, share in shares.items()}
    return {"count": len(ordered), **taken}


def _percentile_ms(ordered: Sequence[float], share: float) -> float | None:
    """Return the smallest value that at least `share` of all do not exceed (nearest rank); None of none."""
    if not ordered:
        return None
    return round(1e3 * ordered[max(0, math.ceil(share * len(ordered)) - 1)], 2)


def memory_mb(pid: int) -> float:
    """Return the resident memory of one process, shared pages included."""
    for line in Path(f"/proc/{pid}/status").read_text().splitlines():
        if line.startswith("VmRSS:"):
            return int(line.split()[1]) * 1024 / MB
    return 0.0  # a process that is ending has none


def cpu_s(pid: int) -> float:
    """Return the processor time that a process has taken, its threads included."""
    fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def children(pid: int) -> list[int]:
    """Return the processes that this one has started and that still run."""
    found = []
    for stat in Path("/proc").glob("[0-9]*/stat"):
        try:
            fields = stat.read_text().rpartition(")")[2].split()
        except OSError:
            continue  # it ended meanwhile
        if int(fields[1]) == pid:
            found.append(int(stat.parent.name))
    return sorted(found)
