"""What is to end with a killed agent: the guard, told by whatever is started before its program runs."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
from tests.clients.running_agent import DEAF, SLEEPER, marked
from tests.clients.service_double import eventually

from robomend_client.agent import guard

KILLED_AGENT = """
import os, pathlib, signal, sys, time
from robomend_client.agent.spawn import spawn
mark, pipe = sys.argv[2], int(sys.argv[3])
spawn((sys.executable, "-c", sys.argv[1], mark), None, os.environ, True, guard=pipe)
while not pathlib.Path(mark).exists():
    time.sleep(0.01)
os.kill(os.getpid(), signal.SIGKILL)
"""
"""An agent that is killed as soon as it has started a process, before it does anything else."""


@contextmanager
def guarding() -> Iterator[tuple[subprocess.Popen[bytes], int]]:
    """A guard, and where it is told."""
    read, write = os.pipe()
    command = [sys.executable, "-I", "-S", guard.__file__]
    with subprocess.Popen(command, stdin=read, start_new_session=True) as process:
        os.close(read)
        try:
            yield process, write
        finally:
            process.kill()


def test_what_an_agent_started_ends_with_it_although_it_was_killed_before_it_said_so(tmp_path: Path) -> None:
    mark = str(tmp_path / "deaf")
    with guarding() as (process, pipe):
        command = [sys.executable, "-c", KILLED_AGENT, DEAF, mark, str(pipe)]
        agent = subprocess.Popen(command, pass_fds=(pipe,))
        os.close(pipe)
        assert agent.wait(60) == -signal.SIGKILL
        assert process.wait(60) == 0
        eventually(lambda: not marked(mark), "the end of the deaf process")


@pytest.mark.parametrize(
    ("lines", "ends"),
    [("?{0}\n", True), ("?{0}\n?\n", False), ("?{0}\n+{0}\n?\n", True), ("+{0}\n-{0}\n", False)],
)
def test_the_guard_ends_what_was_begun_or_started_and_is_not_gone(lines: str, ends: bool) -> None:
    other = subprocess.Popen(SLEEPER, start_new_session=True)
    with guarding() as (process, pipe):
        os.write(pipe, lines.format(other.pid).encode())
        os.close(pipe)
        assert process.wait(60) == 0
    try:
        assert (other.poll() is None) is not ends
    finally:
        other.kill()
        other.wait()
