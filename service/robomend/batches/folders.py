"""Where the files of batches are: a folder each, below one that this computer's instances share.

    DATA/batches/place           who these folders belong to: a random name, made once
    DATA/batches/slot-0, …       locks: one for each batch that may run at once
    DATA/batches/making          lock: for as long as a folder is made, or looked at whether it is left over
    DATA/batches/b-7k2m9x4q/     model.yaml, observers.yaml, names.json, logs/ (uploads), out/ (results),
                                 said.txt (of the program), lock

Locks are the kernel's (flock): whoever dies lets go. The program has the lock of its folder as well, so that
no second one starts before the first is gone. What is no folder of a batch that the store knows, and nobody
holds, is left over and removed.
"""

from __future__ import annotations

import contextlib
import fcntl
import json
import os
import secrets
import shutil
from collections.abc import Callable, Collection, Iterator
from pathlib import Path

from robomend.errors import StoreError, StoreFull
from robomend.store.encoding import new_id

FULL_NUMBERS = frozenset({28, 122, 27})
"""ENOSPC, EDQUOT, EFBIG."""

LOCK = "lock"


class FileLock:
    """A lock that is held until `close`, or until this process dies."""

    def __init__(self, file: int) -> None:
        self.file = file

    def close(self) -> None:
        """Let go; a process that was given the file holds it still."""
        if self.file >= 0:
            os.close(self.file)
            self.file = -1


def hold(path: Path) -> FileLock | None:
    """Hold a lock; None if somebody does, or if its folder is gone."""
    try:
        file = os.open(path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o600)
    except FileNotFoundError:
        return None
    try:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError:
        os.close(file)
        return None
    return FileLock(file)


class BatchFolder:
    """The files of one batch."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.model = path / "model.yaml"
        self.observers = path / "observers.yaml"
        self.logs = path / "logs"
        self.out = path / "out"
        self.said = path / "said.txt"

    @property
    def names(self) -> list[str]:
        """The logs, as the program is to call them."""
        found: list[str] = json.loads((self.path / "names.json").read_text())
        return found

    def write_names(self, names: list[str]) -> None:
        """Note which logs there are."""
        (self.path / "names.json").write_text(json.dumps(names))

    def result(self, name: str) -> Path | None:
        """Return a file of the results, if it is there."""
        file = self.out / name
        return file if file.is_file() else None

    def forget_uploads(self) -> None:
        """Remove the uploaded logs: they were read."""
        shutil.rmtree(self.logs, ignore_errors=True)

    def remove(self) -> None:
        """Remove all of it."""
        shutil.rmtree(self.path, ignore_errors=True)


class BatchFolders:
    """See the module. Its methods wait for the disk."""

    def __init__(self, root: Path) -> None:
        self.root = root

    def of(self, job: str) -> BatchFolder:
        """Return the folder of a batch, whether or not it is there."""
        return BatchFolder(self.root / job)

    def place(self) -> str:
        """Return the name of this folder of batches; it is made if need be."""
        self.root.mkdir(parents=True, exist_ok=True, mode=0o700)
        file = self.root / "place"
        beside = self.root / f"place.{secrets.token_hex(4)}"
        if not file.exists():
            beside.write_text(secrets.token_hex(8))
            try:
                os.link(beside, file)  # the first one counts
            except FileExistsError:
                pass
            finally:
                beside.unlink()
        return file.read_text()

    def make(self) -> tuple[str, BatchFolder, FileLock]:
        """Make a folder for a new batch, held."""
        job = new_id("b-")
        folder = self.of(job)
        with self._making():
            folder.logs.mkdir(parents=True, mode=0o700)
            held = hold(folder.path / LOCK)
        assert held is not None
        return job, folder, held

    @contextlib.contextmanager
    def _making(self) -> Iterator[None]:
        """Wait until no process makes or looks at a folder: one that is not held yet looks left over."""
        file = os.open(self.root / "making", os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o600)
        try:
            fcntl.flock(file, fcntl.LOCK_EX)
            yield
        finally:
            os.close(file)

    def slot(self, count: int) -> FileLock | None:
        """Hold one of so many slots; None if they are taken."""
        for number in range(count):
            if (held := hold(self.root / f"slot-{number}")) is not None:
                return held
        return None

    def sweep(self, known: Callable[[], Collection[str]]) -> int:
        """Remove folders that belong to no batch; `known` is asked while each is held."""
        gone = 0
        for path in self.root.iterdir():
            if not path.is_dir():
                continue
            with self._making():
                held = hold(path / LOCK)
            if held is None:
                continue
            try:
                if path.name not in known():
                    BatchFolder(path).remove()
                    gone += 1
            finally:
                held.close()
        return gone


def of_disk(error: OSError) -> StoreError:
    """Return what a failure of the disk is for who asked."""
    if error.errno in FULL_NUMBERS:
        return StoreFull("the disk is full, or the batch larger than it may be: nothing of it is kept")
    return StoreError(f"the folder of batches cannot be written: {error.strerror}")
