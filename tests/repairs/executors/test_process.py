"""The process executor runs argument lists and leaves nothing behind."""

from __future__ import annotations

import asyncio
import os
import signal
import sys
from pathlib import Path

import pytest
from tests.repairs.executors.test_board import lost, quiet

from robomend.errors import Fenced
from robomend.repairs.executors.process import ProcessExecutor
from robomend_client.actions import NO_PROGRAM, NOT_EXECUTABLE, OK, REFUSED, TIMED_OUT, Action

pytestmark = pytest.mark.anyio


@pytest.fixture(params=["asyncio", "uvloop"])
def anyio_backend(request: pytest.FixtureRequest) -> tuple[str, dict[str, bool]]:
    """The service runs on uvloop, the command line on asyncio's own loop."""
    return "asyncio", {"use_uvloop": request.param == "uvloop"}


def action(name: str, *parameters: str, timeout_s: float = 10.0) -> Action:
    return Action("r-1:0", name, parameters, timeout_s)


async def test_parameters_stay_single_arguments_whatever_they_hold() -> None:
    program = [sys.executable, "-c", "import sys; print(sys.argv[1:])", "--bus={0}", "{1}"]
    done = await ProcessExecutor({"reset_usb": program}).execute(
        action("reset_usb", "$(reboot); rm -rf ~", "a b"), quiet
    )
    assert done.code == OK
    assert done.message == "['--bus=$(reboot); rm -rf ~', 'a b']"


async def test_the_exit_status_is_the_result() -> None:
    executor = ProcessExecutor({"fail": [sys.executable, "-c", "import sys; print('why'); sys.exit(7)"]})
    done = await executor.execute(action("fail"), quiet)
    assert done.code == 7
    assert done.message.endswith("ended with 7: why")


async def test_only_configured_actions_run() -> None:
    assert (await ProcessExecutor({}).execute(action("reboot"), quiet)).code == REFUSED


async def test_a_missing_parameter_is_refused() -> None:
    done = await ProcessExecutor({"reset": ["true", "{1}"]}).execute(action("reset", "one"), quiet)
    assert done.code == REFUSED


async def test_a_missing_program_is_told_as_a_shell_tells_it(tmp_path: Path) -> None:
    done = await ProcessExecutor({"reset": ["/nonexistent/program"]}).execute(action("reset"), quiet)
    assert done.code == NO_PROGRAM
    assert "/nonexistent/program" in done.message
    done = await ProcessExecutor({"reset": [str(tmp_path)]}).execute(action("reset"), quiet)
    assert done.code == NOT_EXECUTABLE


async def test_a_time_out_ends_the_program_and_its_children(tmp_path: Path) -> None:
    pid_file = tmp_path / "child"
    script = (
        "import subprocess, sys, time;"
        "child = subprocess.Popen([sys.executable, '-c', 'import time; time.sleep(60)']);"
        f"open({str(pid_file)!r}, 'w').write(str(child.pid)); time.sleep(60)"
    )
    executor = ProcessExecutor({"hang": [sys.executable, "-c", script]})
    for timeout_s in (1.0, 4.0, 16.0, 64.0):  # it may be ended before it has begun
        done = await executor.execute(action("hang", timeout_s=timeout_s), quiet)
        assert done.code == TIMED_OUT
        if pid_file.exists() and (child := pid_file.read_text()):
            break
    await gone(int(child))


async def test_what_a_program_leaves_running_does_not_hold_its_result_up(tmp_path: Path) -> None:
    pid_file = tmp_path / "child"
    script = (
        "import subprocess, sys;"
        "child = subprocess.Popen([sys.executable, '-c', 'import time; time.sleep(60)']);"
        f"open({str(pid_file)!r}, 'w').write(str(child.pid)); print('left', flush=True)"
    )
    executor = ProcessExecutor({"start": [sys.executable, "-c", script]})
    async with asyncio.timeout(20.0):  # it prints to the same pipe for a minute
        done = await executor.execute(action("start", timeout_s=30.0), quiet)
    assert (done.code, done.message) == (OK, "left")
    child = int(pid_file.read_text())
    os.kill(child, 0)  # it was left alone
    os.kill(child, signal.SIGKILL)


async def test_much_output_neither_blocks_the_program_nor_fills_memory() -> None:
    executor = ProcessExecutor(
        {"talk": [sys.executable, "-c", "print('x' * 1_000_000); print('last words')"]}
    )
    done = await executor.execute(action("talk", timeout_s=30.0), quiet)
    assert done.code == OK
    assert done.message.endswith("last words")
    assert len(done.message) <= 4096


async def test_what_a_program_prints_is_its_feedback_line_by_line() -> None:
    heard: list[str] = []
    script = "import sys; [(print(word, flush=True), sys.stdin.read(0)) for word in ('one', 'two')]"
    executor = ProcessExecutor({"talk": [sys.executable, "-c", script]})
    done = await executor.execute(action("talk"), lambda _, message: heard.append(message))
    assert done.message == "one\ntwo"
    assert heard[0].endswith("started")
    assert heard[-1] == "two"


async def test_cancelling_ends_the_program() -> None:
    started: list[int] = []
    executor = ProcessExecutor({"hang": [sys.executable, "-c", "import time; time.sleep(60)"]})
    task = asyncio.create_task(executor.execute(action("hang"), lambda pid, _: started.append(pid)))
    while not started:
        await asyncio.sleep(0.01)
    task.cancel()
    async with asyncio.timeout(30):
        await asyncio.wait([task])
    await gone(started[0])


async def test_who_has_lost_the_robot_starts_no_program(tmp_path: Path) -> None:
    acted = tmp_path / "acted"
    program = [sys.executable, "-c", f"open({str(acted)!r}, 'w')"]
    with pytest.raises(Fenced):
        await ProcessExecutor({"reset": program}, lost).execute(action("reset"), quiet)
    assert not acted.exists()


async def gone(pid: int) -> None:
    """Wait until no such process lives (a zombie that init has yet to reap is as good as gone)."""
    async with asyncio.timeout(30):
        while True:
            try:
                os.kill(pid, 0)
                state = Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()[0]
            except (ProcessLookupError, FileNotFoundError):
                return
            if state == "Z":
                return
            await asyncio.sleep(0.02)
