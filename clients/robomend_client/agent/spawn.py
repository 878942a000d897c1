"""Starting a process so that it can be watched and ended without doubt: the calls to the operating system.

Each process leads a session and process group of its own, so that a stop reaches what it started in turn. A
pidfd (Linux 5.3) tells its end at once and never means another process that got the same number. Commands are
argument lists; nothing here goes through a shell.
"""

from __future__ import annotations

import ctypes
import os
import signal
import subprocess
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

PR_SET_PDEATHSIG = 1

LONGEST_CHAIN = 8

_libc = ctypes.CDLL(None, use_errno=True)  # loaded here: the child between fork and exec must not import


class NotStarted(Exception):
    """The program could not be started; the message says why."""


@dataclass(slots=True)
class Handle:
    """A process, as something to wait for. `child` is None for one that an earlier agent started."""

    pid: int
    pidfd: int
    start_ticks: int
    child: subprocess.Popen[bytes] | None
    output: int | None  # the read end of its output

    def signal_group(self, number: int) -> None:
        """Send a signal to the process and all that it started."""
        try:
            os.killpg(self.pid, number)
        except ProcessLookupError:
            pass
        except PermissionError:  # a group of set-uid programs: at least the leader
            signal.pidfd_send_signal(self.pidfd, number)

    def reap(self) -> int | None:
        """Take the end of the process, which has come; return its exit code, if it is ours to know."""
        # The leader is a zombie until wait() below, so its group cannot be anyone else's: what is left of it
        # goes now.
        self.signal_group(signal.SIGKILL)
        return self.child.wait() if self.child is not None else None

    def close(self) -> None:
        os.close(self.pidfd)
        if self.output is not None:
            os.close(self.output)


def spawn(
    command: tuple[str, ...],
    directory: Path | None,
    environment: Mapping[str, str],
    dies_with_agent: bool,
    output_to: int | None = None,
    guard: int | None = None,
) -> Handle:
    """Start `command`; its output comes back through the handle, unless it is meant to outlive us.

    Then it goes to `output_to`, or nowhere: a pipe would break with the agent. `guard` is where guard.py is
    told of what is to die with the agent: of this process, before its program runs, so that it is known
    however soon the agent is killed.
    """
    try:
        child = subprocess.Popen(
            command,
            cwd=directory,
            env=dict(environment),
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE
            if dies_with_agent
            else subprocess.DEVNULL
            if output_to is None
            else output_to,
            stderr=subprocess.STDOUT,
            start_new_session=True,
            preexec_fn=_die_with(os.getpid(), guard) if dies_with_agent else None,
        )
    except (OSError, ValueError, subprocess.SubprocessError) as error:
        if guard is not None:
            with suppress(OSError):  # the guard is gone: the supervisor says so
                os.write(guard, b"?\n")  # or it would end whoever gets this number next
        raise NotStarted(f"{command[0]}: {error}") from error
    output = None
    if child.stdout is not None:
        output = os.dup(child.stdout.fileno())
        child.stdout.close()
        os.set_blocking(output, False)
    # Our own child that we have not waited for: its pid cannot have been given to another.
    return Handle(child.pid, os.pidfd_open(child.pid), start_ticks(child.pid) or 0, child, output)


def adopt(pid: int, ticks: int) -> Handle | None:
    """Return a handle on a process that an earlier agent started, or None if it is not there any more."""
    try:
        pidfd = os.pidfd_open(pid)
    except OSError:
        return None
    # Compared after opening: the pidfd now means this very process, whatever happens to the number.
    if start_ticks(pid) != ticks:
        os.close(pidfd)
        return None
    return Handle(pid, pidfd, ticks, None, None)


def start_ticks(pid: int) -> int | None:
    """Return when a live process started, in clock ticks since boot; None for a zombie or nobody.

    Pid and start time together name a process for good, within one boot. Source: proc(5), fields 3 and 22 of
    /proc/PID/stat.
    """
    fields = _stat(pid)
    return None if not fields or fields[0] in (b"Z", b"X") else int(fields[19])


def halted(pid: int) -> str:
    """Return why a process that is there does not run; nothing: it does, or has ended.

    Of a program that only waits for the one that it has started (a shell, a wrapper), that one counts.
    """
    for _ in range(LONGEST_CHAIN):
        state = _stat(pid)[:1]
        if state in ([b"T"], [b"t"]):
            return "traced by a debugger" if state == [b"t"] else "stopped by a signal (SIGSTOP)"
        try:
            children = Path(f"/proc/{pid}/task/{pid}/children").read_bytes().split()
        except OSError:
            return ""
        if len(children) != 1:
            return ""
        pid = int(children[0])
    return ""


def stuck(pid: int) -> tuple[bool, int]:
    """Return whether a process waits in the kernel for what no signal interrupts, and the processor time that
    it has used, in clock ticks.
    """
    fields = _stat(pid)
    return fields[:1] == [b"D"], sum(map(int, fields[11:13]))


STATES = {
    b"R": "running",
    b"S": "sleeping",
    b"D": "waiting in the kernel",
    b"T": "stopped",
    b"t": "traced",
    b"Z": "ended, not reaped",
    b"I": "idle",
}
"""Letters of /proc/PID/stat, as words."""


def described(pid: int) -> str:
    """Return how a process is, for people; nothing, of one that is not there."""
    fields = _stat(pid)
    if len(fields) < 22:
        return ""
    where = waits_in(pid)
    used_s = (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")
    memory_mb = int(fields[21]) * os.sysconf("SC_PAGE_SIZE") / 1e6
    threads = int(fields[17])
    state = STATES.get(fields[0], fields[0].decode("ascii", "replace")) + (f" in {where}" if where else "")
    return f"{state}; {used_s:.1f} s of processor time, {memory_mb:.0f} MB, threads: {threads}"


def waits_in(pid: int) -> str:
    """Return in which function of the kernel a process waits; nothing where the system does not say."""
    try:
        return Path(f"/proc/{pid}/wchan").read_text().strip("0\n ")
    except OSError:
        return ""


def _stat(pid: int) -> list[bytes]:
    """Return the fields of /proc/PID/stat behind the name; nothing, of a process that is not there."""
    try:
        stat = Path(f"/proc/{pid}/stat").read_bytes()
    except OSError:
        return []
    return stat[stat.rindex(b")") + 2 :].split()  # the name before it may hold spaces and brackets


def boot_id() -> str:
    """Return the kernel's name of this boot, the same until the computer restarts. Source: random(4)."""
    return Path("/proc/sys/kernel/random/boot_id").read_text().strip()


def _die_with(parent: int, guard: int | None) -> Callable[[], None]:
    def in_child() -> None:
        _libc.prctl(PR_SET_PDEATHSIG, signal.SIGTERM, 0, 0, 0)
        if guard is not None:
            signal.signal(signal.SIGPIPE, signal.SIG_IGN)  # of a guard that is gone
            with suppress(OSError):
                os.write(guard, b"?%d\n" % os.getpid())
            signal.signal(signal.SIGPIPE, signal.SIG_DFL)
        if os.getppid() != parent:  # the agent died before prctl: no signal will come
            os._exit(1)

    return in_child
