"""A program of the bench's own beside it: in one process they would measure each other."""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any


@contextmanager
def beside(program: str, *arguments: str, told: object) -> Iterator[dict[str, Any]]:
    """Run a program of the bench (`robomend_bench.service.PROGRAM`) beside it while the block runs.

    It is told something as a line of JSON, and goes on until its input ends. What it says then, as JSON, the
    dictionary has after the block.
    """
    line = [sys.executable, "-m", f"robomend_bench.service.{program}", *arguments]
    with subprocess.Popen(
        line,
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
        process_group=0,  # Ctrl-C is for the bench, which ends it
    ) as running:
        assert running.stdin is not None
        running.stdin.write(json.dumps(told) + "\n")
        running.stdin.flush()
        found: dict[str, Any] = {}
        try:
            yield found
            said, _ = running.communicate()
        except BaseException:  # Ctrl-C, raised again: what is under way may take minutes
            running.kill()
            raise
        found.update(json.loads(said))
