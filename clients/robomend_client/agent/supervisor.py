"""All processes of one agent: the allow-list, the guard, and the table that outlives the agent.

The table (state_dir/processes.json) holds pid and start time of what runs, so that an agent that comes back
adopts what its predecessor left running instead of starting it twice. Start times count from the boot, so
the table also says which boot it was: after a restart of the computer nothing is adopted. Nor is what was to
end with an agent that was killed: its guard may be ending that already, so it is ended, and can start anew.
"""

from __future__ import annotations

import asyncio
import json
import logging
import os
import subprocess
import sys
from collections.abc import Callable, Iterable
from pathlib import Path

from robomend_client.actions import ActionResult
from robomend_client.agent import guard
from robomend_client.agent.config import ProcessSpec
from robomend_client.agent.processes import OutputFile, SupervisedProcess
from robomend_client.agent.spawn import adopt, boot_id
from robomend_client.bus import ENVIRONMENT as BUS

log = logging.getLogger(__name__)


class Supervisor:
    """The processes that the configuration lists; no others can be named here."""

    def __init__(
        self,
        specs: Iterable[ProcessSpec],
        state_dir: Path,
        bus: str,
        keep: bool,
        on_change: Callable[[], None],
    ) -> None:
        environment = dict(os.environ) | {BUS: bus}
        self.processes = {
            spec.name: SupervisedProcess(
                spec, environment, self._changed, not keep, _output(spec, state_dir), self._guard_pipe
            )
            for spec in specs
        }
        self._booting = {name for name, process in self.processes.items() if process.spec.start}
        self._keep = keep
        self._table = state_dir / "processes.json"
        self._boot = boot_id()
        self._on_change = on_change
        self._guarded: dict[str, int] = {}
        self._guard: subprocess.Popen[bytes] | None = None
        self._leftovers: list[asyncio.Task[ActionResult]] = []

    def table(self) -> dict[str, bool | dict[str, str] | None]:
        """Return which processes run, and of others why not; None of those that start with the agent."""
        return {
            name: None if name in self._booting and not process.running else process.state()
            for name, process in self.processes.items()
        }

    def open(self) -> None:
        """Adopt what an earlier agent left, and put up the guard."""
        if not self._keep:
            self._guard = subprocess.Popen(
                [sys.executable, "-I", "-S", guard.__file__], stdin=subprocess.PIPE, start_new_session=True
            )
        for name, (pid, ticks, kept) in self._read_table().items():
            process = self.processes.get(name)
            handle = adopt(pid, ticks) if process is not None else None
            if process is None or handle is None:
                continue
            process.adopted(handle)
            if kept:
                log.info("%s still runs as process %d: adopted", name, pid)
            else:
                log.info("%s still runs as process %d, whose agent was killed: ended", name, pid)
                # Begins now, so before any start of it: starts and stops of one process take turns.
                self._leftovers.append(asyncio.create_task(self._stop(process), name=f"leftover {name}"))

    def leaders(self) -> dict[str, int]:
        """Return the process of each node that runs."""
        return {
            name: process.handle.pid
            for name, process in self.processes.items()
            if process.running and process.handle is not None
        }

    def trim_outputs(self) -> None:
        """Keep the files within their bounds that processes write by themselves."""
        for process in self.processes.values():
            process.trim_output()

    async def start_initial(self) -> None:
        """Start those that are to be started with the agent, side by side."""
        await asyncio.gather(*(self._start_initial(self.processes[name]) for name in tuple(self._booting)))

    async def _start_initial(self, process: SupervisedProcess) -> None:
        try:
            # The end of a leftover may have to be awaited first.
            most_s = process.spec.start_timeout_s + process.spec.stop_grace_s + 4.0
            log.info("%s: %s", process.spec.name, await process.start(_log_only, most_s))
        except TimeoutError:
            log.error("%s was not started in time", process.spec.name)
        finally:
            self._booting.discard(process.spec.name)
            self._on_change()

    async def close(self) -> None:
        """End what runs, all at once, unless it is to be kept; then the guard."""
        await asyncio.gather(*self._leftovers, return_exceptions=True)
        if not self._keep:
            stopping = [
                self._stop(process) for process in self.processes.values() if process.handle is not None
            ]
            for result in await asyncio.gather(*stopping, return_exceptions=True):
                if isinstance(result, BaseException):
                    log.error("a process could not be stopped: %s", result)
        if self._guard is not None and self._guard.stdin is not None:
            # Its input ends; it takes care of what may be left, and ends within its grace.
            self._guard.stdin.close()
            try:
                await asyncio.to_thread(self._guard.wait, guard.GRACE_S + 1.0)
            except subprocess.TimeoutExpired:
                self._guard.kill()
                self._guard.wait()

    async def _stop(self, process: SupervisedProcess) -> ActionResult:
        return await process.stop(_log_only, process.spec.stop_grace_s + 3.0)

    # --- the table and the guard --------------------------------------------------------------------------

    def _changed(self, process: SupervisedProcess) -> None:
        name, handle = process.spec.name, process.handle
        before = self._guarded.get(name)
        if (handle.pid if handle else None) != before:
            if before is not None:
                del self._guarded[name]
                self._tell_guard(f"-{before}\n")
            if handle is not None:
                self._guarded[name] = handle.pid
                self._tell_guard(f"+{handle.pid}\n")
            self._write_table()
        self._on_change()

    def _guard_pipe(self) -> int | None:
        """Return where the guard is told, if there is one."""
        pipe = self._guard.stdin if self._guard is not None else None
        return None if pipe is None or pipe.closed else pipe.fileno()

    def _tell_guard(self, line: str) -> None:
        if (pipe := self._guard_pipe()) is None:
            return
        try:
            os.write(pipe, line.encode())
        except OSError as error:
            log.error("the guard is gone (%s): processes get only their parent-death signal", error)
            self._guard = None

    def _write_table(self) -> None:
        table = {
            name: {
                "pid": process.handle.pid,
                "start_ticks": process.handle.start_ticks,
                "boot": self._boot,
                "kept": self._keep,
            }
            for name, process in self.processes.items()
            if process.handle is not None
        }
        temporary = self._table.with_suffix(".new")
        try:
            temporary.write_text(json.dumps(table))
            temporary.replace(self._table)
        except OSError as error:  # a full disk must not stop a repair
            log.error("cannot write %s: %s", self._table, error)

    def _read_table(self) -> dict[str, tuple[int, int, bool]]:
        try:
            table = json.loads(self._table.read_text())
            return {
                str(name): (int(row["pid"]), int(row["start_ticks"]), bool(row["kept"]))
                for name, row in table.items()
                if row["boot"] == self._boot
            }
        except FileNotFoundError:
            return {}
        except (OSError, ValueError, KeyError, TypeError, AttributeError) as error:
            log.warning("%s cannot be read (%s): nothing is adopted", self._table, error)
            return {}


def _output(spec: ProcessSpec, state_dir: Path) -> OutputFile | None:
    most_bytes = round(spec.log_mb * 1024 * 1024)
    return OutputFile(state_dir / "logs", spec.name, most_bytes) if most_bytes else None


def _log_only(number: int, message: str) -> None:
    log.debug("%s", message)
