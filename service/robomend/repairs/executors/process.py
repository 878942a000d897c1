"""Run a configured program for an action: an argument list, never a shell.

A template such as `["usbreset", "--bus", "{0}"]` names the program; `{0}`, `{1}`, … stand for the action's
parameters (robomend.programs), each of which stays one argument. Only the configured actions run.

Programs are started by the standard library: it has the new process borrow our memory until it is another
program (vfork), 0.5 ms, while the event loop would copy our page tables for it (fork), some 10 ms in which a
service of 100 MB hears of no stop. The end is told by a pidfd (Linux 5.3).
"""

from __future__ import annotations

import asyncio
import contextlib
import os
import signal
import subprocess
from collections.abc import AsyncIterator, Callable, Iterator, Mapping, Sequence
from functools import partial
from typing import Any

from robomend import programs
from robomend.errors import InputError
from robomend.repairs.execution_values import Confirm, nobodys
from robomend.repairs.executors.registry import Surroundings
from robomend_client.actions import (
    FAILED,
    OK,
    REFUSED,
    TIMED_OUT,
    Action,
    ActionResult,
    Executor,
    Feedback,
    not_started,
)

OUTPUT_BYTES = 4096
"""Kept of what a program prints, for the result's message."""

GRACE_S = 0.5
"""From SIGTERM to SIGKILL, and from there to giving up; and from a program's end to that of its output."""


def make(action: str, options: Mapping[str, Any], around: Surroundings) -> Executor:
    """Return the program of the service's settings that the options name (see registry.MakeExecutor)."""
    if options.keys() - {"program"}:
        raise InputError(
            f"actions.{action}: a program's executor takes `program`, a name in the service's settings, and "
            "nothing else: its arguments are in the settings, too"
        )
    name = options.get("program", action)
    if not isinstance(name, str) or name not in around.programs:
        known = ", ".join(sorted(around.programs)) or "none"
        raise InputError(
            f"actions.{action}: the service's settings name no program {name!r} (programs: {known}); "
            "add it there, or let the robot's agent run it"
        )
    return ProcessExecutor({action: around.programs[name]}, around.confirm)


class ProcessExecutor:
    """Runs programs on the service's own computer; the exit status is the result."""

    def __init__(self, commands: Mapping[str, Sequence[str]], confirm: Confirm = nobodys) -> None:
        """
        Args:
            commands: action name -> argument list with {0}, {1}, … for the parameters.
            confirm: see robomend.repairs.execution_values.
        """
        self._confirm = confirm
        self._commands = {name: tuple(template) for name, template in commands.items()}

    async def execute(self, action: Action, feedback: Feedback) -> ActionResult:
        template = self._commands.get(action.name)
        if template is None:
            return ActionResult(REFUSED, f"no program is configured for {action.name!r}")
        try:
            arguments = programs.arguments(template, action.parameters)
        except programs.Unfit as error:
            return ActionResult(REFUSED, f"the program of {action} {error}")
        await self._confirm()
        try:
            process = subprocess.Popen(
                arguments,
                stdin=subprocess.DEVNULL,
                stdout=subprocess.PIPE,
                stderr=subprocess.STDOUT,
                start_new_session=True,  # so that a time-out ends its children too
            )
        except (OSError, ValueError) as error:
            return ActionResult(not_started(error), f"{arguments[0]}: {error}")
        kept = bytearray()
        with _tail_kept(process, kept, partial(feedback, process.pid)) as read:
            async with _ended(process) as ended:
                feedback(process.pid, f"{arguments[0]} started")
                try:
                    async with asyncio.timeout(action.timeout_s):
                        await ended.wait()
                except TimeoutError:
                    return ActionResult(TIMED_OUT, f"{arguments[0]} was ended after {action.timeout_s:g} s")
            # What it leaves running may keep the pipe open for ever.
            with contextlib.suppress(TimeoutError):
                async with asyncio.timeout(GRACE_S):
                    await read.wait()
        output = kept.decode(errors="replace").strip()
        status = process.wait()
        if status == 0:
            return ActionResult(OK, output)
        return ActionResult(status if status > 0 else FAILED, f"{arguments[0]} ended with {status}: {output}")


@contextlib.asynccontextmanager
async def _ended(process: subprocess.Popen[bytes]) -> AsyncIterator[asyncio.Event]:
    """Tell when a program has ended. On leaving it is ended: politely, then for good, with its children."""
    loop = asyncio.get_running_loop()
    ended = asyncio.Event()
    pidfd = os.pidfd_open(process.pid)
    loop.add_reader(pidfd, ended.set)
    try:
        yield ended
    finally:
        try:
            for how in (signal.SIGTERM, signal.SIGKILL):
                if not ended.is_set():
                    os.killpg(process.pid, how)  # not reaped yet, so that the number is still its own
                    with contextlib.suppress(TimeoutError):
                        async with asyncio.timeout(GRACE_S):
                            await ended.wait()
        finally:
            loop.remove_reader(pidfd)
            os.close(pidfd)
            process.poll()


@contextlib.contextmanager
def _tail_kept(
    process: subprocess.Popen[bytes], kept: bytearray, say: Callable[[str], None]
) -> Iterator[asyncio.Event]:
    """Keep the last of what a program prints, and say its latest line; the event is set at the output's end.

    By the descriptor: uvloop's transport of a pipe closes it twice, and in between another thread may have
    been given its number, for a worker's socket or the database.
    """
    assert process.stdout is not None
    loop = asyncio.get_running_loop()
    descriptor = process.stdout.fileno()
    os.set_blocking(descriptor, False)
    read = asyncio.Event()

    def more() -> None:
        try:
            chunk = os.read(descriptor, OUTPUT_BYTES)
        except BlockingIOError:
            return
        if not chunk:
            loop.remove_reader(descriptor)
            read.set()
            return
        kept.extend(chunk)
        del kept[:-OUTPUT_BYTES]
        line = kept.decode(errors="replace").rstrip().rpartition("\n")[2]
        if line:
            say(line)

    loop.add_reader(descriptor, more)
    try:
        yield read
    finally:
        loop.remove_reader(descriptor)
        process.stdout.close()
