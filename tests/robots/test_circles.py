"""Circles of topics on a robot: their clause counts once they were up, after a restart as well."""

from __future__ import annotations

import json
from typing import Any

import pytest

from robomend.diagnosis.engines import make_engine
from robomend.diagnosis.result import DiagnosisResult, Options
from robomend.entry import Entry
from robomend.model.loading import load_text
from robomend.model.system import System
from robomend.oneshots.result_json import quoted_names, result_text
from robomend.oneshots.warm_model import ask_engine
from robomend.repairs.headline import of_robot
from robomend.robots.batches import Update
from robomend.robots.health import HealthState, health_of
from robomend.robots.robot import Robot
from robomend.store.records import StoredDiagnosis, StoredModel, StoredObs, StoredRobot
from robomend_client.literals import Atom, fails, holds

SOURCE = "robomend: 1\nname: m\nnodes: {est: {publishes: {state: [cmd]}}, ctl: {publishes: {cmd: [state]}}}\n"
SYSTEM = load_text(SOURCE, name="m", format=None)
GUIDED = load_text(
    SOURCE.replace("[state]}", "[state, goal]}") + "topics: {goal: {}}\n", name="m", format=None
)
SELF = load_text("robomend: 1\nname: m\nnodes: {slam: {publishes: {map: [map]}}}\n", name="m", format=None)
MODEL = StoredModel("m", "v1", 1, "component", SOURCE, 0, "test")


async def never(robot: str) -> Robot:
    raise AssertionError("not read by itself")


def made(system: System = SYSTEM, **config: object) -> Robot:
    return Robot(StoredRobot("r1", {"model": "m", **config}, "e1", 0, 0), MODEL, system, never)


def say(robot: Robot, time_ns: int, *ok: str, silent: tuple[str, ...] = ()) -> None:
    literals = [*(holds("ok", topic) for topic in ok), *(fails("ok", topic) for topic in silent)]
    robot.apply(Update(tuple(Entry(literal, "agent", time_ns) for literal in literals)))


def diagnosed(robot: Robot) -> DiagnosisResult:
    _, system, literals = robot.question()
    engine = make_engine("sat", system.cnf)
    try:
        return ask_engine(engine, system.cnf, literals, Options())
    finally:
        engine.close()


def bad_of(robot: Robot) -> set[tuple[str, ...]]:
    return {diagnosis.bad for diagnosis in diagnosed(robot).diagnoses}


def test_a_circle_that_never_began_blames_nobody() -> None:
    robot = made()
    say(robot, 1, "state", silent=("cmd",))
    say(robot, 2, silent=("state", "cmd"))
    assert bad_of(robot) == {()}


def test_one_that_was_up_blames_its_members() -> None:
    robot = made()
    say(robot, 1, "state", "cmd")
    version = robot.question()[0]
    say(robot, 2, silent=("state", "cmd"))
    assert bad_of(robot) == {("est",), ("ctl",)}
    assert robot.question()[0] == version != MODEL.version


def test_after_a_restart_of_the_service_the_last_diagnosis_tells_that_it_was_up() -> None:
    before = made()
    say(before, 1, "state", "cmd")
    say(before, 2, silent=("state", "cmd"))
    quoted = quoted_names(SYSTEM.cnf.components)
    result = json.loads(result_text(diagnosed(before), quoted))
    after = made()
    stored = StoredDiagnosis("r1", 2, "v1", 2, {"model_version": "v1", "result": result})
    after.read(after.stored, MODEL, SYSTEM, StoredObs(2, before.obs.entries()), (), stored, {})
    assert bad_of(after) == {("est",), ("ctl",)}


@pytest.mark.parametrize(
    ("before", "silent", "config", "waiting"),
    [
        ((), ("state", "cmd"), {}, ("cmd", "state")),
        (("goal",), ("state", "cmd"), {"system": GUIDED}, ("cmd", "state")),
        ((), ("state", "cmd"), {"system": GUIDED}, ()),  # there may be no goal
        (("goal",), ("state", "cmd"), {"system": GUIDED, "expected": {"stopped": ["ctl"]}}, ()),
        ((), ("map",), {"system": SELF}, ("map",)),
        (("map",), (), {"system": SELF}, ()),
    ],
)
def test_nobody_knows_that_a_robot_is_well_whose_circle_never_began(
    before: tuple[str, ...], silent: tuple[str, ...], config: dict[str, Any], waiting: tuple[str, ...]
) -> None:
    robot = made(**config)
    say(robot, 1, *before, silent=silent)
    found = diagnosed(robot)
    assert found.healthy
    result = json.loads(result_text(found, quoted_names(robot.system.cnf.components)))
    stored = StoredDiagnosis("r1", 1, "v1", 1, {"model_version": "v1", "result": result})
    obs = StoredObs(1, robot.obs.entries())
    robot.read(robot.stored, MODEL, robot.system, obs, (), stored, {})
    atoms = tuple(Atom("ok", (topic,)) for topic in waiting)
    state = HealthState.PARTLY_UNKNOWN if waiting else HealthState.HEALTHY
    assert health_of(robot) == (state, atoms)
    said = of_robot(robot, None).text(2)
    assert ("not known ever to have worked" in said) == bool(waiting), said
