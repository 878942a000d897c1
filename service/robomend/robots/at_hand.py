"""What a robot's observers report: the observables that isolability is asked with.

`observed` of its configuration; what its power board says by itself (the relays, and the currents that are
expected); and what its agents said when they last asked for work.
"""

from __future__ import annotations

from collections.abc import Iterable

from robomend.model.system import System
from robomend.observations.language import parse
from robomend.robots.configuration import RobotConfig
from robomend.robots.declared import Declaration
from robomend_client.literals import Atom


def observables_at_hand(
    config: RobotConfig, system: System, agents: Iterable[Declaration] = ()
) -> tuple[Atom, ...]:
    """Return the atoms, in order; ObservationError where `observed` names what the model does not have."""
    found: set[Atom] = set()
    for sentence in config.observed:
        found |= {literal.atom for literal in parse(sentence, system.vocabulary)}
    if config.board is not None and system.parts is not None:
        for device in system.parts.hardware.values():
            if device.channel is not None:
                found.add(Atom("on", (device.name,)))
                if device.channel in config.board.expected_currents:
                    found.add(Atom("ok", ("current", device.name)))
    for agent in agents:
        found |= agent.observes.keys()
    return tuple(sorted(found))
