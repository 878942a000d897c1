"""A field of many messages of one type at once: what unpacking.py does for one, with arrays of places."""

from __future__ import annotations

import struct
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from robomend_batch.logs.chunk import gathered
from robomend_client.bridges.unpacking import Fields, Steps, layout

Places = NDArray[np.int64]

Column = Callable[[NDArray[np.uint8], Places, Places], NDArray[np.float64] | None]
"""From bytes, and where each message in them begins and ends, to the numbers; None: some of them are odd, and
the messages must be looked at one by one."""


def compile_column(fields: Fields, type_name: str, path: str, *, cdr: bool) -> Column | None:
    """Return a function from messages to a field of each; None where it cannot be had at once."""
    found = layout(fields, type_name, path, cdr=cdr)
    if found is None:
        return None
    prefix, steps, kind, behind = found
    size = struct.calcsize(kind)
    number = np.dtype("<" + kind)

    def read(data: NDArray[np.uint8], begins: Places, ends: Places) -> NDArray[np.float64] | None:
        origin = begins + (4 if cdr else 0)
        at = np.full(len(begins), prefix, dtype=np.int64)
        try:
            if cdr and (gathered(data, begins, _KIND) != LITTLE_ENDIAN).any():
                return None
            at = skipped(steps, data, origin, at)
            if cdr:
                at = _aligned(at, size)
            values = gathered(data, origin + at, number)
            spare = ends - origin - skipped(behind, data, origin, at + size)
        except IndexError:  # one of them ends behind all that is there
            return None
        # Nothing is skipped backwards: who ends in its place was looked at in its place alone.
        if ((spare < 0) | (spare > (3 if cdr else 0))).any():  # CDR may be padded
            return None
        return values.astype(np.float64)

    def skipped(steps: Steps, data: NDArray[np.uint8], origin: Places, at: Places) -> Places:
        """Return where each message goes on behind these steps."""
        for step, align, width in steps:
            if step == "numbers":
                at = (_aligned(at, align) if cdr else at) + width
                continue
            if cdr:
                at = _aligned(at, 4)
            count = gathered(data, origin + at, _COUNT).astype(np.int64)
            at = at + 4
            if step == "string":
                at += count
            else:
                behind = (_aligned(at, align) if cdr else at) + width * count
                at = np.where(count > 0, behind, at)
        return at

    return read


_COUNT = np.dtype("<u4")
_KIND = np.dtype("<u2")
LITTLE_ENDIAN = int.from_bytes(b"\0\1", "little")
"""How CDR of this kind begins."""


def _aligned(at: Places, size: int) -> Places:
    aligned: Places = (at + (size - 1)) & -size
    return aligned
