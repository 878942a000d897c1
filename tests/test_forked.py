"""What is forked is as what is started: what it is given, what it writes, how it ends."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
from tests.forked import Forked, popen


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


def test_what_is_done_at_exit_is_done() -> None:
    assert end_of(forked("import atexit; atexit.register(print, 'bye'); print('hello')")) == (
        "hello\nbye\n",
        0,
    )


def test_what_is_on_another_path_is_a_fresh_interpreter(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "elsewhere.py").write_text("")
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))
    process = popen([sys.executable, "-c", "import elsewhere"])
    assert isinstance(process, subprocess.Popen)
    assert process.wait(60) == 0
