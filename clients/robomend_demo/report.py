"""What the demo leaves: demo.json, a picture of each scenario, and a summary for people."""

from __future__ import annotations

import json
import shlex
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.table import Table

from robomend.errors import InputError
from robomend.web.timeline import svg
from robomend_demo.cast import ROBOT, Cast
from robomend_demo.figures import Figures, figures
from robomend_demo.record import Record
from robomend_demo.scenarios import POWER_UP, SCENARIOS, SHUT_DOWN
from robomend_demo.story import scenario_json, timeline

PAPER_POWER_UP_S = 30.2
"""The paper, section VI: from power-on until the last component is good."""


@dataclass(frozen=True, slots=True)
class Told:
    """A scenario and its figures."""

    record: Record
    figures: Figures

    @classmethod
    def of(cls, record: Record) -> Told:
        """Measure a scenario."""
        return cls(record, figures(record, from_plan=record.name == POWER_UP.name))


def demo_json(told: Sequence[Told]) -> dict[str, Any]:
    """Return demo.json."""
    return {"scenarios": [scenario_json(one.record, one.figures) for one in told]}


def usable(folder: Path) -> Path:
    """Return the folder, made if need be; InputError now rather than after the scenarios."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
        probe = folder / ".robomend"
        probe.write_bytes(b"")
        probe.unlink()
    except OSError as error:
        raise InputError(f"--report {folder}: {error.strerror}; name a folder that can be written") from error
    return folder


def write(folder: Path, told: Sequence[Told], components: Sequence[str]) -> None:
    """Write the report."""
    for one in told:
        picture = svg(timeline(one.record, components, one.figures))
        (folder / f"{one.record.name}.svg").write_text(picture, encoding="utf-8")
    text = json.dumps(demo_json(told), indent=2, ensure_ascii=False)
    (folder / "demo.json").write_text(text + "\n", encoding="utf-8")


def summary(console: Console, folder: Path, told: Sequence[Told]) -> None:
    """Print the figures beside the goals and the paper's."""
    table = Table(title="What was measured", title_justify="left", title_style="bold", box=None)
    table.add_column("")
    for heading in ("here", "goal", "paper"):
        table.add_column(heading, justify="right")
    for one in told:
        for row in _rows(one):
            table.add_row(*row)
    console.print()
    console.print(table)
    console.print()
    console.print(f"report: {folder.resolve()}", highlight=False, soft_wrap=True)
    for one in told:
        console.print(f"        {one.record.name}.svg", highlight=False)
    console.print("        demo.json", highlight=False)


def _rows(told: Told) -> Iterable[tuple[str, str, str, str]]:
    own, name = told.figures, told.record.name
    latencies = own.json()["observation_to_diagnosis_ms"]
    goal_s = SCENARIOS[name].goal_s
    if name == POWER_UP.name:
        paper = f"{PAPER_POWER_UP_S} s"
        yield "power-up: from the plan until all is good and verified", *_s(own.total_s, goal_s), paper
    else:
        yield f"{name}: from the fault until all is good and verified", *_s(own.total_s, goal_s), "–"
        yield "  until the fault is diagnosed", *_s(own.detection_s, 1), "–"
    yield "  the service's own share", *_s(own.service_share_s, 1), "–"
    yield "  observation accepted to diagnosis published, median", *_ms(latencies["p50"], 5), "1 s cycle"
    slowest = f"  the same, 99 % of {latencies['count']} (slowest {latencies['max']:.1f} ms)"
    yield slowest, *_ms(latencies["p99"], 20), ""
    yield "  diagnosis to validated plan", *_ms(own.diagnosis_to_plan_ms, 100), "–"


def _s(value: float, goal: float | None) -> tuple[str, str]:
    return f"{value:.2f} s", "–" if goal is None else f"< {goal:g} s"


def _ms(value: float, goal: float) -> tuple[str, str]:
    return f"{value:.1f} ms", f"< {goal:g} ms"


def invitation(cast: Cast, board_command: Sequence[str]) -> str:
    """Return what somebody can try while the robot is held up."""
    robot = f"{cast.url}/api/v1/robots/{ROBOT}"
    control = shlex.join([*board_command, "control", "--port", str(cast.board.control_port)])
    channel = cast.robot.model.hardware[SHUT_DOWN.victim].channel
    return f"""
The robot runs on, and is looked after. In another terminal:

  what is wrong with it, and what was done, in a browser
    {cast.url}/ui/robots/{ROBOT}

  the same in a terminal
    curl -s {robot}/diagnosis
    curl -s '{robot}/repairs?limit=1'
    curl -sN {robot}/events

  take the power from its base, or let that relay stick; it is diagnosed and repaired, or a person is asked
    {control} set {channel} off
    {control} fault stuck {channel} at=off
    {control} clear all

  tell the service something that no observer saw
    curl -s -H 'Content-Type: application/json' {robot}/observations \\
         -d '{{"observations": ["not ok(scan)"]}}'

  everything else: {cast.url}/docs

Ctrl-C ends it.
"""
