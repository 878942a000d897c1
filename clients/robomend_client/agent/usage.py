"""What processes and the computer use: the sources `processes:CPU(node)`, `processes:Mem(node)`,
`host:CPU`, `host:Mem`, `host:Wait`.

CPU of a node is the part of one core that its process and all that it started have used since the last
look, Mem the part of the computer's memory that they hold; of the host, the part of all cores and of all
memory. A node that does not run has neither. Wait is the part of the time in which some process could have
run and had no processor: what is late then is late for that. A kernel without pressure stall information
says nothing of it.

Source: proc(5), the fields of /proc/PID/stat and /proc/stat; /proc/pressure/cpu, "some".
"""

from __future__ import annotations

import os
import re
import time
from collections.abc import Iterable, Mapping
from pathlib import Path

from robomend_client.agent.feeds import split

PERIOD_S = 1.0
"""How often they are measured."""

TICKS = os.sysconf("SC_CLK_TCK")
PAGE = os.sysconf("SC_PAGE_SIZE")
FIELD = re.compile(r"(CPU|Mem|Wait)(?:\((?P<node>.+)\))?\Z")


class Usage:
    """Measures what observers want to know."""

    def __init__(self, sources: Iterable[str], nodes: Iterable[str], proc: Path = Path("/proc")) -> None:
        """
        Raises:
            ValueError: a source is none of these, or names a node that this agent does not have.
        """
        self._proc = proc
        self._wanted: dict[str, tuple[str, str | None]] = {}  # source -> CPU or Mem, node
        known = set(nodes)
        for source in sources:
            topic, field = split(source)
            found = FIELD.match(field)
            node = found and found["node"]
            if (
                found is None
                or (topic == "host") is not (node is None)
                or (found[1] == "Wait" and node is not None)
            ):
                raise ValueError(
                    f"{source} is no source; write processes:CPU(NODE), host:CPU, Mem of either, or host:Wait"
                )
            if node is not None and node not in known:
                raise ValueError(f"{source}: the agent has no process {node}")
            self._wanted[source] = (found[1], node)
        self._before: dict[str | None, tuple[float, float]] = {}  # node -> seconds of processor, when
        self._waited: tuple[float, float] | None = None  # seconds in which some process waited, when

    @property
    def wanted(self) -> bool:
        return bool(self._wanted)

    def measure(self, leaders: Mapping[str, int]) -> dict[str, float]:
        """Return source -> value; `leaders` are the processes of the nodes that run."""
        groups = self._groups(set(leaders.values())) if any(n for _, n in self._wanted.values()) else {}
        now = time.monotonic()
        cpu: dict[str | None, float | None] = {}
        found = {}
        for source, (what, node) in self._wanted.items():
            if node is not None and leaders.get(node) not in groups:
                self._before.pop(node, None)
                continue
            if what == "Wait":
                part = self._waiting(now)
                if part is not None:
                    found[source] = part
                continue
            if what == "Mem":
                value = self._host_memory() if node is None else self._memory(groups[leaders[node]][1])
            else:
                if node not in cpu:
                    used_s = self._host_seconds() if node is None else groups[leaders[node]][0]
                    cpu[node] = self._rate(node, used_s, now)
                part = cpu[node]
                if part is None:
                    continue
                # The kernel counts in hundredths of a second, which over a short time may be more than
                # there is.
                value = min(1.0, part / (os.cpu_count() or 1)) if node is None else part
            found[source] = value
        return found

    def _rate(self, node: str | None, used_s: float, now: float) -> float | None:
        before_s, at = self._before.get(node, (used_s, now))
        self._before[node] = (used_s, now)
        # Less than before: a process of the group has ended and taken its time along.
        return max(0.0, used_s - before_s) / (now - at) if now > at else None

    def _waiting(self, now: float) -> float | None:
        """Return the part of the time since the last look in which some process waited for a processor."""
        try:
            line = (self._proc / "pressure" / "cpu").read_text().split("\n", 1)[0]
            waited_s = int(line.rpartition("total=")[2]) / 1e6
        except (OSError, ValueError):
            return None
        before, self._waited = self._waited, (waited_s, now)
        if before is None or now <= before[1]:
            return None
        return min(1.0, max(0.0, waited_s - before[0]) / (now - before[1]))

    def _groups(self, leaders: set[int]) -> dict[int, tuple[float, int]]:
        """Return session -> seconds of processor, pages: of each leader and of what it started."""
        found: dict[int, tuple[float, int]] = {}
        for entry in os.scandir(self._proc):
            if not entry.name.isdigit():
                continue
            try:
                stat = Path(entry.path, "stat").read_bytes()
            except OSError:
                continue  # it ended
            fields = stat[stat.rindex(b")") + 2 :].split()
            session = int(fields[3])
            if session in leaders and fields[0] not in (b"Z", b"X"):
                seconds, pages = found.get(session, (0.0, 0))
                used = (int(fields[11]) + int(fields[12])) / TICKS
                found[session] = (seconds + used, pages + int(fields[21]))
        return found

    def _memory(self, pages: int) -> float:
        return pages * PAGE / self._memory_table()["MemTotal"]

    def _host_memory(self) -> float:
        table = self._memory_table()
        return 1 - table["MemAvailable"] / table["MemTotal"]

    def _memory_table(self) -> dict[str, int]:
        lines = (self._proc / "meminfo").read_text().splitlines()
        return {
            name: int(rest.split()[0]) * 1024 for name, _, rest in (line.partition(":") for line in lines)
        }

    def _host_seconds(self) -> float:
        user, nice, system, _, _, irq, softirq, steal = map(
            int, (self._proc / "stat").read_text().split("\n", 1)[0].split()[1:9]
        )
        return (user + nice + system + irq + softirq + steal) / TICKS
