"""A command on a terminal of its own, as a person has it: what it shows, Ctrl-C, and what it leaves behind.

Everything that it starts is found by a variable in its environment, also what has a session of its own or
whose parent has ended; temporary files go to a folder that has to be empty afterwards.
"""

from __future__ import annotations

import fcntl
import os
import pty
import re
import select
import signal
import struct
import subprocess
import tempfile
import termios
import time
import uuid
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from types import TracebackType

from tests.waiting import until

MARK = "ROBOMEND_TEST_TERMINAL"
INHERITED = re.compile(r"PYTEST_|COLUMNS|LINES|NO_COLOR|ROBOMEND_")
"""Of the test, and not of the person whose terminal this is; what is wanted of it, a test gives by name."""

MEANT_TO_STAY = re.compile(r"pytest-of-|robomend-tests-.*\.lock")
"""What tests leave in the folder for temporary files: to be looked at afterwards."""

AFTER_CTRL_C = (130, -signal.SIGINT)
"""Exit codes that a shell shows as 130. `python -m` has the second if Ctrl-C came inside an `exec` of text,
as data classes are made by: the interpreter then ends itself by the signal, whatever the program returned."""

CONTROL = re.compile(r"\x1b\[[0-9;?]*[A-Za-z]|\x1b\][^\x07]*\x07|\r")
TICK_S = 1 / os.sysconf("SC_CLK_TCK")
SIZE = struct.pack("HHHH", 40, 120, 0, 0)
"""Rows and columns."""


class Terminal:
    """While this context lasts, a command runs on a terminal; afterwards nothing of it is left."""

    def __init__(self, typed: str, folder: Path, environment: Mapping[str, str]) -> None:
        self.typed = typed
        self._mark = uuid.uuid4().hex
        self._shown = b""
        self._spent: dict[int, float] = {}
        # Short: sockets are made there, whose paths may have about 100 bytes.
        self._temporary = tempfile.TemporaryDirectory(prefix="rmt-", ignore_cleanup_errors=True)
        self._master, self._slave = pty.openpty()
        fcntl.ioctl(self._slave, termios.TIOCSWINSZ, SIZE)
        kept = {name: value for name, value in os.environ.items() if not INHERITED.match(name)}
        self.process = subprocess.Popen(
            ["bash", "-c", f"set -euo pipefail; {typed}"],
            cwd=folder,
            stdin=self._slave,
            stdout=self._slave,
            stderr=self._slave,
            start_new_session=True,
            preexec_fn=lambda: fcntl.ioctl(0, termios.TIOCSCTTY, 0),
            env={
                **kept,
                "TERM": "xterm-256color",
                "TMPDIR": self._temporary.name,
                **environment,
                MARK: self._mark,
            },
        )
        os.close(self._slave)

    def __enter__(self) -> Terminal:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        for process in self.processes():
            with suppress(ProcessLookupError):
                os.kill(process, signal.SIGKILL)
        self.process.wait(60)
        os.close(self._master)
        self._temporary.cleanup()

    @property
    def temporary(self) -> Path:
        """Where it has its temporary files."""
        return Path(self._temporary.name)

    def listen(self, seconds: float) -> None:
        """Take in what it shows within this time."""
        end = time.monotonic() + seconds
        while (left := end - time.monotonic()) > 0:
            ready, _, _ = select.select([self._master], [], [], left)
            if not ready:
                return
            try:
                self._shown += os.read(self._master, 1 << 16)
            except OSError:  # nobody has it open any more
                time.sleep(min(left, 0.05))  # it is about to end
                return

    @property
    def shown(self) -> str:
        """What it has shown, without colours and movements of the cursor."""
        return CONTROL.sub("", self._shown.decode(errors="replace"))

    def ctrl_c(self) -> None:
        """Press it: whoever is in the foreground of this terminal gets SIGINT."""
        os.write(self._master, b"\x03")

    def ends_by_ctrl_c(self) -> None:
        """Press it, and see it end as an interrupted command does: without a traceback, and nothing left."""
        self.ctrl_c()

        def ended() -> bool:
            self.listen(0.01)  # nobody writes to a terminal that is full
            return self.process.poll() is not None

        until(ended, "it ends", 120)
        self.listen(0.1)
        assert self.process.returncode == 130, self.shown
        assert "Traceback" not in self.shown
        self.leaves_nothing()

    def leaves_nothing(self) -> None:
        """See that nothing of it is left, once what was killed with it has had a processor to end on."""
        with suppress(AssertionError):
            until(lambda: not self.left_behind(), "nothing is left", 20)
        assert self.left_behind() == [], f"{self.typed}\n{self.shown[-2000:]}"

    def processes(self) -> list[int]:
        """Return all that run in it, zombies not counted."""
        found = []
        wanted = f"{MARK}={self._mark}".encode()
        for place in Path("/proc").iterdir():
            with suppress(OSError, ValueError):
                if wanted in (place / "environ").read_bytes():
                    found.append(int(place.name))
        return found

    def processor_s(self) -> float:
        """Return how long they have worked, as far as it was seen: user and system time."""
        for process in self.processes():
            with suppress(OSError):
                fields = Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()
                self._spent[process] = (int(fields[11]) + int(fields[12])) * TICK_S
        return sum(self._spent.values())

    def left_behind(self) -> list[str]:
        """Return the processes and temporary files that are still there, each in words."""
        words = []
        for process in self.processes():
            with suppress(OSError):
                line = Path(f"/proc/{process}/cmdline").read_bytes().replace(b"\0", b" ")
                words.append(f"process {process}: {line.decode(errors='replace').strip()}")
        files = (path.name for path in self.temporary.iterdir())
        return words + [f"file {name}" for name in sorted(files) if not MEANT_TO_STAY.match(name)]
