"""What tests take is counted with all their processes, and told by room, file, fixture and test."""

from __future__ import annotations

import os
import subprocess
import sys

import pytest
from tests.spent import Sums, spent_s

BUSY_S = 0.2
BUSY = f"""
import sys, time
while time.process_time() < {BUSY_S}:
    pass
print("done", flush=True)
sys.stdin.read()
"""


def test_what_a_child_takes_counts_while_it_runs_and_when_it_has_ended() -> None:
    # A child of a child: the shell does not become what it runs, as something comes after.
    before = spent_s(os.getpid())
    command = ["sh", "-c", '"$0" -c "$1"; true', sys.executable, BUSY]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as child:
        assert child.stdout is not None
        assert child.stdout.readline() == "done\n"
        assert spent_s(child.pid) >= BUSY_S * 0.9
        assert spent_s(os.getpid()) - before >= BUSY_S * 0.9
        child.communicate()
    assert spent_s(child.pid) == 0.0
    assert spent_s(os.getpid()) - before >= BUSY_S * 0.9


class Terminal:
    """What pytest writes to, at the end."""

    def __init__(self) -> None:
        self.lines: list[str] = []

    def section(self, title: str) -> None:
        self.lines.append(title)

    def write_line(self, line: str) -> None:
        self.lines.append(" ".join(line.split()))


def test_sums_are_told_of_rooms_files_fixtures_and_tests() -> None:
    sums, terminal = Sums(), Terminal()
    for test, when, took in (
        ("a.py::one", "setup", 1.0),
        ("a.py::one", "call", 2.0),
        ("b.py::two", "call", 4.0),
    ):
        sums.pytest_runtest_logreport(
            pytest.TestReport(
                nodeid=f"tests/store/{test}",
                location=("", 0, ""),
                keywords={},
                outcome="passed",
                longrepr=None,
                when="setup" if when == "setup" else "call",
                user_properties=[("spent_s", took), ("fixture tests::server", 0.5), ("told by another", "8")],
            )
        )
    sums.pytest_terminal_summary(terminal)
    assert terminal.lines == [
        "processor time: 7 s",
        "by room:",
        "7.00 s tests/store",
        "by file:",
        "4.00 s tests/store/b.py",
        "3.00 s tests/store/a.py",
        "by fixture of several tests:",
        "1.50 s tests::server",
        "by test:",
        "4.00 s tests/store/b.py::two",
        "3.00 s tests/store/a.py::one",
    ]
