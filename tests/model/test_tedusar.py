"""The running example compiles to the paper's clauses, one by one."""

from __future__ import annotations

from robomend.model.loading import load_model
from robomend.resources import resource

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


def test_has_the_eighteen_clauses_and_fourteen_components_of_the_paper_and_no_doubts() -> None:
    system = load_model(resource("examples", "tedusar.yaml"))
    cnf = system.cnf
    assert [{cnf.word(literal) for literal in clause} for clause in cnf.clauses] == CLAUSES
    assert len(cnf.components) == 14
    assert {"imu", "joystick"} < set(cnf.components)  # of which no clause speaks
    assert cnf.weak
    assert system.warnings == ()
