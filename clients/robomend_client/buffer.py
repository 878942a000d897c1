"""A queue on disk, in order and of bounded size: what a robot saw while the service was away.

    DIRECTORY/lock                     one process at a time
    DIRECTORY/head                     {"segment": 3, "offset": 812, "dropped": 0}, replaced whole
    DIRECTORY/00000003.log …           records, appended:  CRC-32 as 8 hex digits, space, JSON, newline

The head names the oldest record that is still wanted. Taking a record moves the head; a segment wholly behind
it is deleted. When more than `max_bytes` are waiting, the head moves past the oldest ones and counts them as
dropped: a service that comes back wants the newest truth.

Crashes: a record is in the kernel when `append` returns, so that the death of this process loses nothing; it
is on the disk (fsync) at the latest a second later if appends go on, or when `sync` is called, so that a
power cut loses no more than that. A torn tail, or a line whose checksum is wrong, is skipped and counted. A
crash between sending and taking sends a record twice: give each an Idempotency-Key.
"""

from __future__ import annotations

import fcntl
import json
import os
import time
import zlib
from collections import deque
from pathlib import Path
from typing import IO, Any

SEGMENTS = 8
"""The bound is kept exactly for what waits; the disk may hold one segment, 1/8 of it, more."""

SYNC_S = 1.0


class BufferInUse(Exception):
    """Another process has the buffer open."""


class DiskBuffer:
    """A queue of JSON objects in `directory`, at most `max_bytes` of them."""

    def __init__(
        self,
        directory: Path | str,
        max_bytes: int = 16 * 1024 * 1024,
    ) -> None:
        if max_bytes < 1024:
            raise ValueError(f"max_bytes is {max_bytes}; a buffer needs 1024 at least")
        self.directory = Path(directory)
        self.directory.mkdir(parents=True, exist_ok=True)
        self.max_bytes = max_bytes
        self.dropped = 0  # since the buffer was made; survives restarts
        self.corrupt = 0  # records skipped when this object was opened
        self._lock = self._take_lock()
        self._waiting: deque[tuple[int, int, int]] = deque()  # segment, offset, length; oldest first
        self._bytes = 0
        self._file: IO[bytes] | None = None
        self._segment = 0
        self._unsynced_since: float | None = None
        try:
            self._load()
        except BaseException:  # whatever ends us here, another buffer may take the folder
            self._lock.close()
            raise

    def __len__(self) -> int:
        return len(self._waiting)

    def append(self, record: dict[str, Any]) -> None:
        """Put `record` at the end; the oldest are dropped, and counted, if it would not fit."""
        line = encode(record)
        if len(line) > self.max_bytes:
            self.dropped += 1
            self._write_head()
            return
        while self._bytes + len(line) > self.max_bytes:
            self._forget_oldest()
            self.dropped += 1
        file = self._segment_for(len(line))
        offset = file.tell()
        try:
            file.write(line)
        except OSError:  # a full disk: leave no half record behind, the next append would be glued to it
            file.seek(offset)
            file.truncate()
            raise
        self._waiting.append((self._segment, offset, len(line)))
        self._bytes += len(line)
        self._write_head_if_moved()
        now = time.monotonic()
        if self._unsynced_since is None:
            self._unsynced_since = now
        if now - self._unsynced_since >= SYNC_S:
            self.sync()

    def peek(self) -> dict[str, Any] | None:
        """Return the oldest record, or None; it stays until `take`."""
        while self._waiting:
            segment, offset, length = self._waiting[0]
            try:
                with self._path(segment).open("rb") as file:
                    file.seek(offset)
                    record = decode(file.read(length))
            except FileNotFoundError:
                record = None
            if record is not None:
                return record
            self.corrupt += 1  # it went bad after it was read at the start
            self.take()
        return None

    def take(self) -> None:
        """Remove the oldest record: it has arrived."""
        self._forget_oldest()
        self._write_head_if_moved()

    def sync(self) -> None:
        """Wait until everything is on the disk."""
        if self._file is not None:
            os.fsync(self._file.fileno())
        self._unsynced_since = None

    def close(self) -> None:
        """Put everything on the disk and let another process open the buffer."""
        if self._lock.closed:
            return
        self._write_head()
        self.sync()
        if self._file is not None:
            self._file.close()
            self._file = None
        self._lock.close()

    # --- files ---------------------------------------------------------------------------------------

    def _take_lock(self) -> IO[bytes]:
        lock = (self.directory / "lock").open("ab")
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError as error:
            lock.close()
            raise BufferInUse(f"{self.directory} is in use by another process; give each its own") from error
        return lock

    def _path(self, segment: int) -> Path:
        return self.directory / f"{segment:08d}.log"

    def _load(self) -> None:
        head_segment, head_offset = self._read_head()
        segments = sorted(int(path.stem) for path in self.directory.glob("*.log") if path.stem.isdigit())
        for segment in segments:
            if segment < head_segment:
                self._path(segment).unlink()
                continue
            self._segment = max(self._segment, segment)
            offset = 0
            with self._path(segment).open("rb") as file:
                for line in file:
                    wanted = segment > head_segment or offset >= head_offset
                    if wanted and decode(line) is not None:
                        self._waiting.append((segment, offset, len(line)))
                        self._bytes += len(line)
                    elif wanted:
                        self.corrupt += 1
                    offset += len(line)
        # A fresh segment: nothing is ever appended behind a torn tail.
        self._segment = max(self._segment, head_segment) + 1
        while self._bytes > self.max_bytes:  # opened with a smaller bound than before
            self._forget_oldest()
            self.dropped += 1
        self._write_head()

    def _segment_for(self, length: int) -> IO[bytes]:
        if self._file is not None and self._file.tell() + length > max(self.max_bytes // SEGMENTS, length):
            self.sync()
            self._file.close()
            self._file = None
            self._segment += 1
        if self._file is None:
            # Unbuffered: what append wrote is in the kernel when it returns.
            self._file = self._path(self._segment).open("ab", buffering=0)
        return self._file

    def _forget_oldest(self) -> None:
        segment, _, length = self._waiting.popleft()
        self._bytes -= length
        following = self._waiting[0][0] if self._waiting else None
        if following != segment and not (following is None and segment == self._segment):
            self._write_head()  # first the head, then the file: a crash in between leaves a file to delete
            for old in range(segment, following if following is not None else segment + 1):
                self._path(old).unlink(missing_ok=True)

    # --- the head --------------------------------------------------------------------------------------

    def _head(self) -> tuple[int, int, int]:
        if self._waiting:
            segment, offset, _ = self._waiting[0]
            return segment, offset, self.dropped
        return self._segment, self._file.tell() if self._file is not None else 0, self.dropped

    def _write_head_if_moved(self) -> None:
        if self._head() != self._written_head:
            self._write_head()

    def _write_head(self) -> None:
        segment, offset, dropped = head = self._head()
        temporary = self.directory / "head.new"
        temporary.write_text(json.dumps({"segment": segment, "offset": offset, "dropped": dropped}))
        temporary.replace(self.directory / "head")
        self._written_head = head

    def _read_head(self) -> tuple[int, int]:
        try:
            head = json.loads((self.directory / "head").read_text())
            self.dropped = int(head["dropped"])
            return int(head["segment"]), int(head["offset"])
        except FileNotFoundError:
            return 0, 0
        except (ValueError, KeyError, TypeError):
            return 0, 0  # the head did not survive a power cut: all records are sent again


def encode(record: dict[str, Any]) -> bytes:
    """Return the line of `record`."""
    text = json.dumps(record, separators=(",", ":")).encode()
    return b"%08x %s\n" % (zlib.crc32(text), text)


def decode(line: bytes) -> dict[str, Any] | None:
    """Return the record of `line`, or None if the line is torn or altered."""
    checksum, _, text = line.removesuffix(b"\n").partition(b" ")
    try:
        if not line.endswith(b"\n") or int(checksum, 16) != zlib.crc32(text):
            return None
        record = json.loads(text)
    except ValueError:
        return None
    return record if isinstance(record, dict) else None
