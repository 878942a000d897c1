"""Which nodes run: by discovery, and for those on this computer by their processes.

what is seen                                            the node is
its participant is discovered and names it              running
its process on this computer has ended, or is stopped   not running, at once
its participant has taken the node back                 not running
its participant is not heard any more: its lease
    (10 or 20 s, as its own settings say) is over
    its computer says that nobody has the port          not running
    its computer says nothing                           unknown: the network may have split
    we have not looked for a while, or only again       unknown: nobody took in what it said
"""

from __future__ import annotations

import asyncio
from collections.abc import Collection, Mapping

from robomend_client.bridges.problems import Problems
from robomend_client.bridges.processes import Process, is_ours
from robomend_client.bridges.ros2.base import Unheard
from robomend_client.bridges.ros2.discovered import Discovered, Participant
from robomend_client.bridges.ros2.processes import find
from robomend_client.bridges.ros2.remote_port import RemotePort

MOST_ASKED = 128
"""Ports of other computers that are asked; each takes a socket."""


class Liveness:
    """Of all nodes of one domain."""

    def __init__(self, found: Discovered, problems: Problems, unheard: Unheard) -> None:
        self._found = found
        self._unheard = unheard
        self._problems = problems
        self._processes: dict[Participant, Process | None] = {}
        self._asked: dict[Participant, RemotePort] = {}
        self._silent = {participant.address for participant in found.lost}  # computers that were told of
        self.why: dict[str, dict[str, str]] = {}  # of nodes that do not run: as node observers take it

    async def look(self) -> dict[str, bool | None]:
        """Return which nodes run now."""
        known = set(self._found.participants.values())
        lost = self._found.lost.keys()
        for participant in self._processes.keys() - known - lost:
            del self._processes[participant]
        for participant in known - self._processes.keys():
            if participant.key != self._found.own:
                self._processes[participant] = await asyncio.to_thread(find, participant)
        alive: dict[bytes, bool | None] = {
            participant.key: process.works()
            for participant, process in self._processes.items()
            if process is not None
        }
        alive.update(self._look_at_lost())
        table = self._found.nodes(alive)
        self._explain(table)
        return table

    def _explain(self, table: Mapping[str, bool | None]) -> None:
        """Note why nodes do not run of whose processes that is known; it stays so until they run again."""
        self.why = {name: why for name, why in self.why.items() if table.get(name) is False}
        for participant, process in self._processes.items():
            told = self._found.entities.get(participant.key)
            if process is None or told is None or process.works():
                continue
            for node in told.nodes:
                if table.get(node.name) is False:
                    self.why[node.name] = process.why()

    def close(self) -> None:
        for asked in self._asked.values():
            asked.close()

    def _look_at_lost(self) -> dict[bytes, bool | None]:
        """Return whether those that are not heard any more run; forget those that do not."""
        used = {(other.address, other.port) for other in self._found.participants.values()}
        found: dict[bytes, bool | None] = {}
        silent = set()
        for participant in tuple(self._found.lost):
            runs = self._runs(participant, used)
            if runs is False:
                del self._found.lost[participant]
                continue
            found[participant.key] = runs
            if runs is None:
                silent.add(participant.address)
        for participant in self._asked.keys() - self._found.lost.keys():
            self._asked.pop(participant).close()
        for address in silent - self._silent:
            why = "processes there are not heard any more: whether their nodes run is unknown"
            self._problems.tell(f"the computer {address}", why)
        for address in self._silent - silent:
            self._problems.over(f"the computer {address}")
        self._silent = silent
        return found

    def _runs(self, lost: Participant, used: Collection[tuple[str, int]]) -> bool | None:
        if lost.key in self._found.participants:
            return None  # it is heard again, and will tell its nodes
        if self._unheard.refinds:
            process = self._processes.get(lost)
            return None if process is None or process.works() else False
        here = self._processes.get(lost) is not None or is_ours(lost.address)
        if here or not lost.port or (lost.address, lost.port) in used:
            return False
        if lost not in self._asked:
            if len(self._asked) >= MOST_ASKED:
                return None
            self._asked[lost] = RemotePort(lost.address, lost.port)
        return self._asked[lost].runs()
