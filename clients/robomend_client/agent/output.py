"""What a process prints, in a file with a bound: NAME.log, and NAME.log.1 with what was before.

Together they hold at most the bound. Normally the agent reads the process's output and writes it here. A
process that is to outlive the agent writes to the file itself, and the agent cuts it back now and then.
"""

from __future__ import annotations

import contextlib
import logging
import os
import shutil
from pathlib import Path
from urllib.parse import quote

log = logging.getLogger(__name__)


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
