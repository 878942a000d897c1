"""The messages of one chunk of an MCAP file, together: arrays of their times and places."""

from __future__ import annotations

import struct
from collections.abc import Iterator, Mapping

import numpy as np
from numpy.typing import NDArray

from robomend_batch.logs.recorded import Message, Times

RECORD = struct.Struct("<BQ")
MESSAGE = 5
MESSAGE_HEAD = 22
"""Bytes before the data: channel, sequence, log time, publish time."""


class Chunk:
    """The wanted messages of one chunk: their times and places by channel, or one by one, by time."""

    def __init__(
        self, found: Mapping[int, tuple[Times, Times]], wanted: Mapping[int, bool], data: bytes | None
    ) -> None:
        self.times_ns = {channel: times_ns for channel, (times_ns, _) in found.items()}
        self.until_ns = max((int(times_ns.max()) for times_ns in self.times_ns.values()), default=0)
        self.count = sum(map(len, self.times_ns.values()))
        self._places = {channel: places for channel, (_, places) in found.items()}
        self._wanted = wanted
        self._packed = data
        self._data = np.frombuffer(data or b"", np.uint8)

    def check(self) -> None:
        """Refuse an index that leads nowhere."""
        for channel, places in self._places.items():
            if self._wanted[channel] and self._packed is not None:
                room = len(self._data) - RECORD.size
                if places.min() < 0 or places.max() > room or (self._data[places] != MESSAGE).any():
                    raise ValueError("the index leads nowhere")

    def bodies(self, channel: int) -> tuple[NDArray[np.uint8], Times, Times]:
        """Return bytes, and where the data of each message of a channel begins and ends in them."""
        places = self._places[channel]
        lengths = self._data[(places + 1)[:, None] + np.arange(8)].view("<u8")[:, 0].astype(np.int64)
        begins = places + RECORD.size
        return self._data, begins + MESSAGE_HEAD, np.minimum(begins + lengths, len(self._data))

    def __iter__(self) -> Iterator[Message]:
        found: list[tuple[int, int, int]] = []  # time, place, channel
        for channel, times_ns in self.times_ns.items():
            places = self._places[channel].tolist()
            found += zip(times_ns.tolist(), places, [channel] * len(places), strict=True)
        found.sort()
        data = self._packed
        for time_ns, place, channel in found:
            body = None if data is None or not self._wanted[channel] else _body(data, place)
            yield time_ns, channel, body


def _body(data: bytes, place: int) -> bytes:
    _, length = RECORD.unpack_from(data, place)
    begin = place + RECORD.size
    return data[begin + MESSAGE_HEAD : begin + length]
