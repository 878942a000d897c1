"""Fields of recorded messages, of one or of many at once: unpacked by themselves where their types allow it,
else from the whole.
"""

from __future__ import annotations

import struct
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from robomend_batch.logs.chunk import gathered
from robomend_batch.logs.mcap_chunk import unpacked
from robomend_client.bridges.fields import value_at
from robomend_client.bridges.unpacking import HEADERS, Extract, Fields, Steps, layout, unpacker

ZSTD = b"\x28\xb5\x2f\xfd"
"""How a message begins that rosbag2 has packed by itself (`compression_mode: MESSAGE`)."""


def plain_cdr(data: bytes) -> bytes:
    """Return a message as CDR, unpacked if it is packed; ValueError if it is in another encoding."""
    if data[:4] == ZSTD:
        data = unpacked("zstd", data)
    if data[:2] not in HEADERS:
        raise ValueError("it is no plain CDR")
    return data


def compile_field(
    fields: Fields, type_name: str, path: str, *, cdr: bool, whole: Extract, exact: bool = True
) -> Extract:
    """Return a function from a message's bytes to a field of it.

    Args:
        fields: of the typestore.
        type_name: of the message.
        path: see paths.py, e.g. `twist.twist.linear.x`, `ranges[-1]`.
        cdr: ROS 2's encoding, else ROS 1's.
        whole: makes the whole message, for what cannot be skipped.
        exact: refuse messages that are longer or shorter than their type.

    Raises:
        NoField: the type has no such field.
    """
    alone = unpacker(fields, type_name, path, cdr=cdr, exact=exact, plain=plain_cdr if cdr else None)
    return alone or (lambda data: value_at(whole(data), path))


def plain(value: Any) -> Any:
    """Return a message as mappings and lists, as observers take it from the bus."""
    if hasattr(value, "__dataclass_fields__"):
        return {name: plain(getattr(value, name)) for name in value.__dataclass_fields__ if name[0] != "_"}
    if isinstance(value, list):
        return [plain(one) for one in value]
    return value.tolist() if hasattr(value, "tolist") else value


# --- a field of many messages at once: what unpacking.py does for one

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
