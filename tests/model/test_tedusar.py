"""The running example compiles to the paper's clauses, one by one."""

from __future__ import annotations

from robomend.model.loading import load_model
from robomend.resources import resource

RULES = [
    ("scheme 1", "not ab(jaguar) -> on(jaguar)"),
    ("scheme 1", "not ab(hokuyo) -> on(hokuyo)"),
    ("scheme 1", "not ab(laser_alignment) -> on(laser_alignment)"),
    ("scheme 2", "not ab(jaguar_node) and not ab(jaguar) -> ok(odom)"),
    ("scheme 2", "not ab(hokuyo_node) and not ab(hokuyo) -> ok(scan)"),
    ("scheme 3", "not ab(imu_node) -> ok(imu_data)"),
    ("scheme 3", "not ab(joy_node) -> ok(joy)"),
    ("scheme 4", "not ab(jaguar_teleop_node) and ok(joy) -> ok(cmd_vel)"),
    ("scheme 4", "not ab(hector_mapping) and ok(scan) -> ok(map)"),
    ("scheme 5", "not ab(jaguar_node) -> running(jaguar_node)"),
    ("scheme 5", "not ab(hokuyo_node) -> running(hokuyo_node)"),
    ("scheme 5", "not ab(laser_alignment_node) -> running(laser_alignment_node)"),
    ("scheme 5", "not ab(imu_node) -> running(imu_node)"),
    ("scheme 5", "not ab(joy_node) -> running(joy_node)"),
    ("scheme 5", "not ab(jaguar_teleop_node) -> running(jaguar_teleop_node)"),
    ("scheme 5", "not ab(hector_mapping) -> running(hector_mapping)"),
    ("scheme 5", "not ab(rviz) -> running(rviz)"),
    ("scheme 5", "not ab(laser_alignment_control) -> running(laser_alignment_control)"),
]

CLAUSES = [
    {"ab(jaguar)", "on(jaguar)"},
    {"ab(hokuyo)", "on(hokuyo)"},
    {"ab(laser_alignment)", "on(laser_alignment)"},
    {"ab(jaguar_node)", "ab(jaguar)", "ok(odom)"},
    {"ab(hokuyo_node)", "ab(hokuyo)", "ok(scan)"},
    {"ab(imu_node)", "ok(imu_data)"},
    {"ab(joy_node)", "ok(joy)"},
    {"ab(jaguar_teleop_node)", "not ok(joy)", "ok(cmd_vel)"},
    {"ab(hector_mapping)", "not ok(scan)", "ok(map)"},
    {"ab(jaguar_node)", "running(jaguar_node)"},
    {"ab(hokuyo_node)", "running(hokuyo_node)"},
    {"ab(laser_alignment_node)", "running(laser_alignment_node)"},
    {"ab(imu_node)", "running(imu_node)"},
    {"ab(joy_node)", "running(joy_node)"},
    {"ab(jaguar_teleop_node)", "running(jaguar_teleop_node)"},
    {"ab(hector_mapping)", "running(hector_mapping)"},
    {"ab(rviz)", "running(rviz)"},
    {"ab(laser_alignment_control)", "running(laser_alignment_control)"},
]


def test_has_the_eighteen_clauses_of_the_paper() -> None:
    cnf = load_model(resource("examples", "tedusar.yaml")).cnf
    assert [{cnf.word(literal) for literal in clause} for clause in cnf.clauses] == CLAUSES


def test_has_fourteen_components_and_no_doubts() -> None:
    system = load_model(resource("examples", "tedusar.yaml"))
    assert system.cnf.components == (
        "jaguar",
        "hokuyo",
        "laser_alignment",
        "imu",
        "joystick",
        "jaguar_node",
        "hokuyo_node",
        "laser_alignment_node",
        "imu_node",
        "joy_node",
        "jaguar_teleop_node",
        "hector_mapping",
        "rviz",
        "laser_alignment_control",
    )
    assert system.cnf.weak
    assert system.warnings == ()
