"""Start tests/store/instance.py as a process of its own."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

_ROOT = Path(__file__).parents[2]


@contextmanager
def instance(url: str, job: str) -> Iterator[subprocess.Popen[bytes]]:
    """A process that does the job; killed at the end at the latest."""
    process = subprocess.Popen(
        [sys.executable, "-m", "tests.store.instance", url, job],
        cwd=_ROOT,
        stdout=subprocess.PIPE,
    )
    try:
        yield process
    finally:
        process.kill()
        process.wait(10)
        assert process.stdout is not None
        process.stdout.close()


def next_line(process: subprocess.Popen[bytes]) -> str:
    """Return the next line that it says."""
    assert process.stdout is not None
    line = process.stdout.readline().decode().strip()
    assert line, "the process ended early"
    return line
