"""The power board's measurements as samples, for any observer.

    board                     all channels, for hardware observers; None: the board is silent
    board:current(jaguar)     amperes of the channel on which a device hangs; voltage(jaguar): volts

They come from /board_measurments (ROS 1, recordings), or from the service (board.py), which alone is
connected to the board. A device may be named by its channel's number.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from typing import Any

from robomend_client.bridges.fields import MissingField
from robomend_client.observers import BOARD

MEASURED = re.compile(r"board:(current|voltage)\(([^()]+)\)\Z")


def is_board(source: str) -> bool:
    """Return whether a source is measured by the power board."""
    return source == BOARD or MEASURED.match(source) is not None


def measured(source: str, rows: Any) -> Any:
    """Return what a source of the board is in the rows of a /board_measurments.

    Raises:
        MissingField: no row is of that device.
    """
    found = [row for row in (rows if isinstance(rows, list) else ()) if isinstance(row, Mapping)]
    wanted = MEASURED.match(source)
    if wanted is None:
        return _channels(found)
    what, device = wanted.groups()
    for row in found:
        if device in (row.get("dev_connected"), str(row.get("id"))) and what in row:
            return row[what]
    raise MissingField(f"no {what} of {device}: no channel of the board has a device of that name")


def _channels(rows: Sequence[Mapping[str, Any]]) -> list[dict[str, Any]]:
    """Return the channels as hardware observers read them: by number, up to the first that is missing."""
    found = {
        row["id"]: {"on": row["status"] == 1, "current_a": row["current"]}
        for row in rows
        if {"id", "status", "current"} <= row.keys()
    }
    return [found[number] for number in range(len(found)) if all(n in found for n in range(number + 1))]


def row_of(channel: Mapping[str, Any]) -> dict[str, Any]:
    """Return a channel as the service has it, as /board_measurments says it."""
    return {
        "id": channel["channel"],
        "dev_connected": channel["component"] or "",
        "status": int(channel["on"]),
        "current": channel["current_a"] or 0.0,
        "voltage": channel["voltage_v"] or 0.0,
    }
