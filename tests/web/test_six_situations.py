"""Six situations, at a desk and on a phone: what, since when, why, what next, what a person may press.

All of it is on the first screen of a robot's page, in the words of the list, the status and the event.
"""

from __future__ import annotations

import re
from dataclasses import dataclass, field
from typing import Any

import pytest
from playwright.sync_api import Page, expect
from tests.api.conftest import Service
from tests.browser import PATIENCE_MS, keep
from tests.waiting import until
from tests.web.conftest import Look
from tests.web.test_fleet import live, row

from robomend.notifications.notices import message, notice_of
from robomend.resources import resource
from robomend.store import events
from robomend_client.events import Event, Kind

expect.set_options(timeout=PATIENCE_MS)

SCREENS = {"desk": {"width": 1440, "height": 900}, "phone": {"width": 390, "height": 844}}
AT = r"\d\d:\d\d:\d\d"


@dataclass(frozen=True)
class Case:
    """A situation, and how its questions are answered."""

    what: str  # with since when and why
    then: str
    press: tuple[str, ...] = ()  # buttons and links
    config: dict[str, Any] = field(default_factory=dict)


SITUATIONS = {
    "healthy": Case(rf"Healthy since {AT}\.", r"Nothing is to be done\.", ("What is observed",)),
    "asks": Case(
        rf"hokuyo has no power since {AT} \(0 of 12 V\); hokuyo_node and 2 more follow\.|"
        rf"hokuyo has no power since {AT} \(0 of 12 V\); map and scan follow\.",
        r"Power up hokuyo and restart hokuyo_node\?",
        ("Approve", "Cancel the repair"),
    ),
    "runs": Case(
        rf"hector_mapping is not running since {AT} \(exit code 1: no map\)\.",
        r"Under way: Start hector_mapping\.",
        ("Cancel the repair",),
        {"policy": "auto", "actions": {"start_node": {"executor": {"kind": "agent"}, "timeout_s": 600}}},
    ),
    "escalated": Case(
        rf"jaguar has no power since {AT}\.", r"A person is needed: .*not today\.", ("Ask for a repair",)
    ),
    "unheard": Case(
        rf"Nothing is heard of it since {AT}\.",
        r"A person is needed: do its agent and its network run\?",
        ("What is observed",),
        {"policy": "observe"},
    ),
    "twofold": Case(
        rf"Two faults: hokuyo has no power since {AT}; hector_mapping is not running since {AT}\.",
        r"Power up hokuyo, restart hokuyo_node and start hector_mapping\?",
        ("Approve", "Cancel the repair"),
    ),
}


def repairs(service: Service, robot: str, state: str) -> list[str]:
    found = service.api("GET", f"/robots/{robot}/repairs").json()["items"]
    return [one["id"] for one in found if one["state"] == state]


@pytest.fixture(scope="module")
def six(service: Service) -> Service:
    for robot, case in SITUATIONS.items():
        service.with_robot(robot, **case.config)
    service.observe("ok(scan)", "on(hokuyo)", robot="healthy")
    volts = {"value": 0, "unit": "of 12 V"}
    service.observe(
        "not on(hokuyo)", "not ok(scan)", "not ok(map)", robot="asks", readings=[volts, None, None]
    )
    code = {"value": "exit code 1: no map", "symptom": "ended"}
    service.observe("not running(hector_mapping)", robot="runs", readings=[code])
    service.observe("not on(jaguar)", robot="escalated")
    service.observe("not on(hokuyo)", "not running(hector_mapping)", robot="twofold")
    seen = {"observations": ["ok(scan)", "on(hokuyo)"], "lifetime_s": 0.5}
    service.api("POST", "/robots/unheard/observations", json=seen)
    until(lambda: repairs(service, "escalated", "awaiting-approval"), "a plan waits", 60)
    refusal = {"decision": "cancel", "reason": "not today"}
    service.api("POST", f"/repairs/{repairs(service, 'escalated', 'awaiting-approval')[0]}", json=refusal)
    for robot in ("asks", "twofold"):
        until(lambda robot=robot: repairs(service, robot, "awaiting-approval"), "a plan waits", 60)  # type: ignore[misc]  # bound here
    until(lambda: repairs(service, "runs", "running"), "a repair runs", 60)
    return service


def on_screen(page: Page, height: int) -> None:
    """Whatever the headline's card has is seen without scrolling."""
    card = page.locator("#headline")
    bottom = card.evaluate("(it) => it.getBoundingClientRect().bottom")
    assert page.evaluate("scrollY") == 0
    assert bottom <= height, f"{bottom} of {height} pixels"


@pytest.mark.parametrize("screen", SCREENS)
@pytest.mark.parametrize("robot", SITUATIONS)
def test_five_questions_are_answered_without_scrolling(
    six: Service, look: Look, robot: str, screen: str
) -> None:
    case, size = SITUATIONS[robot], SCREENS[screen]
    scheme = "dark" if screen == "phone" else "light"
    page = live(look(six, viewport=size, color_scheme=scheme), f"/ui/robots/{robot}")
    expect(page.locator("#headline .then")).to_have_text(re.compile(f"^{case.then}$"))
    expect(page.locator("#headline .what")).to_have_text(re.compile(f"^({case.what})$"))
    for name in case.press:
        expect(
            page.locator("#headline :is(a, button)").filter(has_text=re.compile(f"^{name}$"))
        ).to_be_visible()
    on_screen(page, size["height"])
    assert page.evaluate("document.documentElement.scrollWidth") <= size["width"]
    keep(page, f"situation-{robot}-{screen}")


@pytest.mark.parametrize("robot", SITUATIONS)
def test_list_and_status_and_robot_say_the_same(six: Service, look: Look, robot: str) -> None:
    case = SITUATIONS[robot]
    whole = re.compile(f"^({case.what}) {case.then}$")
    assert whole.match(six.api("GET", f"/robots/{robot}").json()["headline"])
    lines = {one["robot"]: one for one in six.api("GET", "/status").json()["robots"]}
    until(
        lambda: whole.match(
            {one["robot"]: one for one in six.api("GET", "/status").json()["robots"]}[robot]["headline"]
        ),
        "the list says it",
    )
    assert lines.keys() >= SITUATIONS.keys()
    shown = row(live(look(six)), robot)
    assert re.search(f"({case.what})", shown)
    assert re.search(case.then, shown)


def test_by_what_a_function_works_is_told_with_since_when_and_what_was_measured(
    service: Service, look: Look
) -> None:
    source = resource("examples", "suave/model.yaml").read_text(encoding="utf-8")
    assert service.api("PUT", "/models/suave", json={"source": source}).is_success
    service.api("PUT", "/robots/diver", json={"model": "suave", "policy": "observe"})
    thrusters = [f"ok(thruster_{number})" for number in range(1, 7)]
    modes = ["active(search, fd_spiral_medium)", "active(motion, fd_all_thrusters)"]
    murky = {"value": 2.9, "limit": "at least 3.25"}
    seen = ["not ok(sees_high)", "ok(sees_medium)", *modes, *thrusters]
    service.observe(*seen, robot="diver", readings=[murky] + [None] * (len(seen) - 1))
    medium = rf"search works by fd_spiral_medium since {AT}, as sees_high is not as it should be "
    medium += r"\(2\.9, at least 3\.25\)"
    page = live(look(service, viewport=SCREENS["phone"]), "/ui/robots/diver")
    expect(page.locator("#headline .what")).to_have_text(re.compile(rf"^Healthy since {AT}; {medium}\.$"))
    service.observe("not ok(thruster_2)", "active(motion, fd_recover_thrusters)", robot="diver")
    broken = (
        rf"^thruster_2 is not as it should be since {AT}, because of c_thruster_2; the robot does without; "
    )
    rest = rf"; motion works by fd_recover_thrusters since {AT}, as c_thruster_2 is blamed\.$"
    expect(page.locator("#headline .what")).to_have_text(re.compile(broken + medium + rest))
    on_screen(page, SCREENS["phone"]["height"])
    keep(page, "degraded")


@pytest.mark.parametrize("robot", ["asks", "runs", "escalated", "twofold"])
def test_repair_and_event_and_mail_say_the_same(six: Service, robot: str) -> None:
    """Of a robot that needs no repair there is neither."""
    case = SITUATIONS[robot]
    whole = re.compile(f"^({case.what}) {case.then}$")
    repair = six.api("GET", f"/robots/{robot}/repairs").json()["items"][0]
    assert whole.match(repair["headline"])

    def told() -> list[Event]:
        found = six.run(six.runtime.store.read(lambda view: events.after(view, 0, robot=robot, limit=1000)))
        return [event for event in found if event.kind is Kind.REPAIR and event.data.get("state")]

    newest = told()[-1]
    assert newest.data["id"] == repair["id"]
    assert whole.match(newest.data["headline"])
    notice = notice_of(newest)
    assert (notice is not None) == (robot in {"asks", "twofold"})  # else nobody is asked for anything
    if notice is not None:
        text = message(1, notice.data, None)["text"]
        assert re.search(case.then, text)
        assert re.search(case.what, f"{notice.title}.\n{text}")


def test_the_header_of_a_phone_is_one_line(six: Service, look: Look) -> None:
    page = live(look(six, viewport=SCREENS["phone"]), "/ui/robots/asks")
    assert page.locator("header.top").evaluate("(it) => it.offsetHeight") <= 52
    last = page.get_by_role("link", name="Notifications")
    last.focus()
    assert last.evaluate("(it) => it.getBoundingClientRect().right") <= 390
    expect(page.locator("#live")).to_be_in_viewport()
