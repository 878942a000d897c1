"""What is known of the board at one moment; when nothing is, why."""

from __future__ import annotations

from dataclasses import dataclass

from robomend.board.codec import ChannelReading


@dataclass(frozen=True, slots=True)
class Snapshot:
    """Every channel's reading at a time, or None: unknown, which is neither on nor off."""

    time_ns: int  # integer nanoseconds since the epoch, this computer's clock on receipt
    channels: tuple[ChannelReading, ...] | None
    reason: str = ""  # why it is unknown
