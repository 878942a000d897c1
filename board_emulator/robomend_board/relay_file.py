"""The relays on disk, so that they survive a restart as a board's latching relays survive a power cut."""

from __future__ import annotations

import json
import os
from collections.abc import Sequence
from pathlib import Path


class RelayFileError(ValueError):
    """A state file that is not one of this board's; the message names it and the remedy."""


def read_relays(path: Path, channels: int) -> tuple[bool, ...] | None:
    """Return which relays were closed, or None if the file is not there yet.

    Raises:
        RelayFileError: the file cannot be read, or is of another board.
    """
    try:
        document = json.loads(path.read_text(encoding="utf-8"))
        relays = document["relays"]
        if not isinstance(relays, list) or not all(isinstance(closed, bool) for closed in relays):
            raise ValueError("relays is no list of true and false")
    except FileNotFoundError:
        return None
    except (OSError, ValueError, TypeError, KeyError) as error:
        raise RelayFileError(f"{path}: not a board's state ({error}); remove it to start afresh") from error
    if len(relays) != channels:
        raise RelayFileError(
            f"{path}: the state of {len(relays)} channels, not {channels}; give each board its own file"
        )
    return tuple(relays)


def write_relays(path: Path, relays: Sequence[bool]) -> None:
    """Replace the file in one step: after a crash it holds the old state or the new one, never half of it."""
    new = path.with_name(f"{path.name}.{os.getpid()}.new")
    try:
        with new.open("w", encoding="utf-8") as file:
            json.dump({"relays": list(relays)}, file)
            file.flush()
            os.fsync(file.fileno())
        new.replace(path)
    finally:
        new.unlink(missing_ok=True)
