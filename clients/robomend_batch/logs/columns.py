"""A field of many messages of one type at once: what unpacking.py does for one, with arrays of places."""

from __future__ import annotations

import struct
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

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
        origin = begins
        if cdr:
            if (begins + 4 > ends).any() or data[begins].any() or not (data[begins + 1] == 1).all():
                return None
            origin = begins + 4
        at = skipped(steps, data, origin, np.full(len(begins), prefix, dtype=np.int64), ends)
        if at is None:
            return None
        if cdr:
            at = _aligned(at, size)
        values = _gathered(data, origin + at, ends, number)
        at = None if values is None else skipped(behind, data, origin, at + size, ends)
        if values is None or at is None:
            return None
        spare = ends - origin - at  # CDR may be padded
        if (spare < 0).any() or (spare > (3 if cdr else 0)).any():
            return None
        return values.astype(np.float64)

    def skipped(
        steps: Steps, data: NDArray[np.uint8], origin: Places, at: Places, ends: Places
    ) -> Places | None:
        """Return where each message goes on behind these steps; None if one ends before."""
        for step, align, width in steps:
            if step == "numbers":
                at = (_aligned(at, align) if cdr else at) + width
                continue
            if cdr:
                at = _aligned(at, 4)
            count = _gathered(data, origin + at, ends, _COUNT)
            if count is None:
                return None
            at = at + 4
            if step == "string":
                at += count
            else:
                behind = (_aligned(at, align) if cdr else at) + width * count
                at = np.where(count > 0, behind, at)
        return at

    return read


_COUNT = np.dtype("<u4")


def _aligned(at: Places, size: int) -> Places:
    aligned: Places = (at + (size - 1)) & -size
    return aligned


def _gathered(data: NDArray[np.uint8], at: Places, ends: Places, kind: np.dtype[Any]) -> NDArray[Any] | None:
    """Return a number at each of these places; None if one is behind the end of its message."""
    if (at + kind.itemsize > ends).any():
        return None
    found: NDArray[Any] = data[at[:, None] + np.arange(kind.itemsize)].view(kind)[:, 0]
    return found.astype(np.int64) if kind is _COUNT else found
