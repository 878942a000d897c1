"""What can be tested of the Fast Downward planner where Fast Downward is not installed."""

from __future__ import annotations

import subprocess
import sys

STARTER = """
import resource, signal, subprocess, sys
from robomend.planning.planners.fast_downward import children_end_after

before = resource.getrlimit(resource.RLIMIT_CPU)
with children_end_after(0.1):
    child = subprocess.Popen([sys.executable, "-c", "while True: pass"])
assert resource.getrlimit(resource.RLIMIT_CPU) == before
try:
    assert child.wait(100) == -signal.SIGXCPU
finally:
    child.kill()
    child.wait()
"""
"""A process of its own: what a starter has used comes on top, and a test worker may have used minutes."""


def test_what_is_started_within_ends_by_itself_when_its_cpu_time_is_used_up() -> None:
    subprocess.run([sys.executable, "-c", STARTER], check=True, timeout=115)
