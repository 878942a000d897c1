"""Which events people are told of, and in which words.

event                                                    about        told again
repair   a plan, or a question, waits for a yes          approval     for another plan or question
repair   it ended, and a person is needed                escalated    for another repair
repair   it acted, and nobody saw that it helped         escalated    for another repair
drill    it ended, and left the robot unhealthy          escalated    for another drill
change   it waits for a yes                              approval     for another change
change   of a function with `notify`: it was made, or    change       each time
         failed
robot    nothing is known of it                          unknown      after an hour
stop     the global stop was set, or lifted              stop         each time
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any
from urllib.parse import quote

from robomend.drills.record import DrillState
from robomend.planning.plan import action_titles, in_prose
from robomend.repairs.headline import Facts, headline, observed, of_repair, short, told
from robomend.repairs.states import ChangeState, RepairState
from robomend.robots.health import HealthState
from robomend.timestamps import rfc3339
from robomend_client.counts import first_few
from robomend_client.events import Event, Kind

Json = Mapping[str, Any]

KINDS = frozenset({Kind.REPAIR, Kind.CONFIGURATION, Kind.DRILL, Kind.ROBOT, Kind.STOP})
"""Of events that may be told of."""

TOLD = frozenset(
    {RepairState.AWAITING_APPROVAL, RepairState.UNCONFIRMED, RepairState.ESCALATED, RepairState.FAILED}
)
"""States of a repair that people are told of."""

MOST_TOLD = 20
"""Steps of a plan, or components, that a message lists."""

MOST_MEASURED = 5
"""Readings that a message has."""

TEXT_CHARACTERS = 1000
"""Of a reason; what robots and people wrote may be long."""


@dataclass(frozen=True, slots=True)
class Notice:
    """Something that people are told, once for each `key` and recipient."""

    about: str  # approval, escalated, unknown, stop or test
    key: str
    robot: str | None
    repair: str | None
    time_ns: int
    title: str  # one line
    lines: tuple[str, ...]  # what there is to say besides

    @property
    def data(self) -> Json:
        """What is kept of it."""
        return {
            "about": self.about,
            "robot": self.robot,
            "repair": self.repair,
            "time_ns": self.time_ns,
            "title": self.title,
            "lines": list(self.lines),
        }


def notice_of(event: Event) -> Notice | None:
    """Return what people are told of an event; None: nothing."""
    if event.kind is Kind.REPAIR:
        return _of_repair(event)
    if event.kind is Kind.CONFIGURATION:
        return _of_change(event)
    if event.kind is Kind.DRILL:
        return _of_drill(event)
    if event.kind is Kind.ROBOT:
        return _of_robot(event)
    return _of_stop(event) if event.kind is Kind.STOP else None


def trial_notice(recipient: str, by: str, time_ns: int) -> Notice:
    """Return what is sent to see whether it arrives."""
    lines = (f"sent to {recipient} on request of {by}; nothing is wrong",)
    return Notice(
        "test", f"test:{recipient}:{time_ns}", None, None, time_ns, "a test of notifications", lines
    )


def message(number: int, data: Json, public_url: str | None) -> dict[str, Any]:
    """Return a kept notice as a receiver gets it."""
    return {
        "id": f"n-{number}",
        "about": data["about"],
        "robot": data["robot"],
        "repair": data["repair"],
        "time": rfc3339(data["time_ns"]),
        "title": data["title"],
        "text": "\n".join(data["lines"]),
        "url": _link(data, public_url),
    }


def _link(data: Json, public_url: str | None) -> str | None:
    if public_url is None:
        return None
    root = public_url.rstrip("/")
    if data["repair"]:
        return f"{root}/ui/repairs/{quote(data['repair'])}"
    return f"{root}/ui/robots/{quote(data['robot'])}" if data["robot"] else f"{root}/"


def _of_repair(event: Event) -> Notice | None:
    data, state = event.data, event.data.get("state")
    if "asked" in data or state not in TOLD:
        return None
    repair, reason = str(data.get("id")), _short(data.get("reason") or "")
    plan = [str(step.get("text")) for step in data.get("plan") or ()]
    diagnosis = data.get("diagnosis") or {}
    said = of_repair(data)
    what, then = (told(words, event.time_ns) for words in (said.what, said.then))
    lines = [then]
    if state == RepairState.AWAITING_APPROVAL:
        about = "approval"
        titles = action_titles(data.get("plan") or ())
        lines += [f"plan: {first_few(titles, MOST_TOLD, '; ')}"] if len(plan) > 1 else []
        asked = json.dumps([data.get("round"), plan, diagnosis.get("bad"), reason]).encode()
        key = f"approval:{repair}:{hashlib.sha256(asked).hexdigest()[:16]}"
    elif data.get("drill") is not None or data.get("again") or data.get("optional"):
        # A planted fault is undone, and the robot can do without what is optional: nobody is needed for it.
        # Of what is taken up again somebody was told.
        return None
    elif state == RepairState.UNCONFIRMED and not data.get("rounds"):  # it did nothing
        return None
    else:
        about, key = "escalated", f"escalated:{repair}"
    if diagnosis.get("bad"):
        lines.append(f"diagnosis: {first_few(diagnosis['bad'], MOST_TOLD)}")
    lines += [f"seen: {one}" for one in _measured(data)]
    why = reason.removeprefix(f"{', '.join(diagnosis.get('bad') or ())}: ")
    lines += [f"reason: {in_prose(why)}"] if why and short(reason) not in then else []
    title = f"{event.robot}: {what.rstrip('.')}"
    return Notice(about, key, event.robot, repair, event.time_ns, title, tuple(lines))


def _of_change(event: Event) -> Notice | None:
    data, state = event.data, event.data.get("state")
    asks = state == ChangeState.AWAITING_APPROVAL
    wanted = asks or (data.get("notify") and state in {ChangeState.CHANGED, ChangeState.FAILED})
    if "asked" in data or not wanted:
        return None
    change = str(data.get("id"))
    lines = [_short(str(one.get("text"))) for one in data.get("changes") or ()]
    plan = action_titles(data.get("plan") or ())
    lines += [f"plan: {first_few(plan, MOST_TOLD, '; ')}"] if plan and asks else []
    if state == ChangeState.FAILED:
        lines.append(f"reason: {in_prose(_short(data.get('reason') or ''))}")
    what = {
        ChangeState.AWAITING_APPROVAL: "a change of configuration waits for a yes",
        ChangeState.CHANGED: "its configuration was changed",
    }.get(ChangeState(str(state)), "a change of configuration failed")
    about = "approval" if asks else "change"
    title = f"{event.robot}: {what}"
    return Notice(about, f"{about}:{change}", event.robot, None, event.time_ns, title, tuple(lines))


def _measured(data: Json) -> list[str]:
    """Return what was measured of the symptoms that a repair's newest round, or its end, rests on."""
    newest: Json = data.get("unmended") or next(reversed(data.get("rounds") or ()), {})
    found = [one for one in newest.get("symptoms", ()) if one.get("reading")]
    return [observed(one) for one in found[:MOST_MEASURED]]


def _of_drill(event: Event) -> Notice | None:
    data = event.data
    if "asked" in data or data.get("state") != DrillState.FAILED:
        return None
    drill, lines = str(data.get("id")), (f"reason: {in_prose(_short(data.get('reason') or ''))}",)
    title = f"{event.robot}: a drill ended, and a person is needed"
    return Notice("escalated", f"drill:{drill}", event.robot, None, event.time_ns, title, lines)


def _of_robot(event: Event) -> Notice | None:
    data = event.data
    if data.get("what") != "health" or data.get("state") != "unknown" or data.get("reported") is False:
        return None
    silent = [str(atom) for atom in data.get("unknown") or ()]
    said = headline(Facts(HealthState.UNKNOWN, unknown=silent))
    what, then = (told(words, event.time_ns) for words in (said.what, said.then))
    lines = [then, f"not observed: {first_few(silent, MOST_TOLD)}"] if silent else [then]
    title = f"{event.robot}: {what.rstrip('.')}"
    return Notice("unknown", f"unknown:{event.robot}", event.robot, None, event.time_ns, title, tuple(lines))


def _of_stop(event: Event) -> Notice:
    data = event.data
    active = bool(data.get("active"))
    title = "the global stop was set" if active else "the global stop was lifted"
    lines = [f"by: {data.get('by')}"]
    lines += [f"reason: {_short(data['reason'])}"] if data.get("reason") else []
    return Notice("stop", f"stop:{event.id}", None, None, event.time_ns, title, tuple(lines))


def _short(text: str) -> str:
    return text if len(text) <= TEXT_CHARACTERS else f"{text[: TEXT_CHARACTERS - 1]}…"
