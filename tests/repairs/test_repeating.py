"""An act is not done again and again: three times without new evidence, two where the answer is plain."""

from __future__ import annotations

from pathlib import Path

import pytest
from tests.repairs.robot import BOOTS_AT_ONCE, Robot, answers, repaired

from robomend.repairs.acts import Repeats
from robomend_client.actions import FAILED, NO_PROGRAM, OK, REFUSED, Action, ActionResult
from robomend_client.literals import Literal, fails, holds

START = Action("r-1:0", "start_node", ("planner",), 10.0)
MUTE = (fails("ok", "path"), fails("running", "planner"))


def done(repeats: Repeats, times: int, result: ActionResult, known: tuple[Literal, ...] = MUTE) -> str | None:
    """Do an act so often; return why it is not done once more."""
    for _ in range(times):
        repeats.sent(START, known)
        repeats.answered(START, result)
    return repeats.why_not(str(START), START.parameters, known)


@pytest.mark.parametrize(
    "known",
    [
        (fails("ok", "path"), holds("running", "planner")),  # it ran for a moment: its own doing
        (fails("running", "planner"),),  # what is unknown now is no evidence
        (*MUTE, fails("ok", "cmd")),  # … nor what was unknown then
    ],
)
def test_what_the_act_switches_itself_and_what_is_unknown_are_no_evidence(known: tuple[Literal, ...]) -> None:
    repeats = Repeats()
    assert done(repeats, 3, ActionResult(OK)) is not None
    assert repeats.exhausted(known) != ()


@pytest.mark.parametrize(
    ("result", "said"),
    [
        (ActionResult(NO_PROGRAM, "planner cannot be started"), "there is no such program"),
        (ActionResult(REFUSED, "channel 3 is faulty"), "it was refused"),
    ],
)
def test_two_plain_answers_end_it_whatever_else_is_observed(result: ActionResult, said: str) -> None:
    repeats = Repeats()
    assert done(repeats, 1, result) is None
    why = done(repeats, 1, result, (holds("ok", "path"),))
    assert why is not None
    assert why == f"it was sent 2 times in this repair, and each answer was plain: {said}"


def test_after_a_crash_what_is_on_disk_counts() -> None:
    twice = {"id": "r-1:4.1", "text": "start_node(planner)", "sent_ns": 1, "result": FAILED, "message": ""}
    once = {**twice, "id": "r-1:9"}
    waiting = {**twice, "id": None, "sent_ns": None, "result": None}
    assert Repeats([twice, waiting]).exhausted(MUTE) == ()
    assert Repeats([twice, once]).exhausted(MUTE) != ()
    assert Repeats([{**twice, "result": NO_PROGRAM}]).exhausted(MUTE) != ()


@pytest.mark.anyio
async def test_a_program_that_there_is_not_is_started_twice_and_a_person_hears_why(tmp_path: Path) -> None:
    repair, robot = await repaired(
        tmp_path, lambda robot: robot.running.update(mapping=False), spoil=answers(NO_PROGRAM, "start_node")
    )
    assert repair["state"] == "escalated"
    assert robot.done == ["start_node(mapping)"] * 2
    assert (
        "it was sent 2 times in this repair, and each answer was plain: there is no such program"
        in repair["reason"]
    )


@pytest.mark.anyio
async def test_a_device_that_comes_back_dead_loses_its_power_once_and_its_driver_is_tried_once_more(
    tmp_path: Path,
) -> None:
    repair, robot = await repaired(
        tmp_path, lambda robot: robot.broken_topics.add("odom"), source=BOOTS_AT_ONCE
    )
    assert repair["state"] == "escalated"
    assert robot.done.count("shutdown(base)") == robot.done.count("power_up(base)") == 1
    assert robot.done.count("start_node(base_node)") == 3
    assert robot.done[-2:] == ["stop_node(base_node)", "start_node(base_node)"]
    assert "shutdown(base) is refused: it was done in this repair without help" in repair["reason"]


@pytest.mark.anyio
async def test_a_driver_that_comes_up_mute_after_its_device_was_cycled_is_restarted_alone(
    tmp_path: Path,
) -> None:
    """The device hung; its power cycle helps, and the driver that is started after it says nothing."""

    async def spoil(robot: Robot, name: str, parameter: str) -> int | None:
        cycled = "power_up(base)" in robot.done
        starts = robot.done.count("start_node(base_node)")
        if name == "start_node" and cycled and starts >= 2:
            robot.broken_topics.discard("odom")
        return None

    repair, robot = await repaired(
        tmp_path, lambda robot: robot.broken_topics.add("odom"), spoil=spoil, source=BOOTS_AT_ONCE
    )
    assert repair["state"] == "repaired", repair["reason"]
    assert robot.done == [
        *("stop_node(base_node)", "start_node(base_node)"),
        *("shutdown(base)", "power_up(base)", "stop_node(base_node)", "start_node(base_node)"),
        *("stop_node(base_node)", "start_node(base_node)"),
    ]
