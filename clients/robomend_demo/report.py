"""What the demo leaves: demo.json, a picture of each scenario, and a summary for people."""

from __future__ import annotations

import json
import shlex
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.table import Table

from robomend.errors import InputError
from robomend.web.timeline import ActionBar, Mark, Span, Timeline, svg
from robomend_client.counts import counted
from robomend_client.events import Event, Kind
from robomend_demo.cast import ROBOT, Cast
from robomend_demo.figures import NS, Figures, figures
from robomend_demo.record import Record
from robomend_demo.scenarios import POWER_UP, SCENARIOS, SHUT_DOWN

BadSets = tuple[tuple[str, ...], ...]
"""The bad components of each minimal diagnosis."""

MARGIN_S = 0.3
"""Shown after the end."""


def timeline(record: Record, components: Sequence[str], figures: Figures) -> Timeline:
    """Return the figure of a scenario, in the manner of the paper's figures 5 and 6."""

    def at_s(time_ns: int) -> float:
        return (time_ns - record.zero_ns) / NS

    end_s = at_s(record.repaired_arrived_ns) + MARGIN_S
    marks = [
        Mark(at_s(done.planned_arrived_ns), _planned(number, len(record.rounds)))
        for number, done in enumerate(record.rounds, start=1)
    ]
    marks.append(Mark(at_s(record.repaired_arrived_ns), "all good, verified"))
    from_fault = record.name != POWER_UP.name
    bars = [
        ActionBar(at_s(run.sent_ns), at_s(run.ended_ns), run.text, run.state != "failed")
        for done in record.rounds
        for run in done.steps
        if run.sent_ns is not None and run.ended_ns is not None
    ]
    diagnoses = [
        (at_s(one.arrived_ns), bad_sets(one.event))
        for one in record.heard
        if one.event.kind is Kind.DIAGNOSIS
    ]
    if from_fault:
        known = next((found for at, found in diagnoses if found and at == figures.detection_s), None)
        named = ["{" + ", ".join(bad) + "}" for bad in known or (record.rounds[0].bad,)]
        marks.append(Mark(figures.detection_s, f"diagnosis: {' or '.join(named)}"))
    began: BadSets | None = ((),) if from_fault else None
    rows = [(name, tuple(spans(name, diagnoses, end_s, began))) for name in components]
    actions = counted(sum(len(done.plan) for done in record.rounds), "action")
    since = "fault" if from_fault else "plan"
    subtitle = (
        f"All good and verified {figures.total_s:.2f} s after the {since}, with {actions}; the "
        f"service's own share of that is {figures.service_share_s:.2f} s."
    )
    return Timeline(SCENARIOS[record.name].title, subtitle, rows, bars, marks, end_s)


def _planned(number: int, count: int) -> str:
    return "repair planned" if count == 1 else f"repair planned, round {number}"


def bad_sets(event: Event) -> BadSets | None:
    """Return the minimal diagnoses of an event; None if there is no answer."""
    result = event.data["result"]
    return None if result is None else tuple(tuple(one["bad"]) for one in result["diagnoses"])


def spans(
    component: str,
    diagnoses: Iterable[tuple[float, BadSets | None]],
    end_s: float,
    began: BadSets | None,
) -> Iterable[Span]:
    """Yield when a component was good and bad, equal neighbours joined; unknown times are left out.

    Args:
        diagnoses: time and minimal diagnoses, in order; None: not known from then on.
        began: the minimal diagnoses at 0 s.
    """
    since, share = 0.0, _share(component, began)
    for at_s, found in [*diagnoses, (end_s, None)]:
        now = _share(component, found)
        if now != share:
            if share is not None and at_s > since:
                yield Span(since, at_s, share > 0, 0 < share < 1)
            since, share = max(at_s, 0.0), now


def _share(component: str, found: BadSets | None) -> float | None:
    """Return 1 if all minimal diagnoses blame the component, 0 if none does, 0.5 if some do."""
    if found is None:
        return None
    blaming = sum(component in bad for bad in found)
    return 0.0 if blaming == 0 else 1.0 if blaming == len(found) else 0.5


def scenario_json(record: Record, figures: Figures) -> dict[str, Any]:
    """Return a scenario as demo.json has it."""
    first = record.rounds[0]
    value: dict[str, Any] = {
        "name": record.name,
        "repaired": True,
        "diagnosis": {"bad": list(first.bad), "good": list(first.good)},
        "plan": list(first.plan),
    }
    if len(record.rounds) > 1:
        value["rounds"] = [
            {"diagnosis": {"bad": list(done.bad), "good": list(done.good)}, "plan": list(done.plan)}
            for done in record.rounds
        ]
    value["figures"] = figures.json()
    value["account"] = list(record.account)
    value["events"] = [
        {"t_s": round((one.event.time_ns - record.zero_ns) / NS, 4), "kind": str(one.event.kind), **told}
        for one in record.heard
        if (told := told_of(one.event)) is not None
    ]
    return value


def told_of(event: Event) -> Mapping[str, Any] | None:
    """Return what demo.json tells of an event; None for what is of no interest to a reader."""
    data = event.data
    match event.kind:
        case Kind.OBSERVATIONS:
            said = {"revision": data["revision"], "changed": data["changed"]}
            return said if data["changed"] or data["forgotten"] else None
        case Kind.DIAGNOSIS:
            result = data["result"]
            found = [] if result is None else [one["bad"] for one in result["diagnoses"]]
            return {"revision": data["revision"], "diagnoses": found, "fault": data["fault"]}
        case Kind.REPAIR:
            return {"repair": data["id"], "state": data["state"], "reason": data["reason"]}
        case Kind.ACTION:
            if "repair" not in data:
                return None
            keys = ("repair", "index", "text", "state", "result", "message", "seen", "missing")
            return {key: data[key] for key in keys}
        case Kind.BOARD:
            return {"link": data.get("link"), "reason": data.get("reason")}
    return None


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
