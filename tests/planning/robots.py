"""Robots that the planning tests share: the paper's, by hand, and what can be read off a plan."""

from __future__ import annotations

from robomend.model.components import ComponentModel, Hardware, Node
from robomend.planning.plan import Plan
from robomend_client.literals import Literal, fails

NODES = {
    "jaguar_node": Node("jaguar_node", ("jaguar",), {"odom": ()}),
    "hokuyo_node": Node("hokuyo_node", ("hokuyo",), {"scan": ()}),
    "laser_alignment_node": Node("laser_alignment_node", ("laser_alignment",)),
    "imu_node": Node("imu_node", ("imu",), {"imu_data": ()}),
    "joy_node": Node("joy_node", ("joystick",), {"joy": ()}),
    "jaguar_teleop_node": Node("jaguar_teleop_node", (), {"cmd_vel": ("joy",)}),
    "hector_mapping": Node("hector_mapping", (), {"map": ("scan",)}),
    "rviz": Node("rviz"),
    "laser_alignment_control": Node("laser_alignment_control"),
}

TEDUSAR = ComponentModel(
    "tedusar",
    {
        "jaguar": Hardware("jaguar", 7),
        "hokuyo": Hardware("hokuyo", 3),
        "laser_alignment": Hardware("laser_alignment", 1),
        "imu": Hardware("imu"),
        "joystick": Hardware("joystick"),
    },
    NODES,
    {},
)

ALL_OFF: tuple[Literal, ...] = (
    *(fails("on", name) for name in ("jaguar", "hokuyo", "laser_alignment")),
    *(fails("running", name) for name in NODES),
)
POWER_UP = tuple(name for name in TEDUSAR.components if name not in ("imu", "joystick"))


def texts(plan: Plan) -> list[str]:
    return [str(step) for step in plan.steps]


PLANNERS = ("pyperplan", "asp", "dijkstra")
