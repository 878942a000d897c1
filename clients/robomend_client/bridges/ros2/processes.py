"""The process of a participant, where it runs on this computer: the system knows at once that it ended.

DDS itself notices a killed or frozen process when its lease is over, 10 or 20 s later. A participant says at
which address it takes messages: if that is one of ours, the process is the one that has the port open.
"""

from __future__ import annotations

from robomend_client.bridges.processes import Process, has_open, is_ours
from robomend_client.bridges.ros2.discovered import Participant


def find(participant: Participant) -> Process | None:
    """Return the process of a participant; None if it is on another computer, or nobody's that we may see."""
    if not participant.port or not is_ours(participant.address):
        return None
    return has_open(lambda local, _: local == participant.port, ("udp", "udp6"), participant.pid)
