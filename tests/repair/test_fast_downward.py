"""What can be tested of the Fast Downward planner where Fast Downward is not installed."""

from __future__ import annotations

import resource
import signal
import subprocess
import sys

from robomend.repair.planners.fast_downward import children_end_after

FOR_EVER = [sys.executable, "-c", "while True: pass"]


def test_what_is_started_within_ends_by_itself_when_its_cpu_time_is_used_up() -> None:
    before = resource.getrlimit(resource.RLIMIT_CPU)
    with children_end_after(0.1):
        process = subprocess.Popen(FOR_EVER)
    assert resource.getrlimit(resource.RLIMIT_CPU) == before
    try:
        assert process.wait(110) == -signal.SIGXCPU
    finally:
        process.kill()
        process.wait()


def test_without_a_deadline_nothing_is_bounded() -> None:
    before = resource.getrlimit(resource.RLIMIT_CPU)
    with children_end_after(None):
        assert resource.getrlimit(resource.RLIMIT_CPU) == before
