"""Which nodes run: a state for each, from what happens. No sockets, no clocks.

    what is seen                                     the node is
    a connection of its own stands, it answers       running
    nobody listens at its address any more           gone
    the connection is taken and nothing said         frozen: not running, as far as anybody can use it
    no way leads to its host, its name is unknown    unknown

The master is believed where it names nodes, and not where it goes on naming them: it does not notice that one
was killed, and after a restart names none of those that go on.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from enum import Enum


class NodeState(Enum):
    NEW = "not asked yet"
    RUNNING = "running"
    GONE = "gone"
    FROZEN = "frozen"
    UNREACHABLE = "out of reach"


RUNS: Mapping[NodeState, bool | None] = {
    NodeState.NEW: None,
    NodeState.RUNNING: True,
    NodeState.GONE: False,
    NodeState.FROZEN: False,
    NodeState.UNREACHABLE: None,
}

MOST_NODES = 4096

LAST_WORDS_S = 0.15
"""What is read of a node within so long after it was seen to be gone, it said before."""


@dataclass(slots=True)
class KnownNode:
    """What is known of one node."""

    uri: str = ""  # its address; empty: not asked for yet
    state: NodeState = NodeState.NEW
    links: int = 0  # connections of its own that stand
    heard_s: float = float("-inf")  # when it was last heard: a message, a connection, an answer
    gone_s: float = float("-inf")  # when it was last seen to be gone


class Nodes:
    """All nodes of one master, by their full names."""

    def __init__(self) -> None:
        self.known: dict[str, KnownNode] = {}

    def table(self) -> dict[str, bool | None]:
        """Return which run, as observers read it."""
        return {name: RUNS[node.state] for name, node in self.known.items()}

    def why(self, name: str, timeout_s: float) -> Mapping[str, str] | bool:
        """Return why a node does not run, as the node observer takes it."""
        node = self.known.get(name)
        if node is not None and node.state is NodeState.FROZEN:
            return {"why": f"does not answer within {timeout_s:g} s", "symptom": "halted"}
        if node is not None and node.state is NodeState.GONE:
            return {"why": f"nobody listens at {node.uri or 'its address'} any more", "symptom": "ended"}
        return False

    def listed(self, names: frozenset[str]) -> bool:
        """The master names these; return whether any was forgotten."""
        for name in sorted(names - self.known.keys()):
            if len(self.known) < MOST_NODES:
                self.known[name] = KnownNode()
        ended = [
            name
            for name, node in self.known.items()
            if name not in names and not node.links and node.state is not NodeState.RUNNING
        ]
        for name in ended:
            del self.known[name]
        return bool(ended)

    def linked(self, name: str, uri: str, now_s: float) -> bool:
        """A connection of the node stands; return whether its state is another now."""
        node = self.known.setdefault(name, KnownNode())
        node.uri = uri
        node.links += 1
        return self.asked(name, NodeState.RUNNING, now_s)

    def unlinked(self, name: str) -> None:
        """A connection of the node was lost: that alone says nothing, it may have stopped publishing."""
        if node := self.known.get(name):
            node.links -= 1

    def heard(self, name: str, now_s: float) -> bool:
        """A message of the node was read; return whether its state is another now."""
        node = self.known.get(name)
        if node is None or now_s - node.gone_s < LAST_WORDS_S:
            return False
        node.heard_s = now_s
        return node.state is not NodeState.RUNNING and self._is_now(node, NodeState.RUNNING)

    def asked(self, name: str, state: NodeState, now_s: float) -> bool:
        """The node was asked whether it runs; return whether its state is another now."""
        node = self.known.get(name)
        if node is None:
            return False
        node.heard_s = now_s  # or so: the next question has its time
        node.gone_s = now_s if state is NodeState.GONE else float("-inf")
        return self._is_now(node, state)

    def silent(self, now_s: float, for_s: float) -> frozenset[str]:
        """Return the nodes that have said nothing for so long."""
        return frozenset(name for name, node in self.known.items() if now_s - node.heard_s >= for_s)

    @staticmethod
    def _is_now(node: KnownNode, state: NodeState) -> bool:
        changed = node.state is not state
        node.state = state
        return changed
