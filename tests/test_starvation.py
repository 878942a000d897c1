"""What the machine keeps from a process is not held against it."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from collections.abc import Iterator

import pytest
from tests.waiting import until

from robomend.starvation import AT_MOST_S, OwnSilence, waited_s

BUSY = "while True: pass"


@pytest.fixture
def crowd() -> Iterator[list[subprocess.Popen[bytes]]]:
    """More busy processes than this test may use processors, the last of them the least favoured."""
    first = min(os.sched_getaffinity(0))

    def here() -> None:
        os.sched_setaffinity(0, {first})

    processes = [subprocess.Popen([sys.executable, "-c", BUSY], preexec_fn=here) for _ in range(3)]
    yield processes
    for process in processes:
        process.kill()
        process.wait()


def test_a_process_that_has_to_share_its_processor_waits(crowd: list[subprocess.Popen[bytes]]) -> None:
    until(lambda: all(waited_s(one.pid) > 0.1 for one in crowd), "nobody waited", 30.0)


def test_a_stopped_process_waits_for_nothing(crowd: list[subprocess.Popen[bytes]]) -> None:
    one, *others = crowd
    one.send_signal(signal.SIGSTOP)
    os.waitid(os.P_PID, one.pid, os.WSTOPPED | os.WNOWAIT)
    at_the_stop = waited_s(one.pid)
    others_s = [waited_s(other.pid) for other in others]
    until(
        lambda: all(
            waited_s(other.pid) > before + 0.1 for other, before in zip(others, others_s, strict=True)
        ),
        "the others did not wait for each other",
        30.0,
    )
    assert waited_s(one.pid) == at_the_stop


def test_nobody_waits_in_a_process_that_is_gone() -> None:
    assert waited_s(2**22 + 1) == 0.0


@pytest.mark.parametrize(
    ("now_s", "waited", "lasts_s"),
    [
        (14.0, 3.0, 4.0),  # it had the processor
        (14.0, 6.5, 0.5),
        (14.0, 60.0, 0.0),  # of many threads together
        (14.0, 0.0, 4.0),  # of threads that have ended
        (10.0 + AT_MOST_S + 5.0, 1000.0, 5.0),
    ],
)
def test_silence_counts_without_what_was_waited_for(now_s: float, waited: float, lasts_s: float) -> None:
    assert now_s - 10.0 - OwnSilence(10.0, 3.0).excused_s(now_s, waited) == pytest.approx(lasts_s)
