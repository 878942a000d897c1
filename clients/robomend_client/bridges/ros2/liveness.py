"""Which nodes run: by discovery, and for those on this computer by their processes.

what is seen                                            the node is
its participant is discovered and names it              running
its process on this computer has ended, or is stopped   not running, at once
its participant has gone: it said so, or its lease      not running
    (10 or 20 s, as its own settings say) is over
"""

from __future__ import annotations

import asyncio

from robomend_client.bridges.processes import Process
from robomend_client.bridges.ros2.discovered import Discovered, Participant
from robomend_client.bridges.ros2.processes import find


class Liveness:
    """Of all nodes of one domain."""

    def __init__(self, found: Discovered) -> None:
        self._found = found
        self._processes: dict[Participant, Process | None] = {}

    async def look(self) -> dict[str, bool]:
        """Return which nodes run now."""
        known = set(self._found.participants.values())
        for participant in self._processes.keys() - known:
            del self._processes[participant]
        for participant in known - self._processes.keys():
            if participant.key != self._found.own:
                self._processes[participant] = await asyncio.to_thread(find, participant)
        return self._found.nodes(
            {
                participant.key: process.works()
                for participant, process in self._processes.items()
                if process is not None
            }
        )
