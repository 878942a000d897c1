"""What a robot's agents say of themselves when they ask for work: what they can do and observe, and how fast;
and whether its board is reached.

Kept in memory: an agent says it with each poll. Of an agent that is not heard for a while nothing is assumed.
"""

from __future__ import annotations

import contextlib
import time
from collections import OrderedDict, deque
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field

from robomend.errors import ObservationError
from robomend.model.system import System
from robomend.model.vocabulary import Vocabulary
from robomend.observations.language import parse
from robomend.robots.configuration import RobotConfig
from robomend_client.actions import offered, on
from robomend_client.literals import Atom

MOST_AGENTS = 64
HEARD_S = 60.0
"""A declaration counts for so long after the poll that made it; polls are held for 20 s at most."""


NEW_S = 10.0
"""After so long every agent that is there was heard: one that lost the service asks again within 5 s."""


GONE_S = 5.0
"""A board that was not reached for so long switches nothing, as far as plans are concerned."""


@dataclass(frozen=True, slots=True)
class Delays:
    """How fast an atom's observer is."""

    detection_ns: int  # from a change to its verdict, at most
    settling_ns: int  # from `settle` to a verdict, at most


@dataclass(frozen=True, slots=True)
class Declaration:
    """What one agent says."""

    agent: str
    host: str | None = None
    can: frozenset[str] | None = None  # None: it does not say
    observes: Mapping[Atom, Delays] = field(default_factory=dict)
    takes_s: Mapping[str, float] = field(default_factory=dict)  # action, as in `can` -> until its answer
    starved_ns: int | None = None  # since when its computer is starved


class DeclaredAgents:
    """The agents of one robot."""

    __slots__ = ("_agents", "_began_s", "_board_lost_s", "_moves", "_said", "changes")

    def __init__(self) -> None:
        self.changes = 0  # grows when what the agents can do changes, or a board is back that was given up
        self._board_lost_s: float | None = None  # since when it is not reached
        self._said: OrderedDict[tuple[str, str | None, frozenset[str] | None], None] = OrderedDict()
        # To another host, when.
        self._moves: OrderedDict[str, deque[tuple[str | None, float]]] = OrderedDict()
        self._began_s = time.monotonic()
        self._agents: OrderedDict[str, tuple[Declaration, float]] = OrderedDict()

    def hear(self, declaration: Declaration) -> None:
        """An agent polls."""
        before, _ = self._agents.pop(declaration.agent, (None, 0.0))
        if before is not None and before.host != declaration.host:
            moves = self._moves.setdefault(declaration.agent, deque(maxlen=2))
            moves.append((declaration.host, time.monotonic()))
            while len(self._moves) > MOST_AGENTS:
                self._moves.popitem(last=False)
        says = (declaration.agent, declaration.host, declaration.can)
        if says not in self._said:  # two agents of one name say in turns what both have said before
            self.changes += 1
            self._said[says] = None
            while len(self._said) > MOST_AGENTS:
                self._said.popitem(last=False)
        self._agents[declaration.agent] = (declaration, time.monotonic())
        while len(self._agents) > MOST_AGENTS:
            self._agents.popitem(last=False)

    def board(self, *, lost: bool) -> None:
        """The link to its board has changed; one that is closed is lost to nobody."""
        if not lost:
            self.changes += self.boardless
            self._board_lost_s = None
        elif self._board_lost_s is None:
            self._board_lost_s = time.monotonic()

    @property
    def boardless(self) -> bool:
        """Whether it has a board that is not reached, and was not for a while."""
        return self._board_lost_s is not None and time.monotonic() - self._board_lost_s >= GONE_S

    def agents(self) -> tuple[Declaration, ...]:
        """Return what the agents that are heard say."""
        now = time.monotonic()
        return tuple(said for said, heard in self._agents.values() if now - heard < HEARD_S)

    def of_one_name(self) -> list[tuple[str, tuple[str | None, ...]]]:
        """Return the names by which agents of several hosts poll in turns, and those hosts."""
        now = time.monotonic()
        return [
            (agent, tuple(host for host, _ in moves))
            for agent, moves in self._moves.items()
            if len(moves) == 2 and now - moves[0][1] < HEARD_S  # an agent that has moved does not move back
        ]

    def all_heard(self) -> bool:
        """Return whether we have listened for so long that no agent which is there is missing."""
        return time.monotonic() - self._began_s >= NEW_S

    def takes_s(self, name: str, parameters: Sequence[str]) -> float | None:
        """Return within how many seconds an action is answered, by the slowest of who offers it; None: nobody
        says.
        """
        keys = (f"{name}:{on(name, parameters)}", name)
        said = (agent.takes_s for agent in self.agents() if offered(agent.can, name, parameters))
        return max((one[key] for one in said for key in keys if key in one), default=None)

    def delays(self, atom: Atom, usual: Delays) -> Delays:
        """Return how fast an atom is observed: by the slowest of its observers; `usual` where none says."""
        said = [agent.observes[atom] for agent, _ in self._agents.values() if atom in agent.observes]
        if not said:
            return usual
        return Delays(max(one.detection_ns for one in said), max(one.settling_ns for one in said))


def declaration(
    agent: str,
    host: str | None,
    can: Collection[str] | None,
    observes: Mapping[str, tuple[float, float]],
    vocabulary: Vocabulary,
    takes_s: Mapping[str, float] | None = None,
    starved_ns: int | None = None,
) -> Declaration:
    """Return what an agent says, in the words of the robot's model, as far as that has them."""
    delays: dict[Atom, Delays] = {}
    for sentence, (detection_s, settling_s) in observes.items():
        with contextlib.suppress(ObservationError):
            for literal in parse(sentence, vocabulary):
                delays[literal.atom] = Delays(round(detection_s * 1e9), round(settling_s * 1e9))
    offered_acts = None if can is None else frozenset(can)
    return Declaration(agent, host, offered_acts, delays, dict(takes_s or {}), starved_ns)


# --- what a robot's observers report: the observables that isolability is asked with.
#
# `observed` of its configuration; what its power board says by itself (the relays, and the currents that
# are expected); and what its agents said when they last asked for work.


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
