"""Run a configured program for an action: an argument list, never a shell.

A template such as `["usbreset", "--bus", "{0}"]` names the program; `{0}`, `{1}`, … stand for the action's
parameters, each of which stays one argument whatever it holds. Only the configured actions run.
"""

from __future__ import annotations

import asyncio
import contextlib
import os
import re
import signal
from collections.abc import Mapping, Sequence

from robomend_client.actions import (
    FAILED,
    OK,
    REFUSED,
    TIMED_OUT,
    UNREACHABLE,
    Action,
    ActionResult,
    Feedback,
)

OUTPUT_BYTES = 4096
"""Kept of what a program prints, for the result's message."""

PLACE = re.compile(r"\{(\d+)\}")


class ProcessExecutor:
    """Runs programs on the service's own computer; the exit status is the result."""

    def __init__(self, commands: Mapping[str, Sequence[str]]) -> None:
        """`commands`: action name -> argument list with {0}, {1}, … for the parameters."""
        self._commands = {name: tuple(template) for name, template in commands.items()}

    async def execute(self, action: Action, feedback: Feedback) -> ActionResult:
        template = self._commands.get(action.name)
        if template is None:
            return ActionResult(REFUSED, f"no program is configured for {action.name!r}")
        try:
            arguments = [PLACE.sub(lambda m: action.parameters[int(m[1])], part) for part in template]
        except IndexError:
            return ActionResult(
                REFUSED, f"the program of {action.name!r} wants more parameters than {action}"
            )
        try:
            process = await asyncio.create_subprocess_exec(
                *arguments,
                stdin=asyncio.subprocess.DEVNULL,
                stdout=asyncio.subprocess.PIPE,
                stderr=asyncio.subprocess.STDOUT,
                start_new_session=True,  # so that a time-out ends its children too
            )
        except (OSError, ValueError) as error:
            return ActionResult(UNREACHABLE, f"{arguments[0]}: {error}")
        feedback(process.pid, f"{arguments[0]} started")
        try:
            async with asyncio.timeout(action.timeout_s):
                output = await _tail(process)
                status = await process.wait()
        except TimeoutError:
            return ActionResult(TIMED_OUT, f"{arguments[0]} was ended after {action.timeout_s:g} s")
        finally:
            await _end(process)
        if status == 0:
            return ActionResult(OK, output)
        return ActionResult(status if status > 0 else FAILED, f"{arguments[0]} ended with {status}: {output}")


async def _tail(process: asyncio.subprocess.Process) -> str:
    assert process.stdout is not None
    kept = b""
    while chunk := await process.stdout.read(OUTPUT_BYTES):
        kept = (kept + chunk)[-OUTPUT_BYTES:]
    return kept.decode(errors="replace").strip()


async def _end(process: asyncio.subprocess.Process) -> None:
    """End a program that did not end by itself, with its children: politely, then for good."""
    if process.returncode is not None:
        return
    for how in (signal.SIGTERM, signal.SIGKILL):
        with contextlib.suppress(ProcessLookupError):
            os.killpg(process.pid, how)
        with contextlib.suppress(TimeoutError):
            async with asyncio.timeout(0.5):
                await process.wait()
