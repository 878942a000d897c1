"""A ROS graph as a value: which node publishes, listens to and offers what, wherever that is known from."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

Table = Mapping[str, frozenset[str]]
"""Name of a topic or service -> names of nodes."""


@dataclass(frozen=True)
class RosGraph:
    """All names are as ROS has them, with their slashes."""

    publishers: Table = field(default_factory=dict)
    subscribers: Table = field(default_factory=dict)
    services: Table = field(default_factory=dict)
    types: Mapping[str, str] = field(default_factory=dict)  # of topics, as pkg/Name
    rates_hz: Mapping[str, float] = field(default_factory=dict)  # of topics, where they were measured

    @property
    def nodes(self) -> frozenset[str]:
        """All nodes that do any of it."""
        return frozenset(
            node
            for table in (self.publishers, self.subscribers, self.services)
            for nodes in table.values()
            for node in nodes
        )
