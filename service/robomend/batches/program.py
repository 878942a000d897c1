"""robomend-batch as a program of the service's own interpreter, ended with all processes that it started.

What is asked for are the options of a batch; they become its command line.
"""

from __future__ import annotations

import asyncio
import contextlib
import os
import re
import signal
import subprocess
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from typing import Literal

from robomend.batches.folders import BatchFolder
from robomend.store.records import Json

TOGETHER = re.compile(r"log|[0-9]{1,8}(\.[0-9]{1,6})?(s|min|h)")


@dataclass(frozen=True, slots=True)
class BatchOptions:
    """The options of `robomend-batch run`, as far as who asks over HTTP chooses them."""

    minimal: Literal["subset", "cardinality"] = "subset"
    max_size: int | None = None
    limit: int = 100  # 0: none
    timeout_s: float = 5.0  # of a state
    unknown: Literal["refuse", "keep"] = "refuse"
    time: Literal["log", "header"] = "log"
    together: str | None = None  # as TOGETHER

    def json(self) -> Json:
        """Return them as they are kept."""
        return {name: getattr(self, name) for name in self.__slots__}


def run_arguments(options: Json, folder: BatchFolder, names: Sequence[str], workers: int) -> list[str]:
    """Return the arguments of the run; each time the same, so that it goes on where it was."""
    found = ["run", "--model", str(folder.model), "--out", str(folder.out), "--parquet", "--no-code"]
    if folder.observers.exists():
        found += ["--observers", str(folder.observers)]
    found += ["--minimal", options["minimal"], "--limit", str(options["limit"])]
    found += ["--timeout", str(options["timeout_s"]), "--unknown", options["unknown"]]
    found += ["--time", options["time"], "--workers", str(min(workers, len(names)))]
    if options["max_size"] is not None:
        found += ["--max-size", str(options["max_size"])]
    if options["together"] is not None:
        found += ["--together", options["together"]]
    return [*found, "--", *names]


def report_arguments(folder: BatchFolder) -> list[str]:
    """Return the arguments that write the report."""
    return ["report", str(folder.out)]


GRACE_S = 2.0
"""From SIGTERM to SIGKILL."""

SAID_BYTES = 2000
"""Of the end of what it said."""

NEEDED = ("robomend_batch", "polars", "numpy", "rosbags", "mcap", "python_multipart")


def missing() -> str | None:
    """Return which part of the extra `batch` is not installed."""
    return next((name for name in NEEDED if find_spec(name) is None), None)


async def run(
    arguments: Sequence[str],
    *,
    folder: Path,
    said: Path,
    lock: int,
    most_bytes: int,
    nice: int,
    timeout_s: float,
) -> int | None:
    """Run the program to its end, and return its exit code; None: it took too long.

    Whatever ends the wait (a cancellation as well) ends the program with its process group.

    Args:
        arguments: of robomend-batch.
        folder: in which it runs.
        said: where its output goes.
        lock: a file that it holds as long as it lives.
        most_bytes: of a file that it writes.
        nice: how far it gives way.
        timeout_s: it may run so long.

    Raises:
        OSError: it cannot be started.
    """
    with said.open("ab") as output:
        process = subprocess.Popen(
            [
                sys.executable,
                "-P",
                "-m",
                "robomend.batches.child",
                str(os.getpid()),
                str(most_bytes),
                str(nice),
                *arguments,
            ],
            cwd=folder,
            stdin=subprocess.DEVNULL,
            stdout=output,
            stderr=output,
            start_new_session=True,
            pass_fds=(lock,),
            env=_environment(),
        )
    try:
        async with asyncio.timeout(timeout_s):
            await _ended(process)
    except TimeoutError:
        return None
    finally:
        await _end(process)
    return process.returncode


def _environment() -> dict[str, str]:
    """Return the environment without the service's settings: passwords are among them."""
    return {name: value for name, value in os.environ.items() if not name.startswith("ROBOMEND_")}


async def _ended(process: subprocess.Popen[bytes]) -> None:
    """Wait for the process, by its pidfd; it is not reaped, so that its number stays its own."""
    loop = asyncio.get_running_loop()
    ended = asyncio.Event()
    pidfd = os.pidfd_open(process.pid)
    loop.add_reader(pidfd, ended.set)
    try:
        await ended.wait()
    finally:
        loop.remove_reader(pidfd)
        os.close(pidfd)


async def _end(process: subprocess.Popen[bytes]) -> None:
    """End the process and its group. Its workers are told by it, or killed here."""
    waiting = asyncio.ensure_future(_ended(process))
    try:
        if not (await asyncio.wait({waiting}, timeout=0))[0]:
            os.killpg(process.pid, signal.SIGTERM)
            await asyncio.wait({waiting}, timeout=GRACE_S)
    finally:
        waiting.cancel()
        with contextlib.suppress(ProcessLookupError):
            os.killpg(process.pid, signal.SIGKILL)  # not reaped yet: the number is still its own
        await asyncio.to_thread(process.wait)  # a process that hangs in the disk is waited for


def tail(said: Path) -> str:
    """Return the last lines of what it said."""
    try:
        with said.open("rb") as file:
            file.seek(max(0, file.seek(0, os.SEEK_END) - SAID_BYTES))
            text = file.read().decode(errors="replace")
    except OSError:
        return ""
    return "\n".join(text.strip().splitlines()[-3:])
