"""A process for tests to kill: `python -m tests.store.instance URL JOB`. It says what it was told is safe.

own       acquires r1, begins a repair and journals an intent: a line `fence repair`, then waits
act       acquires r1, and acts on it again and again: a line `acts` and the time since boot for each;
          `fenced` when it may not any more. SIGUSR1 holds its event loop until SIGUSR2.
"""

from __future__ import annotations

import asyncio
import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from robomend.errors import Fenced
from robomend.store import Store, journal, repairs


def say(line: str) -> None:
    """Hand a line to the test at once: what is in a buffer of ours dies with us."""
    os.write(1, f"{line}\n".encode())


async def own(store: Store) -> None:
    """Own r1 in the middle of a repair."""
    fence = await store.ownership.acquire("r1")
    assert fence is not None
    repair = await store.write(lambda tx: repairs.create(tx, "r1", state="running", data={}, fence=fence))
    await store.write(
        lambda tx: journal.intend(
            tx,
            repair.id,
            0,
            action=f"{repair.id}:0",
            name="power_up",
            parameters=["jaguar"],
            timeout_s=10,
            fence=fence,
        )
    )
    say(f"{fence.number} {repair.id}")
    await asyncio.sleep(600)  # until it is killed


async def act(store: Store) -> None:
    """Act on r1 as long as it is ours."""
    loop = asyncio.get_running_loop()
    loop.add_signal_handler(signal.SIGUSR1, signal.sigwait, {signal.SIGUSR2})
    fence = await store.ownership.acquire("r1")
    assert fence is not None
    while True:
        asked_s = time.clock_gettime(time.CLOCK_BOOTTIME)  # it may be halted behind the yes
        try:
            await store.ownership.confirm(fence)
        except Fenced:
            break
        say(f"acts {asked_s}")
        await asyncio.sleep(0.005)
    say("fenced")
    await asyncio.sleep(600)  # until it is killed


@contextmanager
def instance(url: str, job: str) -> Iterator[subprocess.Popen[bytes]]:
    """A process that does the job; killed at the end at the latest."""
    command = [sys.executable, "-m", "tests.store.instance", url, job]
    process = subprocess.Popen(command, cwd=Path(__file__).parents[2], stdout=subprocess.PIPE)
    try:
        yield process
    finally:
        process.kill()
        process.wait(60)
        assert process.stdout is not None
        process.stdout.close()


def next_line(process: subprocess.Popen[bytes]) -> str:
    """Return the next line that it says."""
    assert process.stdout is not None
    line = process.stdout.readline().decode().strip()
    assert line, "the process ended early"
    return line


async def main(url: str, job: str) -> None:
    """Run the job on the store."""
    signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGUSR2})  # of all threads: it is waited for
    store = Store(url)
    await store.start()
    await {"own": own, "act": act}[job](store)


if __name__ == "__main__":
    asyncio.run(main(*sys.argv[1:]))
