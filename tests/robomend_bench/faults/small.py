"""A small robot that tests share: a lidar with its driver, two nodes in a chain, and a loop.

lidar (channel 1) ── driver ──► scan ──► mapper ──► map ──► planner ──► path
controller ──► command ──► estimator ──► state ──► controller
"""

from __future__ import annotations

from robomend_bench.faults.anatomy import Anatomy, read_anatomy
from robomend_bench.faults.condition import State, abnormal
from robomend_bench.faults.kinds import Fault, begun

MODEL = {
    "hardware": {"lidar": {"channel": 1}},
    "nodes": {
        "driver": {"drives": ["lidar"], "publishes": {"scan": []}},
        "mapper": {"publishes": {"map": ["scan"]}},
        "planner": {"publishes": {"path": ["map"]}},
        "estimator": {"publishes": {"state": ["command"]}},
        "controller": {"publishes": {"command": ["state"]}},
    },
}

ROBOT: Anatomy = read_anatomy(MODEL, {"nodes": {"controller": {"kicks": True}}})


def odd(anatomy: Anatomy, state: State) -> set[str]:
    """Return what is abnormal, as text."""
    return {str(literal) for literal in abnormal(anatomy, state)}


def with_faults(*pairs: tuple[str, str], anatomy: Anatomy = ROBOT) -> State:
    """Return the state with these faults, each component and kind."""
    return begun(anatomy, *(Fault(component, kind) for component, kind in pairs))
