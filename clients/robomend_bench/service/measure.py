"""Percentiles, and what the kernel says of a process: its memory, its CPU time, its children."""

from __future__ import annotations

import math
import os
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

MB = 1e6


@dataclass(frozen=True, slots=True)
class Latency:
    """A distribution in milliseconds."""

    count: int
    p50_ms: float
    p90_ms: float
    p99_ms: float
    max_ms: float

    @classmethod
    def of(cls, seconds: Sequence[float]) -> Latency:
        """Return the distribution of these durations."""
        ordered = sorted(seconds)
        p50, p90, p99 = (round(1e3 * percentile(ordered, share), 2) for share in (0.5, 0.9, 0.99))
        return cls(len(ordered), p50, p90, p99, round(1e3 * percentile(ordered, 1.0), 2))

    def __str__(self) -> str:
        p50, p90, p99, most = (f"{ms:.1f}" for ms in (self.p50_ms, self.p90_ms, self.p99_ms, self.max_ms))
        return f"p50 {p50} · p90 {p90} · p99 {p99} · max {most} ms"


def percentile(ordered: Sequence[float], share: float) -> float:
    """Return the smallest value that at least `share` of all do not exceed (nearest rank); NaN for none."""
    if not ordered:
        return math.nan
    return ordered[max(0, math.ceil(share * len(ordered)) - 1)]


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


def load_of_others() -> float:
    """Return the one-minute load of the machine: above its cores, nobody's latency is the service's own."""
    return os.getloadavg()[0]
