"""Remedies that a graph of ROS offers by its services, as commented lines: nothing is active by itself."""

from __future__ import annotations

import re
from collections.abc import Iterator
from typing import NamedTuple

from robomend_client.ros_graph import RosGraph

COSTMAP = re.compile(r"/clear_(?:entirely_)?(?:\w+_)?costmap\Z")
CLEARS = "nav2_msgs/srv/ClearEntireCostmap"


class OfferedRemedy(NamedTuple):
    """One remedy: the node that it mends, and its lines of a model and of an agent's file."""

    node: str  # its full name
    model: str
    action: str


def offered_remedies(graph: RosGraph) -> tuple[OfferedRemedy, ...]:
    """Return what a robot with ROS 2 offers against its own faults, by names that are usual.

    A component is called as its node is, without the slash. Agents of robomend offer none.
    """
    return tuple(_found(graph))


def _found(graph: RosGraph) -> Iterator[OfferedRemedy]:
    for service, nodes in sorted(graph.services.items()):
        for node in sorted(nodes):
            name = node.strip("/")
            act = re.sub(r"\W", "_", name)
            if service == f"{node}/change_state" and f"{node}/get_state" in graph.services:
                how = f"{{kind: lifecycle, nodes: {{{name}: {node}}}, transition: restart}}"
                yield _remedy(node, f"bring_up_{act}", how)
            elif COSTMAP.search(service):
                short = re.sub(r"\W", "_", service.strip("/"))
                how = f"{{kind: ros2_service, services: {{{name}: {service}}}, type: {CLEARS}}}"
                yield _remedy(node, short, how)


def _remedy(node: str, act: str, how: str) -> OfferedRemedy:
    name = node.strip("/")
    return OfferedRemedy(node, f"#  {act}: {{mends: {name}}}", f"#  {act}: {how}")
