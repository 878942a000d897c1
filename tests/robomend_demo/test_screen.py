"""What people see: the picture on a terminal, lines anywhere else."""

from __future__ import annotations

import io
from collections.abc import Sequence

import pytest
from rich.console import Console
from tests.robomend_demo.records import restarted

from robomend.model.loading import load_model
from robomend.resources import resource
from robomend_client.events import Event, Kind
from robomend_demo.screen import Lines, Picture, RobotView, picture, tell

COMPONENTS = ["h", "n"]
MS = 1_000_000


def seen(until_ms: int) -> RobotView:
    """Return the robot as events up to a moment show it."""
    view = RobotView("r", ["running(n)", "ok(t)"])
    for heard in restarted().heard:
        if heard.event.time_ns <= until_ms * MS:
            view.take(heard.event)
    return view


def drawn(view: RobotView, now_ms: int, components: Sequence[str] = COMPONENTS, width: int = 100) -> str:
    console = Console(file=io.StringIO(), width=width)
    console.print(picture("shut-down", components, view, 0, now_ms * MS))
    assert isinstance(console.file, io.StringIO)
    return console.file.getvalue()


def test_the_picture_says_who_is_bad_and_what_is_being_done() -> None:
    now = drawn(seen(130), 150)
    assert "n          ███ bad" in now
    assert "h          ─── good" in now
    assert "repairing" in now
    assert "▶  Start n  0.12 s  0.03 s" in now


def test_the_longest_names_of_the_robot_fit_72_columns() -> None:
    components = load_model(resource("examples", "tedusar.yaml")).cnf.components
    view = seen(130)
    assert view.repair is not None
    longest = f"power_up({max(components, key=len)})"
    for done in view.repair["rounds"]:
        for step in done["plan"]:
            step["text"] = longest
    view.acts.clear()
    lines = drawn(view, 150, components, 72).splitlines()
    assert all(len(line) <= 72 for line in lines)
    assert any(f"·  Power up {max(components, key=len)}" in line for line in lines)
    for name in components:
        assert sum(line.startswith((f"{name} ", f" {name} ")) for line in lines) == 1  # in one line, whole
    assert lines[-2].strip() == "███ bad   ▄▄▄ suspect   ─── good"


def test_the_end_says_that_all_is_good_and_verified() -> None:
    end = drawn(seen(500), 500)
    assert "all good, and verified" in end
    assert "✓  Start n  0.12 s  0.29 s" in end


def test_lines_tell_each_thing_once(capsys: pytest.CaptureFixture[str]) -> None:
    lines, view = Lines(), RobotView("r", [])
    lines.scene("shut-down", 0, view)
    for heard in restarted().heard:
        lines.heard(heard.event, view)
        lines.heard(heard.event, view)
    printed = capsys.readouterr()
    assert printed.out == ""
    assert [line.split(" s  ")[-1] for line in printed.err.splitlines()[1:]] == [
        "diagnosis: {n}",
        "plan: Start n",
        "diagnosis: {h} or {n}",
        "diagnosis: healthy",
        "Start n: done",
        "repair repaired: ",
    ]


def test_the_account_of_a_scene_is_shown_after_it(capsys: pytest.CaptureFixture[str]) -> None:
    told = ["12:00:00.000 repair r-1 of r begins", "  chosen: [n]", "12:00:01.000 repaired: as it was"]
    Lines().account(told)
    assert capsys.readouterr().err.splitlines() == ["  the record:", *(f"    {line}" for line in told)]
    console = Console(file=io.StringIO(), width=100)
    with Picture(console, COMPONENTS) as screen:
        screen.scene("shut-down", 0, seen(306))
        screen.account(told)
    assert isinstance(console.file, io.StringIO)
    assert "\n".join(["the record:", *(f"  {line}" for line in told)]) in console.file.getvalue()


def test_a_long_set_is_shortened() -> None:
    result = {"diagnoses": [{"bad": list("abcdef")}, {"bad": ["g"]}, {"bad": ["h"]}]}
    event = Event(1, 0, Kind.DIAGNOSIS, "r", {"revision": 1, "result": result, "fault": None})
    assert tell(event) == "diagnosis: {a, b, c, d, and 2 more} or {g} or 1 more"


def test_each_scene_leaves_its_last_picture_and_gives_the_cursor_back() -> None:
    console = Console(file=io.StringIO(), width=100, force_terminal=True)
    with Picture(console, COMPONENTS) as screen:
        screen.scene("power-up", 0, seen(130))
        screen.refresh(seen(306))
        screen.scene("shut-down", 0, seen(306))
        screen.rest()
    assert isinstance(console.file, io.StringIO)
    printed = console.file.getvalue()
    assert " power-up " in printed
    assert " shut-down " in printed
    assert printed.rindex("\x1b[?25h") > printed.rindex("\x1b[?25l")
