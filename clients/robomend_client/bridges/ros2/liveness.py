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
import socket
import time
from collections.abc import Collection, Mapping

from robomend_client.bridges.problems import Problems
from robomend_client.bridges.processes import Process, has_open, is_ours
from robomend_client.bridges.ros2.base import Unheard
from robomend_client.bridges.ros2.discovered import Discovered, Participant

# --- the process of a participant, where it runs on this computer: the system knows at once that it ended.
#
# DDS itself notices a killed or frozen process when its lease is over, 10 or 20 s later. A participant says
# at which address it takes messages: if that is one of ours, the process is the one that has the port open.


def find(participant: Participant) -> Process | None:
    """Return the process of a participant; None if it is on another computer, or nobody's that we may see."""
    if not participant.port or not is_ours(participant.address):
        return None
    return has_open(lambda local, _: local == participant.port, ("udp", "udp6"), participant.pid)


# --- whether anybody still has a port of another computer: that computer's own system says if not.
#
# DDS cannot tell a process that was killed from a network that has split: both are silent. A datagram to a
# port that nobody has is refused (ICMP), by a computer that is there; one that a firewall keeps from saying
# so, or that is out of reach, says nothing.

NOTHING_SAID = b"RTPS\x02\x01\x01\x10" + bytes(12)
"""A message of DDS without a part: whoever takes it does nothing."""

AGAIN_S = 1.0
PATIENCE_S = 0.5
"""So long it is as it was: refusals come at once."""


class RemotePort:
    """One port, asked again and again."""

    def __init__(self, address: str, port: int) -> None:
        family = socket.AF_INET6 if ":" in address else socket.AF_INET
        self._to = (address, port)
        self._socket = socket.socket(family, socket.SOCK_DGRAM)
        self._socket.setblocking(False)
        self._began_s = time.monotonic()
        self._asked_s = float("-inf")
        self._refused = False

    def runs(self) -> bool | None:
        """Return whether somebody has the port; True at first, and None when nothing was said."""
        if self._refused:
            return False
        now_s = time.monotonic()
        try:
            if now_s - self._asked_s >= AGAIN_S:
                self._asked_s = now_s
                self._socket.connect(self._to)
                self._socket.send(NOTHING_SAID)
            self._socket.recv(1)
        except ConnectionRefusedError:
            self._refused = True
            return False
        except (OSError, ValueError):  # nothing yet, or no way there
            pass
        return True if now_s - self._began_s < PATIENCE_S else None

    def close(self) -> None:
        self._socket.close()


MOST_ASKED = 128
"""Ports of other computers that are asked; each takes a socket."""

MOST_GONE = 256
"""Nodes that are gone whose process still says why."""


class Liveness:
    """Of all nodes of one domain."""

    def __init__(self, found: Discovered, problems: Problems, unheard: Unheard) -> None:
        self._found = found
        self._unheard = unheard
        self._problems = problems
        self._processes: dict[Participant, Process | None] = {}
        self._asked: dict[Participant, RemotePort] = {}
        self._gone: dict[str, Process] = {}  # nodes of which DDS knows nothing more, but their processes do
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
        self._gone = {n: one for n, one in self._gone.items() if n not in table and not one.works()}
        table |= dict.fromkeys(self._gone, False)
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
        self.why |= {name: process.why() for name, process in self._gone.items()}

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
                nodes, process = self._found.lost.pop(participant), self._processes.get(participant)
                if process is not None and len(self._gone) < MOST_GONE:
                    self._gone |= dict.fromkeys(nodes, process)
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
