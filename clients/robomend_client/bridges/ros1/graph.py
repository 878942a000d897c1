"""The ROS graph as a value: which node publishes, listens to and offers what."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any

Table = Mapping[str, frozenset[str]]
"""Name of a topic or service -> names of nodes."""


@dataclass(frozen=True)
class Graph:
    """All names are as the master has them, with their slashes."""

    publishers: Table = field(default_factory=dict)
    subscribers: Table = field(default_factory=dict)
    services: Table = field(default_factory=dict)
    types: Mapping[str, str] = field(default_factory=dict)

    @property
    def nodes(self) -> frozenset[str]:
        """All nodes that do any of it."""
        return frozenset(
            node
            for table in (self.publishers, self.subscribers, self.services)
            for nodes in table.values()
            for node in nodes
        )


def read_state(state: Any, types: Any) -> Graph:
    """Return the graph of what `getSystemState` and `getTopicTypes` answer.

    Raises:
        TypeError, ValueError: they are not of the shape they should be.
    """
    publishers, subscribers, services = map(_table, state)
    return Graph(publishers, subscribers, services, {str(topic): str(kind) for topic, kind in types})


def _table(rows: Iterable[Any]) -> Table:
    return {str(name): frozenset(map(str, nodes)) for name, nodes in rows}
