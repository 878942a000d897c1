"""What is forked is as what is started: what it is given, what it writes, how it ends."""

from __future__ import annotations

import os
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import pytest
from tests import forked_programs
from tests.clients.running_agent import alive
from tests.forked import ROOT, Forked, popen
from tests.waiting import until

from robomend.errors import WorkerTimeout
from robomend.workers.pool import WorkerPool


def forked(code: str, *arguments: str, **options: Any) -> Forked:
    found = popen([sys.executable, "-c", code, *arguments], stdout=subprocess.PIPE, text=True, **options)
    assert isinstance(found, Forked)
    return found


def end_of(process: Forked) -> tuple[str, int]:
    assert process.stdout is not None
    with process.stdout:
        return process.stdout.read(), process.wait(60)


def test_arguments_folder_environment_and_output_are_its_own(tmp_path: Path) -> None:
    code = "import os, sys; print(sys.argv[1:], os.getcwd(), os.environ['COLOUR']); sys.exit(7)"
    process = forked(code, "a b", cwd=tmp_path, env={**os.environ, "COLOUR": "red"})
    assert end_of(process) == (f"['a b'] {tmp_path} red\n", 7)


def test_what_ours_bind_to_who_starts_it_ends_with_it() -> None:
    starts = """
import signal, subprocess, sys
from tests.forked import popen
child = popen([sys.executable, "-c", "import signal; signal.pause()"], preexec_fn=print)
print(child.pid, flush=True)
signal.pause()
"""
    process = forked(starts, cwd=ROOT)
    assert process.stdout is not None
    child = int(process.stdout.readline())
    assert alive(child)
    process.kill()
    until(lambda: not alive(child), "it has ended with who started it")


def test_it_is_a_process_that_can_be_killed() -> None:
    process = forked("import os, signal; print(os.getpid(), flush=True); signal.pause()")
    assert process.stdout is not None
    assert int(process.stdout.readline()) == process.pid != os.getpid()
    assert process.poll() is None
    with pytest.raises(subprocess.TimeoutExpired):
        process.wait(0.01)
    for _ in range(100):  # dead, and not yet known to be
        process.kill()
    assert end_of(process) == ("", -9)
    process.kill()  # it may be somebody else's number by now
    with pytest.raises(ProcessLookupError):
        os.kill(process.pid, 0)


@pytest.mark.parametrize(
    ("code", "said"),
    [("raise ValueError('mine')", "ValueError: mine"), ("import sys; sys.exit('no room')", "no room")],
)
def test_what_it_dies_of_is_written(code: str, said: str) -> None:
    out, status = end_of(forked(code, stderr=subprocess.STDOUT))
    assert out.splitlines()[-1] == said
    assert status == 1


def test_a_command_of_a_shell_is_what_it_stands_for(tmp_path: Path) -> None:
    folder = forked_programs.write(tmp_path / "programs")
    found = {**os.environ, "PATH": f"{folder}:{os.environ['PATH']}"}

    def said(command: str) -> subprocess.CompletedProcess[str]:
        return subprocess.run(
            ["bash", "-c", command], capture_output=True, text=True, timeout=100, cwd=tmp_path, env=found
        )

    assert said("robomend --version | cat").stdout.startswith("robomend")
    wrong = said("robomend diagnose 'no file.yaml'")
    assert (wrong.returncode, wrong.stdout) == (2, "")
    assert "no file.yaml" in wrong.stderr
    serve = ["bash", "-c", "exec robomend serve --port 0 --announce --data data"]
    with subprocess.Popen(serve, stdout=subprocess.PIPE, cwd=tmp_path, env=found) as process:
        assert process.stdout is not None
        assert process.stdout.readline()
        process.terminate()  # the small program, which hands it on
        assert process.wait(60) == 0


def test_workers_of_this_process_are_killed_in_the_middle_of_a_call() -> None:
    pool = WorkerPool("tests", size=1, spare=0)
    try:
        first = pool.call(os.getpid)
        with pytest.raises(WorkerTimeout):
            pool.call(time.sleep, 1000, timeout_s=0.01)
        until(lambda: not alive(first), "it was killed")
        assert pool.call(os.getpid) != first
    finally:
        pool.close()
