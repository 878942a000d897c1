"""One supervised process: start it, see that it runs, stop it.

    stopped ──start──► starting ──evidence──► running ──stop──► stopping ──end──► stopped
       ▲                  │ no evidence in time: ended            │ its own end
       └──────────────────┴───────────────────────────────────────┘

`running` is what the node observer reports: there was evidence (Notification), and the process is alive, and
not halted: stopped by a signal, or hung in the kernel. Its end is known at once, through its pidfd. Starts
and stops of one process take turns; those of different processes do not wait for each other.
"""

from __future__ import annotations

import asyncio
import contextlib
import logging
import os
import re
import secrets
import shutil
import signal
import socket
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, Literal
from urllib.parse import quote

from robomend_client.actions import (
    FAILED,
    NO_PROGRAM,
    NOT_EXECUTABLE,
    OK,
    TIMED_OUT,
    ActionResult,
    Feedback,
    not_started,
)
from robomend_client.agent.config import ProcessSpec
from robomend_client.agent.spawn import Handle, NotStarted, described, halted, spawn, stuck, waits_in
from robomend_client.python310 import StrEnum, timeout
from robomend_client.readings import MAX_TEXT

# --- what a process prints, in a file with a bound: NAME.log, and NAME.log.1 with what was before.
#
# Together they hold at most the bound. Normally the agent reads the process's output and writes it here. A
# process that is to outlive the agent writes to the file itself, and the agent cuts it back now and then.


class OutputFile:
    """The output of one process, over all its starts."""

    def __init__(self, folder: Path, name: str, most_bytes: int) -> None:
        self.file = folder / f"{quote(name, safe='')}.log"  # names of nodes may hold slashes
        self._half = most_bytes // 2
        self._failed = False

    @property
    def before(self) -> Path:
        return self.file.with_name(f"{self.file.name}.1")

    def write(self, data: bytes) -> None:
        """Append; a disk that is full must not stop the robot's agent."""
        try:
            self.file.parent.mkdir(parents=True, exist_ok=True)
            with self.file.open("ab") as file:
                if file.tell() + len(data) > self._half:
                    self.file.replace(self.before)
                    self.file.write_bytes(data[-self._half :])
                else:
                    file.write(data)
        except OSError as error:
            if not self._failed:
                log.error("the output of a process is lost: %s: %s", self.file, error)
            self._failed = True

    def open(self) -> int | None:
        """Return a descriptor for a process that writes by itself; None if the file cannot be written."""
        try:
            self.file.parent.mkdir(parents=True, exist_ok=True)
            return os.open(self.file, os.O_WRONLY | os.O_APPEND | os.O_CREAT | os.O_CLOEXEC, 0o644)
        except OSError as error:
            log.error("the output of a process is lost: %s: %s", self.file, error)
            return None

    def trim(self) -> None:
        """Cut back what a process has written by itself: it goes on at the beginning of the emptied file."""
        with contextlib.suppress(OSError):
            if self.file.stat().st_size > self._half:
                shutil.copyfile(self.file, self.before)
                os.truncate(self.file, 0)
                if self.before.stat().st_size > self._half:  # it was fast: the newest part counts
                    with self.before.open("rb+") as file:
                        file.seek(-self._half, os.SEEK_END)
                        newest = file.read()
                        file.seek(0)
                        file.truncate()
                        file.write(newest)

    def tail(self, most_bytes: int) -> bytes:
        """Return the newest output."""
        with contextlib.suppress(OSError), self.file.open("rb") as file:
            file.seek(max(0, file.seek(0, os.SEEK_END) - most_bytes))
            return file.read()
        return b""


# --- what counts as evidence that a process runs, so that nothing waits for a fixed time:
#
#     exec      the program was executed: true once `spawn` has returned
#     notify    it sent READY=1, systemd's sd_notify(3): a datagram to the socket in NOTIFY_SOCKET
#     output    a line of its output matches


class Notification:
    """The socket for one start of one process: a random name in Linux's abstract namespace, gone with us."""

    def __init__(self, ready: asyncio.Event) -> None:
        self._ready = ready
        self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM | socket.SOCK_NONBLOCK)
        self._name = f"robomend-notify-{secrets.token_hex(8)}"
        self._socket.bind(f"\0{self._name}")
        asyncio.get_running_loop().add_reader(self._socket, self._receive)

    @property
    def address(self) -> str:
        return f"@{self._name}"

    def _receive(self) -> None:
        try:
            datagram = self._socket.recv(4096)
        except OSError:
            return
        if b"READY=1" in datagram.split(b"\n"):
            self._ready.set()

    def close(self) -> None:
        if self._socket.fileno() >= 0:
            asyncio.get_running_loop().remove_reader(self._socket)
            self._socket.close()


log = logging.getLogger(__name__)

TAIL = 8 * 1024
"""Bytes of a process's newest output that are kept, to be quoted when it fails."""

STARTED = b"--- started by robomend-agent"

STUCK_S = 5.0
"""A process that waits in the kernel for so long, and does nothing meanwhile, is halted: disks take less."""

LAST_LINES = 3

KILL_S = 2.0
"""How long the kernel may take after SIGKILL; a process in uninterruptible sleep takes longer."""


class Phase(StrEnum):
    STOPPED = "stopped"
    STARTING = "starting"
    RUNNING = "running"
    STOPPING = "stopping"


class SupervisedProcess:
    """A process that the configuration allows, running or not."""

    def __init__(
        self,
        spec: ProcessSpec,
        environment: Mapping[str, str],
        on_change: Callable[[SupervisedProcess], None],
        dies_with_agent: bool = True,
        output: OutputFile | None = None,
        guard: Callable[[], int | None] = lambda: None,
    ) -> None:
        self.spec = spec
        self.phase = Phase.STOPPED
        self.exit_code: int | None = None
        self.handle: Handle | None = None
        self._environment = dict(environment)
        self._on_change = on_change
        self._dies_with_agent = dies_with_agent
        self._output = output
        self._guard = guard
        self._turn = asyncio.Lock()
        self._ready = asyncio.Event()
        self._ended = asyncio.Event()
        self._ended.set()
        self._tail = b""
        self._began = False  # ever
        self._was_stopped = False
        self._stuck: tuple[float, int] | None = None  # since when, and the processor time used by then

    @property
    def running(self) -> bool:
        return self.phase in (Phase.RUNNING, Phase.STOPPING)

    @property
    def resting(self) -> bool:
        """Whether it does not run by order: it was stopped, or never started."""
        return not self.running and (self._was_stopped or not self._began)

    async def start(self, feedback: Feedback, timeout_s: float) -> ActionResult:
        """Start it and wait for the evidence; a process that runs already is left alone."""
        async with timeout(timeout_s), self._turn:
            if self.phase is Phase.RUNNING and self.handle is not None:
                # The planner has taken it for stopped: the answer begins with what is otherwise.
                halted = self.halted()
                why = f", and is halted ({halted}): stop it first" if halted else ""
                return ActionResult(OK, f"runs already: {self.spec.name} is process {self.handle.pid}{why}")
            await self._ended.wait()  # an earlier stop or start that failed may still be at work
            began = time.monotonic()
            notification = Notification(self._ready) if self.spec.ready == "notify" else None
            try:
                self._begin(notification)
                pid = self.handle.pid if self.handle else "?"
                feedback(1, f"{self.spec.name} has process {pid}; waiting for evidence: {self.spec.ready}")
                return await self._evidence(began)
            except NotStarted as error:
                return ActionResult(
                    not_started(error.__cause__), f"{self.spec.name} cannot be started: {error}"
                )
            finally:
                if notification is not None:
                    notification.close()
                if self.phase is Phase.STARTING:  # no evidence, or cancelled: leave no half-started process
                    self._kill()

    async def stop(self, feedback: Feedback, timeout_s: float) -> ActionResult:
        """Stop it: SIGTERM, and SIGKILL after the grace. One that does not run is left alone."""
        async with timeout(timeout_s), self._turn:
            handle = self.handle
            if handle is None:
                return ActionResult(OK, f"{self.spec.name} does not run")
            self._change(Phase.STOPPING)
            handle.signal_group(signal.SIGTERM)
            handle.signal_group(signal.SIGCONT)  # one that is halted hears nothing else
            feedback(1, f"{self.spec.name} was asked to end")
            grace_s = min(self.spec.stop_grace_s, 0.8 * timeout_s)  # some of the time is for SIGKILL
            how = "ended"
            if not await self._wait_for_end(grace_s):
                how = f"did not end within {grace_s:g} s and was killed"
                feedback(1, f"{self.spec.name} does not end: SIGKILL")
                handle.signal_group(signal.SIGKILL)
                if not await self._wait_for_end(KILL_S):
                    return ActionResult(FAILED, f"{self.spec.name} (process {handle.pid}) does not die")
            return ActionResult(OK, f"{self.spec.name} {how}")

    async def kill(self) -> None:
        """End it without a word, as a crash does, and wait for its end."""
        async with self._turn:
            self._kill()
            if not await self._wait_for_end(KILL_S):
                log.warning("%s does not die", self.spec.name)

    async def freeze(self) -> None:
        """Halt it with all that it started; it goes on running, as far as anybody can see."""
        async with self._turn:
            if self.handle is not None:
                self.handle.signal_group(signal.SIGSTOP)

    def thaw(self) -> None:
        """Let it go on; nothing happens to one that was not halted."""
        if self.handle is not None:
            self.handle.signal_group(signal.SIGCONT)

    async def replace(self, other: Handle) -> bool:
        """Kill it, and let `other` stand in its place; nobody sees that nothing runs in between.

        Return whether it was there to be replaced; else `other` is ended.
        """
        async with self._turn:
            old = self.handle
            if old is None or self.phase is not Phase.RUNNING:
                other.reap()
                other.close()
                return False
            loop = asyncio.get_running_loop()
            gone = asyncio.Event()
            loop.remove_reader(old.pidfd)
            if old.output is not None:
                loop.remove_reader(old.output)
            loop.add_reader(old.pidfd, gone.set)
            # First the end of the old one: were the agent killed in between, there would be two of it later.
            old.signal_group(signal.SIGKILL)
            try:
                async with timeout(KILL_S):
                    await gone.wait()
                old.reap()
            except TimeoutError:
                log.warning("%s does not die", self.spec.name)
            loop.remove_reader(old.pidfd)
            old.close()
            self._hold(other)
            self._change(Phase.RUNNING)
            return True

    def halted(self) -> str:
        """Return why it does not run, though its process is there; nothing: it does."""
        if self.handle is None:
            self._stuck = None
            return ""
        pid = self.handle.pid
        why = halted(pid)
        if why:
            return why
        waits, used = stuck(pid)
        now_s = time.monotonic()
        if not waits or self._stuck is None or self._stuck[1] != used:
            self._stuck = (now_s, used) if waits else None
        elif now_s - self._stuck[0] >= STUCK_S:
            where = waits_in(pid)
            return f"hung in the kernel{f' ({where})' if where else ''} for {now_s - self._stuck[0]:.0f} s"
        return ""

    def state(self) -> Literal[True] | dict[str, str]:
        """Return whether it runs, or why not: as the node observer takes it."""
        if self.running:
            why = self.halted()
            return {"why": why, "symptom": "halted"} if why else True
        return {"why": self._why_ended(), "symptom": "ended"}

    def described(self) -> str:
        """Return how it is, for people: why it does not run, or what it does."""
        state = self.state()
        why = "" if state is True else state["why"]
        now = described(self.handle.pid) if self.handle is not None else ""
        return "; ".join(filter(None, (why, now))) or "runs"

    def adopted(self, handle: Handle) -> None:
        """Take over a process that an earlier agent started and that still runs."""
        self._hold(handle)
        self._change(Phase.RUNNING)

    def output_tail(self, most_bytes: int) -> str:
        """Return the newest output, from before the last start, too, as far as it is kept in a file."""
        if self._output is None:
            return self.tail()
        return self._output.tail(most_bytes).decode("utf-8", "replace")

    def tail(self) -> str:
        """Return the newest output, for people."""
        tail = self._tail if self._dies_with_agent else self._own_output()
        return tail.decode("utf-8", "replace").strip()

    def trim_output(self) -> None:
        """Keep the file within its bound that a process writes by itself."""
        if not self._dies_with_agent and self._output is not None:
            self._output.trim()

    # --- inside ----------------------------------------------------------------------------------------

    def _begin(self, notification: Notification | None) -> None:
        environment = self._environment | dict(self.spec.environment) | {"ROBOMEND_NODE": self.spec.name}
        environment.pop("NOTIFY_SOCKET", None)  # the agent's own, under systemd, is not for its children
        if notification is not None:
            environment["NOTIFY_SOCKET"] = notification.address
        self._tail = b""
        self._ready.clear()
        output_to = None
        if self._output is not None:
            self._output.write(STARTED + time.strftime(" %Y-%m-%dT%H:%M:%S%z\n").encode())
            output_to = None if self._dies_with_agent else self._output.open()
        try:
            self._hold(
                spawn(
                    self.spec.command,
                    self.spec.directory,
                    environment,
                    self._dies_with_agent,
                    output_to,
                    self._guard(),
                )
            )
        finally:
            if output_to is not None:
                os.close(output_to)
        if self.spec.ready == "exec":
            self._ready.set()
        self._change(Phase.STARTING)

    async def _evidence(self, began: float) -> ActionResult:
        waits: list[asyncio.Task[Any]] = [
            asyncio.create_task(event.wait()) for event in (self._ready, self._ended)
        ]
        if self.spec.ready_output is not None and not self._dies_with_agent:
            waits.append(asyncio.create_task(self._look_for_output(self.spec.ready_output)))
        try:
            await asyncio.wait(waits, timeout=self.spec.start_timeout_s, return_when=asyncio.FIRST_COMPLETED)
        finally:
            for wait in waits:
                wait.cancel()
        if self._ended.is_set():
            plain = self.exit_code in {NO_PROGRAM, NOT_EXECUTABLE}  # of a shell between us and the program
            code = self.exit_code if plain and self.exit_code is not None else FAILED
            return ActionResult(
                code, f"{self.spec.name} ended at once, exit code {self.exit_code}{self._quoted()}"
            )
        if not self._ready.is_set():
            return ActionResult(
                TIMED_OUT,
                f"{self.spec.name} gave no sign of running ({self.spec.ready}) within "
                f"{self.spec.start_timeout_s:g} s and was ended{self._quoted()}",
            )
        self._change(Phase.RUNNING)
        return ActionResult(OK, f"{self.spec.name} runs after {time.monotonic() - began:.2f} s")

    async def _look_for_output(self, ready: re.Pattern[bytes]) -> None:
        """Read along in the file that a process writes by itself, until it says that it is ready."""
        while not ready.search(self._own_output()):
            await asyncio.sleep(0.05)
        self._ready.set()

    def _own_output(self) -> bytes:
        """Return the newest output since the start, of a process that writes to the file by itself."""
        if self._output is None:
            return b""
        return self._output.tail(TAIL).rpartition(STARTED)[2].partition(b"\n")[2]

    def _hold(self, handle: Handle) -> None:
        self.handle = handle
        self.exit_code = None
        self._began = True
        self._was_stopped = False
        self._ended.clear()
        loop = asyncio.get_running_loop()
        loop.add_reader(handle.pidfd, self._end)
        if handle.output is not None:
            loop.add_reader(handle.output, self._read_output)

    def _end(self) -> None:
        """The process has ended: its pidfd became readable."""
        handle = self.handle
        if handle is None:
            return
        loop = asyncio.get_running_loop()
        loop.remove_reader(handle.pidfd)
        self._read_output()
        if handle.output is not None:
            loop.remove_reader(handle.output)
        self.exit_code = handle.reap()
        handle.close()
        self.handle = None
        self._ended.set()
        self._was_stopped = self.phase is Phase.STOPPING
        if self.phase is Phase.RUNNING:
            log.warning("%s ended by itself, exit code %s%s", self.spec.name, self.exit_code, self._quoted())
        self._change(Phase.STOPPED)

    def _read_output(self) -> None:
        handle = self.handle
        if handle is None or handle.output is None:
            return
        try:
            data = os.read(handle.output, 65536)
        except BlockingIOError:
            return
        if not data:
            asyncio.get_running_loop().remove_reader(handle.output)  # it closed its output and lives on
            return
        if self._output is not None:
            self._output.write(data)
        self._tail = (self._tail + data)[-TAIL:]
        if self.spec.ready_output is not None and self.spec.ready_output.search(self._tail):
            self._ready.set()

    def _kill(self) -> None:
        if self.handle is not None:
            self.handle.signal_group(signal.SIGKILL)

    async def _wait_for_end(self, seconds: float) -> bool:
        try:
            async with timeout(seconds):
                await self._ended.wait()
        except TimeoutError:
            return False
        return True

    def _why_ended(self) -> str:
        if self.phase is Phase.STARTING:
            return "is being started"
        if self._was_stopped:
            return "was stopped by the agent"
        code = self.exit_code
        if code is None:
            return "not started" if not self._began else "ended; its exit code is not known"
        how = f"exit code {code}" if code >= 0 else f"ended by {_signal(-code)}"
        last = [line.strip() for line in self.tail().splitlines() if line.strip()][-LAST_LINES:]
        return f"{how}: {'; '.join(last)}"[:MAX_TEXT] if last else how

    def _quoted(self) -> str:
        tail = self.tail()
        return f"; its last output: {tail[-500:]}" if tail else ""

    def _change(self, phase: Phase) -> None:
        self.phase = phase
        self._on_change(self)


def _signal(number: int) -> str:
    try:
        return signal.Signals(number).name
    except ValueError:
        return f"signal {number}"
