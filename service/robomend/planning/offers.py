"""Who of a robot's agents can do what, by action and parameter: what nobody can do is not planned.

An agent says with each poll what it is handed (robomend.repairs.agent_queue holds it to that); an action that
none of them is handed would wait for its time-out, and then not have been done. Pure; values only.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

from robomend_client.actions import offered

NAMED = 5
"""Parameters that a reason lists of an agent; the rest is counted."""


@dataclass(frozen=True, slots=True)
class Offer:
    """What one agent says."""

    agent: str
    host: str | None = None
    can: frozenset[str] | None = None  # None: anything


@dataclass(frozen=True, slots=True)
class Offers:
    """What all agents of a robot say: none that is there is missing."""

    agents: tuple[Offer, ...]
    actions: frozenset[str]  # those that agents carry out
    hosts: Mapping[str, str | None] = field(default_factory=dict)  # component -> whose agents act on it

    def any_does(self, name: str) -> bool:
        """Return whether an agent does an action at all, on whatever."""
        return any(
            agent.can is None or name in agent.can or any(one.startswith(f"{name}:") for one in agent.can)
            for agent in self.agents
        )

    def why_nobody(self, name: str, parameters: Sequence[str]) -> str | None:
        """Return why an action would find nobody, or None.

        Of a host none of whose agents was heard nothing is known: one may be about to come back.
        """
        if name not in self.actions:
            return None
        host = next((self.hosts[each] for each in parameters if self.hosts.get(each)), None)
        there = [agent for agent in self.agents if host is None or agent.host == host]
        if not there or any(offered(agent.can, name, parameters) for agent in there):
            return None
        said = "; ".join(f"{agent.agent} does {_listed(name, agent.can or ())}" for agent in there[:NAMED])
        more = f" and {len(there) - NAMED} more agents" if len(there) > NAMED else ""
        return f"no agent{f' on {host}' if host else ''} offers it ({said}{more})"


def _listed(name: str, can: frozenset[str] | tuple[()]) -> str:
    """Return on what an agent does an action."""
    said = (one.partition(":")[2] for one in can if one.startswith(f"{name}:"))
    on = sorted(f"({one.replace(',', ', ')})" if "," in one else one for one in said)
    if not on:
        return f"no {name}"
    more = f" and {len(on) - NAMED} more" if len(on) > NAMED else ""
    return f"{name} of {', '.join(on[:NAMED])}{more}"
