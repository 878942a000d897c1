"""The kind `process`: a program that is run to its end; its exit code says whether it did what it should.

    calibrate: {kind: process, command: [/opt/robot/calibrate, --arm, "{arm}"], parameters: {arm: [left,
    right]}}

`{arm}` in an argument is replaced by the action's parameter, which is one of the list. The arguments go to
the program as they are: no shell reads them.
"""

from __future__ import annotations

import asyncio
import contextlib
import os
import re
import shutil
import signal
from collections.abc import Mapping, Sequence
from pathlib import Path

from robomend_client.actions import FAILED, OK, Action, ActionResult, Feedback
from robomend_client.python310 import timeout

TAIL = 8 * 1024
"""Bytes of a program's newest output that are kept, to be quoted."""

QUOTED = 500

TAKES_S = 30.0
"""What a program may take of which nothing else is said: one with rclpy needs seconds to begin."""

END_S = 0.5
"""From SIGTERM to SIGKILL for a program that is not wanted any more; the caller gives a second for both."""

PLACE = re.compile(r"\{([^{}]*)\}")


class Program:
    """Runs one program."""

    def __init__(
        self,
        name: str,
        command: Sequence[str],
        base: Path,
        parameters: Mapping[str, Sequence[str]] | None = None,
        directory: str | None = None,
        environment: Mapping[str, str] | None = None,
        gives_up: bool = False,
        timeout_s: float = TAKES_S,
    ) -> None:
        """
        Args:
            name: the action, as the plan has it; by default the entry's name.
            command: the program and its arguments, a list that no shell reads; `{NAME}` stands for a
                parameter.
            base: the folder of the agent's file.
            parameters: name → what it may be, in the order in which the action has them.
            directory: working directory, relative to the agent's file; by default the agent's.
            environment: variables beside the agent's own.
            gives_up: whether a program that is cut off leaves things as they were.
            timeout_s: how long it may take, in seconds; the robot's configuration at the service may say less
                or more.
        """
        if not timeout_s > 0:
            raise ValueError("timeout_s must be above 0")
        if not command or not command[0]:
            raise ValueError("command must be a list of the program and its arguments")
        self.name = name
        self.gives_up = gives_up
        self.takes_s = timeout_s
        self.parameters = tuple(tuple(values) for values in (parameters or {}).values())
        self._names = tuple(parameters or {})
        if PLACE.search(command[0]):
            raise ValueError("command must name its program itself: only arguments take parameters")
        for argument in command:
            for place in PLACE.findall(argument):
                if place not in self._names:
                    known = ", ".join(self._names) or "none"
                    raise ValueError(f"command has a place for {{{place}}}, but the parameters are: {known}")
        self._command = tuple(command)
        self._directory = base / directory if directory else None
        self._environment = dict(environment or {})

    def missing(self) -> str | None:
        """Say why its program cannot be started on this computer; None: it is there."""
        return missing(self._command[0], self._directory, self._environment)

    async def execute(self, action: Action, feedback: Feedback) -> ActionResult:
        values = dict(zip(self._names, action.parameters, strict=True))
        command = [PLACE.sub(lambda place: values[place[1]], argument) for argument in self._command]
        return await run(command, str(action), feedback, self._directory, self._environment)


def missing(program: str, directory: Path | None, environment: Mapping[str, str]) -> str | None:
    """Say why a program cannot be started on this computer, and what to write instead; None: it is there."""
    where = environment.get("PATH", os.environ.get("PATH", os.defpath))
    if directory is not None and not directory.is_dir():
        return f"directory {directory} is not there: make it, or name another"
    if os.sep not in program:
        if shutil.which(program, path=where):
            return None
        return f"no program {program!r} is in the PATH ({where}): install it, or write its whole path"
    path = (directory or Path.cwd()) / program
    if not path.is_file():
        return f"there is no file {path}: write the program's whole path"
    return None if os.access(path, os.X_OK) else f"{path} may not be executed: chmod +x {path}"


async def run(
    command: Sequence[str],
    what: str,
    feedback: Feedback,
    directory: Path | None = None,
    environment: Mapping[str, str] | None = None,
) -> ActionResult:
    """Run a program to its end; cancelled, end it and all that it started."""
    try:
        code, said = await ended(command, what, feedback, directory, environment)
    except (OSError, ValueError) as error:
        return ActionResult(FAILED, f"{command[0]} cannot be started: {error}")
    quoted = f"; its last output: {said[-QUOTED:]}" if said else ""
    if code == 0:
        return ActionResult(OK, f"{what} is done{quoted}")
    how = f"was ended by signal {-code}" if code < 0 else f"failed with exit code {code}"
    return ActionResult(FAILED, f"{what} {how}{quoted}")


async def ended(
    command: Sequence[str],
    what: str,
    feedback: Feedback,
    directory: Path | None = None,
    environment: Mapping[str, str] | None = None,
) -> tuple[int, str]:
    """Run a program as `run` does; return its exit code and the newest of its output.

    Raises:
        OSError, ValueError: it cannot be started.
    """
    process = await asyncio.create_subprocess_exec(
        *command,
        cwd=directory,
        env={**os.environ, **(environment or {})},
        stdin=asyncio.subprocess.DEVNULL,
        stdout=asyncio.subprocess.PIPE,
        stderr=asyncio.subprocess.STDOUT,
        start_new_session=True,
    )
    feedback(1, f"{what} runs as process {process.pid}")
    assert process.stdout is not None
    tail = b""
    try:
        while data := await process.stdout.read(65536):
            tail = (tail + data)[-TAIL:]
        code = await process.wait()
    finally:
        await asyncio.shield(_end(process))
    return code, tail.decode("utf-8", "replace").strip()


async def _end(process: asyncio.subprocess.Process) -> None:
    """End what is left of a program and of what it started."""
    if process.returncode is None:
        _signal(process.pid, signal.SIGTERM)
        await asyncio.wait([asyncio.ensure_future(process.wait())], timeout=END_S)
    _signal(process.pid, signal.SIGKILL)
    await process.wait()
    if process.stdout is not None:  # to its end, or the loop holds on to the pipe
        with contextlib.suppress(TimeoutError):  # a process that left the group may keep it open
            async with timeout(END_S):
                while await process.stdout.read(65536):
                    pass


def _signal(group: int, number: int) -> None:
    with contextlib.suppress(ProcessLookupError, PermissionError):
        os.killpg(group, number)
