"""What the agent keeps on disk, the queue and the results: order, bound, and what crashes leave behind."""

from __future__ import annotations

import signal
import subprocess
import sys
from collections import deque
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from robomend_client.actions import ActionResult
from robomend_client.agent.memory import FirstResults
from robomend_client.buffer import DiskBuffer, decode, encode


def drain(buffer: DiskBuffer) -> list[Any]:
    found = []
    while (record := buffer.peek()) is not None:
        found.append(record["n"])
        buffer.take()
    return found


def filled(directory: Path, count: int, **options: Any) -> DiskBuffer:
    buffer = DiskBuffer(directory, **options)
    for number in range(count):
        buffer.append({"n": number})
    return buffer


def test_the_files_stay_within_the_bound_and_one_segment(tmp_path: Path) -> None:
    buffer = filled(tmp_path, 5000, max_bytes=8192)
    size = sum(file.stat().st_size for file in tmp_path.glob("*.log"))
    assert size <= 8192 * (1 + 2 / 8)
    assert len(buffer) > 0


@pytest.mark.parametrize("cut", range(1, 12))
def test_a_torn_tail_is_skipped_and_appending_goes_on(tmp_path: Path, cut: int) -> None:
    filled(tmp_path, 3).close()
    file = max(tmp_path.glob("*.log"))
    file.write_bytes(file.read_bytes()[:-cut])
    buffer = DiskBuffer(tmp_path)
    buffer.append({"n": 3})
    assert buffer.corrupt == 1
    assert drain(buffer) == [0, 1, 3]


def test_an_altered_record_is_skipped_and_counted(tmp_path: Path) -> None:
    filled(tmp_path, 3).close()
    file = max(tmp_path.glob("*.log"))
    file.write_bytes(file.read_bytes().replace(b'"n":1', b'"n":7'))
    buffer = DiskBuffer(tmp_path)
    assert (drain(buffer), buffer.corrupt) == ([0, 2], 1)


def test_a_lost_head_sends_again_rather_than_nothing(tmp_path: Path) -> None:
    buffer = filled(tmp_path, 3)
    buffer.take()
    buffer.close()
    (tmp_path / "head").write_text("")
    assert drain(DiskBuffer(tmp_path)) == [0, 1, 2]


@settings(max_examples=60, deadline=None)
@given(
    operations=st.lists(
        st.one_of(
            st.integers(0, 300).map(lambda size: ("append", size)),
            st.just(("take", 0)),
            st.just(("reopen", 0)),
        ),
        max_size=60,
    )
)
def test_behaves_like_a_bounded_queue(
    tmp_path_factory: pytest.TempPathFactory, operations: list[tuple[str, int]]
) -> None:
    directory, most = tmp_path_factory.mktemp("buffer"), 1024
    buffer, oracle, dropped = DiskBuffer(directory, most), deque[dict[str, Any]](), 0
    for number, (operation, size) in enumerate(operations):
        if operation == "append":
            record = {"n": number, "x": "x" * size}
            buffer.append(record)
            oracle.append(record)
            while sum(len(encode(kept)) for kept in oracle) > most:
                oracle.popleft()
                dropped += 1
        elif operation == "take" and oracle:
            assert buffer.peek() == oracle.popleft()
            buffer.take()
        elif operation == "reopen":
            buffer.close()
            buffer = DiskBuffer(directory, most)
        assert len(buffer) == len(oracle)
        assert buffer.peek() == (oracle[0] if oracle else None)
        assert buffer.dropped == dropped
    buffer.close()


@given(st.binary())
def test_no_bytes_make_a_record_by_accident(data: bytes) -> None:
    assert decode(data) is None


WRITER = """
import sys
from robomend_client.buffer import DiskBuffer
buffer = DiskBuffer(sys.argv[1])
number = 0
while True:
    buffer.append({"n": number})
    print(number, flush=True)
    number += 1
"""


def test_what_was_appended_survives_kill_9_of_the_writer(tmp_path: Path) -> None:
    writer = subprocess.Popen([sys.executable, "-c", WRITER, str(tmp_path)], stdout=subprocess.PIPE)
    assert writer.stdout is not None
    begun = [writer.stdout.readline() for _ in range(50)]  # it is in the middle of its work
    writer.send_signal(signal.SIGKILL)
    said = [int(line) for line in (*begun, *writer.stdout.read().split(b"\n")) if line]
    writer.wait()
    writer.stdout.close()
    left = drain(DiskBuffer(tmp_path))
    assert left == list(range(len(left)))
    assert left[-1] >= said[-1]


# --- the first result of each action ----------------------------------------------------------------------


def test_the_first_results_survive_the_agent_and_a_torn_line(tmp_path: Path) -> None:
    file = tmp_path / "results"
    FirstResults(file).remember("r:1", ActionResult(0, "a “quoted” line\nand another"))
    file.write_text(file.read_text() + '["r:2", 0, "to')
    memory = FirstResults(file)
    memory.remember("r:3", ActionResult(3))
    again = FirstResults(file)
    assert again.get("r:1") == ActionResult(0, "a “quoted” line\nand another")
    assert (again.get("r:2"), again.get("r:3")) == (None, ActionResult(3))


def test_the_newest_results_are_kept_in_memory_and_on_the_disk(tmp_path: Path) -> None:
    file = tmp_path / "results"
    memory = FirstResults(file, limit=10)
    for number in range(100):
        memory.remember(f"r:{number}", ActionResult(number))
        assert len(file.read_text().splitlines()) <= 21
    for known in (memory, FirstResults(file, limit=10)):
        assert known.get("r:89") is None
        assert known.get("r:90") == ActionResult(90)
