"""A service for which address space ends says so, and ends with a code of its own."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import click
import pytest

from robomend.cli.commands import BACKEND_FAILED, run
from robomend.errors import BackendError
from robomend.memory_limits import check_room

BOUNDED = """
import resource, sys
import robomend.api.server, robomend.api.runtime, robomend.repairs.repairs
from robomend.cli.commands import run

pages = int(open("/proc/self/statm").read().split()[0])
most = pages * resource.getpagesize() + (60 << 20)
resource.setrlimit(resource.RLIMIT_AS, (most, most))
sys.exit(run(["serve", "--port", "0", "--data", sys.argv[1]]))
"""


def test_a_service_for_which_there_is_no_room_is_refused_as_a_whole(tmp_path: Path) -> None:
    ended = subprocess.run(
        [sys.executable, "-c", BOUNDED, str(tmp_path)], capture_output=True, text=True, timeout=120
    )
    assert ended.returncode == BACKEND_FAILED
    assert ended.stderr.strip().startswith("error: no room for the service")
    assert "Traceback" not in ended.stderr
    assert "serves" not in ended.stderr


def test_what_fits_leaves_nothing_behind() -> None:
    check_room("a test", threads=2, megabytes=1)
    with pytest.raises(BackendError, match="no room for a test"):
        check_room("a test", threads=1, megabytes=1 << 40)


def test_a_thread_that_finds_no_memory_for_its_first_step_holds_up_nothing(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr("_thread.start_new_thread", lambda *_: 1)  # as of one that fell before it began
    monkeypatch.setattr("robomend.memory_limits.BEGUN_S", 0.1)
    with pytest.raises(BackendError, match="no room for a test"):
        check_room("a test", threads=2, megabytes=1)


@pytest.mark.parametrize("error", [MemoryError(), RuntimeError("can't start new thread")])
def test_a_command_for_which_there_is_no_room_shows_no_traceback_and_another_fault_is_a_bug(
    error: Exception, capsys: pytest.CaptureFixture[str]
) -> None:
    raised = error

    @click.group()
    def program() -> None:
        pass

    @program.command()
    def work() -> None:
        raise raised

    assert run(["work"], program) == BACKEND_FAILED
    assert capsys.readouterr().err.startswith("error: no room")
    raised = RuntimeError("something else")
    with pytest.raises(RuntimeError, match="something else"):
        run(["work"], program)
