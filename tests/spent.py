"""./dev test --spent: how much processor time the tests take, by room, file, fixture and test.

On a busy computer, and these tests keep one busy, wall-clock time says who waited; processor time says who
made the others wait. Counted is the user and system time of a test with all processes that it began or uses,
those of shared fixtures and of forked.py's template included: the kernel adds what a process took to its
parent's once it was waited for, and /proc tells that of those alive. What fixtures of several tests take to
start is counted for the test that needed them first, and told again by fixture. A process whose parent ended
before it is lost.
"""

from __future__ import annotations

import os
from collections import defaultdict
from collections.abc import Generator
from pathlib import Path
from typing import Any

import pytest
from tests.forked import aside

TICKS_PER_S = os.sysconf("SC_CLK_TCK")
SHOWN = 25
"""Lines of each list."""

BEGIN = "begin and collect"
"""What a worker takes before its first test."""


def children(process: int) -> list[int]:
    """Return the processes that one has begun and that are alive."""
    found = []
    try:
        for task in Path(f"/proc/{process}/task").iterdir():
            found += [int(child) for child in (task / "children").read_text().split()]
    except OSError:  # it has ended
        pass
    return found


def spent_s(process: int) -> float:
    """Return the processor time of a process, of its descendants, and of those that were waited for."""
    try:
        text = Path(f"/proc/{process}/stat").read_text()
    except OSError:
        return 0.0
    own = sum(map(int, text.rpartition(")")[2].split()[11:15])) / TICKS_PER_S
    return own + sum(map(spent_s, children(process)))


def _now_s() -> float:
    """Return what this process, and who works for it, has taken so far."""
    return sum(map(spent_s, (os.getpid(), *aside())))


class Meter:
    """In a worker: what each test took, on its report."""

    def __init__(self) -> None:
        self._told = 0.0
        self._depth: list[float] = []  # of fixtures within fixtures: what the inner ones took
        self._fixtures: list[tuple[str, float]] = []

    def _since(self) -> float:
        now = _now_s()
        since, self._told = now - self._told, now
        return max(0.0, since)

    def pytest_collection_finish(self) -> None:
        self._fixtures.append((BEGIN, self._since()))

    @pytest.hookimpl(wrapper=True)
    def pytest_fixture_setup(self, fixturedef: pytest.FixtureDef[Any]) -> Generator[None, object, object]:
        began = _now_s()
        self._depth.append(0.0)
        try:
            return (yield)
        finally:
            took = _now_s() - began
            inner = self._depth.pop()
            if self._depth:
                self._depth[-1] += took
            if fixturedef.scope != "function" and took - inner > 0:
                where = f"{fixturedef.baseid}::" if fixturedef.baseid else ""
                self._fixtures.append((f"{where}{fixturedef.argname}", took - inner))

    @pytest.hookimpl(wrapper=True)
    def pytest_runtest_makereport(
        self, item: pytest.Item
    ) -> Generator[None, pytest.TestReport, pytest.TestReport]:
        report = yield
        report.user_properties.append(("spent_s", self._since()))
        report.user_properties += [(f"fixture {name}", took) for name, took in self._fixtures]
        self._fixtures.clear()
        return report


class Sums:
    """Where the results come together: the lists at the end."""

    def __init__(self) -> None:
        self.tests: dict[str, float] = defaultdict(float)
        self.fixtures: dict[str, float] = defaultdict(float)

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        for name, value in report.user_properties:
            if not isinstance(value, float):
                continue
            if name == "spent_s":
                self.tests[report.nodeid] += value
            elif name.startswith("fixture "):
                self.fixtures[name.removeprefix("fixture ")] += value

    def pytest_terminal_summary(self, terminalreporter: Any) -> None:
        files: dict[str, float] = defaultdict(float)
        rooms: dict[str, float] = defaultdict(float)
        for name, took in self.tests.items():
            file = name.partition("::")[0]
            files[file] += took
            rooms["/".join(file.split("/")[:2])] += took
        terminalreporter.section(f"processor time: {sum(self.tests.values()):.0f} s")
        for title, sums in (
            ("room", rooms),
            ("file", files),
            ("fixture of several tests", self.fixtures),
            ("test", self.tests),
        ):
            terminalreporter.write_line(f"by {title}:")
            shown = None if title == "room" else SHOWN
            for name, took in sorted(sums.items(), key=lambda one: -one[1])[:shown]:
                terminalreporter.write_line(f"{took:9.2f} s  {name}")
