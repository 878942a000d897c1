"""Files that are compressed as a whole: .mcap.zstd and .db3.zstd of rosbag2, .bag.gz, .csv.bz2.

Readers want to seek, so such a file is unpacked into one beside the results, piece by piece. That file is
bounded: real logs shrink to a tenth; what grows a hundredfold was made to fill the disk. Damage costs what
follows it: what was unpacked before is read, as of a recording that was cut off.
"""

from __future__ import annotations

import os
import shutil
import zlib
from bz2 import BZ2Decompressor
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any, BinaryIO

from robomend_batch.errors import FULL
from robomend_batch.logs import without_ending
from robomend_batch.logs.mcap_chunk import HEAD_BYTES, ZstdError, has_checksum, zstd
from robomend_batch.problems import LogRefused

MOST_TIMES = 100
"""So many times its size a file may unpack to, …"""

ALWAYS = 256 << 20
"""… and so much in any case: a recording of a robot that stands still is nearly nothing."""

PIECE = 1 << 14
"""Packed bytes that are handed to a decompressor at once: what fails costs no more than they do."""

OUTPUT = 1 << 20

METADATA, METADATA_BYTES = "metadata.yaml", 1 << 20
"""What rosbag2 writes beside its recordings."""


class _Gzip:
    """zlib's, as those of bz2 and zstd are."""

    def __init__(self) -> None:
        self._zlib = zlib.decompressobj(wbits=31)

    def decompress(self, data: bytes, max_length: int) -> bytes:
        return self._zlib.decompress(self._zlib.unconsumed_tail + data, max_length)

    @property
    def eof(self) -> bool:
        return self._zlib.eof

    @property
    def needs_input(self) -> bool:
        return not self._zlib.unconsumed_tail

    @property
    def unused_data(self) -> bytes:
        return self._zlib.unused_data


class _Zstd:
    """A frame, and whether it has a checksum."""

    def __init__(self) -> None:
        self._frame = zstd.ZstdDecompressor()
        self._head = b""

    def decompress(self, data: bytes, max_length: int) -> bytes:
        self._head += data[: HEAD_BYTES - len(self._head)]
        return self._frame.decompress(data, max_length)

    @property
    def checked(self) -> bool:
        return has_checksum(self._head) or not self._head.startswith(ZSTD)  # a frame that holds no data

    @property
    def eof(self) -> bool:
        return self._frame.eof

    @property
    def needs_input(self) -> bool:
        return self._frame.needs_input

    @property
    def unused_data(self) -> bytes:
        return self._frame.unused_data


ZSTD = b"\x28\xb5\x2f\xfd"

KINDS: dict[bytes, Callable[[], Any]] = {
    ZSTD: _Zstd,
    b"\x1f\x8b\x08": _Gzip,
    b"BZh": BZ2Decompressor,
}
"""How a compressed file begins, and what unpacks it."""


@dataclass(frozen=True, slots=True)
class Plain:
    """A log that can be read."""

    path: Path
    problem: str = ""
    """What is wrong with its compression."""

    checked: bool = True
    """Whether a checksum of it says that nothing is."""


def is_compressed(path: Path) -> bool:
    """Return whether a file is compressed as a whole; it need not be there."""
    with suppress(OSError), path.open("rb") as file:
        return file.read(4).startswith(tuple(KINDS))
    return False


@contextmanager
def plain_log(path: Path, folder: Path) -> Iterator[Plain]:
    """Yield a log as it is, or of one that is compressed what it holds, in `folder` for so long.

    Raises:
        LogRefused: nothing of it can be unpacked, or it holds more than real logs do.
    """
    if not is_compressed(path):
        yield Plain(path)
        return
    try:
        folder.mkdir(exist_ok=True)
        inner = folder / without_ending(path.name)
        problem, checked = _unpack(path, inner)
        with suppress(OSError), path.with_name(METADATA).open("rb") as file:
            (folder / METADATA).write_bytes(file.read(METADATA_BYTES))
        yield Plain(inner, problem, checked)
    finally:
        shutil.rmtree(folder, ignore_errors=True)


def _unpack(path: Path, into: Path) -> tuple[str, bool]:
    """Unpack a file, and return what is wrong with it, and whether checksums say that nothing is; LogRefused
    if nothing of it can be read.
    """
    size = path.stat().st_size
    most = max(ALWAYS, MOST_TIMES * size)
    written = 0
    beside = into.with_name(f"{into.name}.{os.getpid()}")  # the worker of a killed run may not be gone yet
    problem, checked = "", True
    with path.open("rb") as file, beside.open("wb", buffering=0) as output:
        try:
            for data, is_checked in _pieces(file):
                written += len(data)
                checked = checked and is_checked
                if written > most:
                    at = f"at byte {file.tell():,} of {size:,}"
                    raise LogRefused(
                        f"it unpacks to more than {most >> 20:,} MB, {at}: no log shrinks like that",
                        str(path),
                    )
                if written > shutil.disk_usage(into.parent).free:
                    raise LogRefused(
                        f"it unpacks to more than {written >> 20:,} MB: half of the room on the disk",
                        str(path),
                    )
                output.write(data)
        except (OSError, EOFError, ValueError, zlib.error, ZstdError) as error:
            if isinstance(error, OSError) and error.errno in FULL:
                raise LogRefused(f"no room to unpack it: {error.strerror}", str(path)) from error
            problem = f"its compression is damaged before byte {file.tell():,} of {size:,}: {error}"
    if problem and not written:
        raise LogRefused(problem, str(path))
    os.replace(beside, into)
    return problem, checked


def _pieces(file: BinaryIO) -> Iterator[tuple[bytes, bool]]:
    """Yield what a file holds, and whether a checksum covers it; there may be several streams in it.

    Raises:
        EOFError: it ends in the middle.
        OSError, ValueError, zlib.error, ZstdError: it is damaged.
    """
    head = file.read(4)
    file.seek(0)
    make = next(make for magic, make in KINDS.items() if head.startswith(magic))
    decompressor = make()
    while True:
        data = b""
        if decompressor.eof:
            data = decompressor.unused_data.lstrip(b"\0")  # tapes pad with zeros
            while not data:
                more = file.read(PIECE)
                if not more:
                    return
                data = more.lstrip(b"\0")
            decompressor = make()
        elif decompressor.needs_input:
            data = file.read(PIECE)
        output = decompressor.decompress(data, OUTPUT)
        if output:
            yield output, getattr(decompressor, "checked", True)
        elif not data and not decompressor.eof:
            raise EOFError("it ends in the middle")
