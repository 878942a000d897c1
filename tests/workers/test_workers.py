"""Worker processes: deadlines that kill, deaths that are told, and nobody left behind."""

from __future__ import annotations

import asyncio
import functools
import math
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from tests.waiting import eventually, until

from robomend.errors import Overloaded, SolverError, WorkerDied, WorkerNotReady, WorkerTimeout
from robomend.workers.pool import WorkerPool

JOBS = """
import ctypes, os, subprocess, time
warmed = []
def warm(): warmed.append(os.getpid())
def broken_warm(): raise RuntimeError("no planner here")
def never_warm(): time.sleep(600)
def slow_warm(): time.sleep(2.5)
def warm_but_for_the_second(notes):
    started = len(os.listdir(notes)) + 1
    open(os.path.join(notes, str(started)), "w").close()
    if started == 2: raise RuntimeError("not this time")
def was_warmed(): return warmed == [os.getpid()]
def spin(seconds):
    end = time.monotonic() + seconds
    while time.monotonic() < end: pass
def spin_in_native_code(): return max(iter(int, 1))
def hold_the_lock(seconds): ctypes.PyDLL(None).usleep(int(seconds * 1e6))  # PyDLL keeps the GIL
def hog(): return len(bytearray(1 << 31))
def child(): return subprocess.Popen(["sleep", "600"]).pid, time.sleep(600)
def start_child(path):
    with open(path, "w") as f: f.write(str(subprocess.Popen(["sleep", "600"]).pid))
    time.sleep(600)
class Odd(Exception):
    def __init__(self, one, two): super().__init__("odd")
def odd(): raise Odd(1, 2)
def unpicklable(): return lambda: None
"""


@pytest.fixture
def jobs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Callable[[str], Callable[..., object]]]:
    """Functions that a worker process can import too."""
    (tmp_path / "worker_jobs.py").write_text(JOBS)
    monkeypatch.syspath_prepend(str(tmp_path))
    import importlib

    module = importlib.import_module("worker_jobs")
    yield lambda name: getattr(module, name)
    del sys.modules["worker_jobs"]


@pytest.fixture
def pool() -> Iterator[WorkerPool]:
    with WorkerPool("test", size=1, spare=0) as one:
        yield one


def ended(pid: int) -> bool:
    try:
        state = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0]
        # A dead process whose parent has not looked; with more than one thread left it is still dying.
        return state == "Z" and len(list(Path(f"/proc/{pid}/task").iterdir())) <= 1
    except (FileNotFoundError, ProcessLookupError):
        return True


def gone(pid: int) -> bool:
    """Wait for the end of a process."""
    until(lambda: ended(pid), f"process {pid} ends")
    return True


def test_a_call_returns_what_the_function_returns(pool: WorkerPool) -> None:
    assert pool.call(math.factorial, 20) == math.factorial(20)


def test_the_same_worker_serves_call_after_call(pool: WorkerPool) -> None:
    assert pool.call(os.getpid) == pool.call(os.getpid) != os.getpid()


def test_what_the_function_raises_is_raised_here(pool: WorkerPool) -> None:
    with pytest.raises(ValueError, match="negative"):
        pool.call(math.factorial, -1)
    assert pool.call(math.factorial, 3) == 6


def test_what_cannot_travel_is_told_in_words(
    pool: WorkerPool, jobs: Callable[[str], Callable[..., object]]
) -> None:
    with pytest.raises(SolverError, match="Odd: odd"):
        pool.call(jobs("odd"))
    with pytest.raises(SolverError, match="pickle"):
        pool.call(jobs("unpicklable"))


def test_workers_are_warmed_before_their_first_call(jobs: Callable[[str], Callable[..., object]]) -> None:
    with WorkerPool("warm", warm=jobs("warm")) as pool:
        assert pool.call(jobs("was_warmed"))


def test_workers_are_no_nicer_than_the_service_unless_that_is_asked_for(pool: WorkerPool) -> None:
    assert pool.call(os.nice, 0) == os.nice(0)
    with WorkerPool("nice", spare=0, niceness=1) as nice:
        assert nice.call(os.nice, 0) == min(19, os.nice(0) + 1)


def test_a_worker_that_cannot_be_warmed_is_told_and_does_not_hang(
    jobs: Callable[[str], Callable[..., object]],
) -> None:
    with (
        WorkerPool("cold", warm=jobs("broken_warm")) as pool,
        pytest.raises(WorkerDied, match="no planner here"),
    ):
        pool.call(os.getpid)


def test_a_worker_that_is_not_ready_in_time_is_called_that(
    jobs: Callable[[str], Callable[..., object]], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("robomend.workers.pool.START_TIMEOUT_S", 0.5)
    with (
        WorkerPool("slow", spare=0, warm=jobs("never_warm")) as pool,
        pytest.raises(WorkerNotReady, match=r"slow: no worker was ready within 0\.5 s"),
    ):
        pool.call(os.getpid)


def test_what_others_keep_the_processor_from_a_start_does_not_count(
    jobs: Callable[[str], Callable[..., object]], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("robomend.workers.pool.START_TIMEOUT_S", 0.5)
    monkeypatch.setattr("robomend.workers.process.waited_s", lambda process: 60.0)
    with WorkerPool("starved", spare=0, warm=jobs("slow_warm")) as pool:
        assert pool.call(math.sqrt, 4.0) == 2.0


def test_a_spare_that_could_not_be_started_fails_no_later_call(
    jobs: Callable[[str], Callable[..., object]], tmp_path: Path
) -> None:
    (notes := tmp_path / "starts").mkdir()
    warm = functools.partial(jobs("warm_but_for_the_second"), str(notes))
    with WorkerPool("spare", size=1, spare=1, warm=warm) as pool:
        pid = pool.call(os.getpid)
        until(lambda: pool._starts == 2 and not pool._starting, "the spare's start has failed")
        os.kill(pid, signal.SIGKILL)
        assert gone(pid)
        assert pool.call(math.sqrt, 4.0) == 2.0


def test_no_room_for_another_thread_is_told_and_the_next_call_works(
    pool: WorkerPool, monkeypatch: pytest.MonkeyPatch
) -> None:
    def no_room(*_: object) -> None:  # as where `ulimit -v` is reached
        raise RuntimeError("can't start new thread")

    with monkeypatch.context() as full:
        full.setattr(pool._starter, "submit", no_room)
        with pytest.raises(WorkerDied, match="can't start new thread"):
            pool.call(math.sqrt, 4.0)
    assert pool.call(math.sqrt, 4.0) == 2.0


def test_a_deadline_kills_the_worker_and_the_next_call_works(
    pool: WorkerPool, jobs: Callable[[str], Callable[..., object]]
) -> None:
    pid = pool.call(os.getpid)
    with pytest.raises(WorkerTimeout, match=r"0\.3 s"):
        pool.call(jobs("spin"), 600, timeout_s=0.3)
    assert gone(pid)
    assert pool.call(os.getpid) != pid


@pytest.mark.parametrize("job", ["spin_in_native_code", "spin"])
def test_spent_processor_time_kills_the_worker_and_the_next_call_works(
    job: str, pool: WorkerPool, jobs: Callable[[str], Callable[..., object]]
) -> None:
    pid = pool.call(os.getpid)
    arguments = [600] if job == "spin" else []
    with pytest.raises(WorkerTimeout, match=r"0\.2 s of processor time"):
        pool.call(jobs(job), *arguments, processor_s=0.2)
    assert gone(pid)
    assert pool.call(os.getpid) != pid


def test_who_waits_for_the_processor_spends_none(pool: WorkerPool) -> None:
    pid = pool.call(os.getpid)
    pool.call(time.sleep, 1.0, processor_s=0.2)  # longer than the limit, by the clock
    assert pool.call(os.getpid) == pid


def test_a_crash_is_told_with_its_signal(pool: WorkerPool) -> None:
    with pytest.raises(WorkerDied, match="SIGSEGV"):
        pool.call(signal.raise_signal, signal.SIGSEGV)
    with pytest.raises(WorkerDied, match="exit code 7"):
        pool.call(os._exit, 7)
    assert pool.call(math.factorial, 3) == 6


def test_a_worker_killed_while_idle_is_replaced(pool: WorkerPool) -> None:
    pid = pool.call(os.getpid)
    os.kill(pid, signal.SIGKILL)
    assert gone(pid)
    assert pool.call(os.getpid) != pid


def test_too_much_memory_ends_the_call_not_the_service(jobs: Callable[[str], Callable[..., object]]) -> None:
    with WorkerPool("small", memory_bytes=1 << 30) as pool:
        with pytest.raises(WorkerDied, match="memory"):
            pool.call(jobs("hog"))
        assert pool.call(math.factorial, 3) == 6


def test_no_process_starts_before_the_first_call_and_none_is_left_after_close() -> None:
    pool = WorkerPool("lazy", size=2, spare=1)
    assert pool.pids == ()
    pool.call(os.getpid)
    pids = pool.pids
    assert pids
    pool.close()
    assert all(gone(pid) for pid in pids)
    with pytest.raises(WorkerDied, match="closed"):
        pool.call(os.getpid)


async def _spare_beside(pool: WorkerPool, spin: Callable[..., object]) -> None:
    task = asyncio.create_task(pool.run(spin, 600))
    await eventually(lambda: len(pool.pids) == 2, "a spare is ready")
    task.cancel()


def test_a_spare_is_ready_while_another_works(jobs: Callable[[str], Callable[..., object]]) -> None:
    with WorkerPool("spare", size=1, spare=1) as pool:
        asyncio.run(_spare_beside(pool, jobs("spin")))


def test_idle_workers_end() -> None:
    with WorkerPool("idle", spare=0, idle_s=0.3) as pool:
        pid = pool.call(os.getpid)
        assert gone(pid)
        assert pool.pids == ()
        assert pool.call(os.getpid) != pid


async def _timed_out_and_cancelled(pool: WorkerPool, start_child: Callable[..., object], note: Path) -> None:
    assert await pool.run(math.factorial, 5, timeout_s=30) == 120
    pid = await pool.run(os.getpid)
    task = asyncio.create_task(pool.run(start_child, str(note)))
    await eventually(lambda: note.exists() and note.read_text(), "it is at work")
    task.cancel()
    with pytest.raises(asyncio.CancelledError):
        await task
    assert await asyncio.to_thread(gone, pid)
    assert await asyncio.to_thread(gone, int(note.read_text()))
    assert await pool.run(math.factorial, 5, timeout_s=30) == 120


def test_cancelling_the_task_kills_the_worker_and_what_it_started(
    pool: WorkerPool, jobs: Callable[[str], Callable[..., object]], tmp_path: Path
) -> None:
    asyncio.run(_timed_out_and_cancelled(pool, jobs("start_child"), tmp_path / "pid"))


async def _crowd(pool: WorkerPool, fifo: Path) -> list[object]:
    """Ask for four things, each of which waits for something to read, and let them go then."""
    calls = []
    for _ in range(4):
        calls.append(asyncio.create_task(pool.run(fifo.read_text, timeout_s=60)))
        await asyncio.sleep(0)
        await asyncio.to_thread(until, lambda: pool._busy, "a worker has taken up the first")
    working = calls[:3]
    while working:
        await asyncio.to_thread(fifo.write_text, "read")
        await asyncio.wait(working, return_when=asyncio.FIRST_COMPLETED)
        working = [call for call in working if not call.done()]
    return await asyncio.gather(*calls, return_exceptions=True)


def test_the_queue_is_bounded(tmp_path: Path) -> None:
    os.mkfifo(fifo := tmp_path / "fifo")
    with WorkerPool("busy", size=1, spare=0, queue_limit=2) as pool:
        pool.call(os.getpid)
        *answers, refused = asyncio.run(_crowd(pool, fifo))
        assert answers == ["read"] * 3
        assert isinstance(refused, Overloaded)


PARENT = """
import os, sys, threading, time
sys.path.insert(0, {path!r})
import worker_jobs
from robomend.workers.pool import WorkerPool
pool = WorkerPool("doomed", spare=0)
print(pool.call(os.getpid), flush=True)
threading.Thread(target=pool.call, args=(worker_jobs.{job}, 600), daemon=True).start()
time.sleep(0.5)
print("searching", flush=True)
time.sleep(600)
"""


@pytest.mark.parametrize("job", ["spin", "hold_the_lock"])
def test_workers_end_with_a_killed_parent_in_the_middle_of_a_search(
    job: str, jobs: Callable[[str], Callable[..., object]], tmp_path: Path
) -> None:
    program = PARENT.format(path=str(tmp_path), job=job)
    with subprocess.Popen([sys.executable, "-c", program], stdout=subprocess.PIPE, text=True) as parent:
        assert parent.stdout is not None
        pid = int(parent.stdout.readline())
        assert parent.stdout.readline() == "searching\n"
        parent.kill()
    assert gone(pid)
