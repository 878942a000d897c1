"""Situations of a robot, at a desk and on a phone, light and dark: what, since when, why, what next, what a
person may press.

All of it is on the first screen of a robot's page, in the words of the list, the status and the event.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass, field
from itertools import product
from typing import Any, Literal

import pytest
from playwright.sync_api import Locator, ViewportSize, expect
from tests.api.conftest import Service
from tests.browser import keep
from tests.waiting import until
from tests.web.conftest import Look
from tests.web.test_fleet import live, row

from robomend.notifications.notices import message, notice_of
from robomend.resources import resource
from robomend.store import events
from robomend_client.events import Event, Kind

SCREENS: dict[str, ViewportSize] = {
    "desk": {"width": 1440, "height": 900},
    "phone": {"width": 390, "height": 844},
}
SCHEMES: tuple[Literal["light", "dark"], ...] = ("light", "dark")
AT = r"\d\d:\d\d:\d\d"


@dataclass(frozen=True)
class Case:
    """A situation, and how its questions are answered."""

    what: str  # with since when and why
    then: str
    press: tuple[str, ...] = ()  # buttons and links
    config: dict[str, Any] = field(default_factory=dict)
    why: str = ""  # the words of `what` or `then` that say it


SITUATIONS = {
    "healthy": Case(rf"Healthy since {AT}\.", r"Nothing is to be done\.", ("What is observed",)),
    "asks": Case(
        rf"hokuyo has no power since {AT} \(0 of 12 V\); hokuyo_node and 2 more follow\.|"
        rf"hokuyo has no power since {AT} \(0 of 12 V\); map and scan follow\.",
        r"Power up hokuyo and restart hokuyo_node\?",
        ("Approve", "Cancel the repair"),
        why=r"0 of 12 V",
    ),
    "runs": Case(
        rf"hector_mapping is not running since {AT} \(exit code 1: no map\)\.",
        r"Under way: start hector_mapping\.",
        ("Cancel the repair",),
        {"policy": "auto", "actions": {"start_node": {"executor": {"kind": "agent"}, "timeout_s": 600}}},
        why=r"exit code 1: no map",
    ),
    "gave_up": Case(
        rf"hector_mapping is not running since {AT} \(signal 11\)\.",
        rf"A person is needed: .*agent[^;]*\. The next try is at {AT}\.",
        ("Ask for a repair", "Plan without acting"),
        {"policy": "auto", "actions": {"start_node": {"executor": {"kind": "agent"}, "timeout_s": 0.2}}},
        why=r"signal 11",
    ),
    "escalated": Case(
        rf"jaguar has no power since {AT}\.",
        r"A person is needed: .*not today\.",
        ("Ask for a repair", "Plan without acting"),
        why="the repair was cancelled",
    ),
    "doubtful": Case(
        rf"map is silent since {AT} \(0 of 1 Hz\), because of one of three: "
        r"(?:hokuyo|hokuyo_node|hector_mapping)(?:, \w+)? or \w+\.",
        r"A person is needed: robomend only observes it\.",
        ("Plan without acting",),
        {"policy": "observe"},
        why="because of one of three",
    ),
    "partly": Case(
        rf"imu_data, odom and 2 more are not observed since {AT}; no fault is known\.",
        r"Is onboard running\? It no longer reports\.",
        ("What is observed",),
        why="It no longer reports",
    ),
    "unheard": Case(
        rf"Nothing is heard of it since {AT}\.",
        r"A person is needed: are its agent and its network running\?",
        ("What is observed",),
        {"policy": "observe"},
        why="are its agent and its network running",
    ),
    "twofold": Case(
        rf"Two faults: hokuyo has no power since {AT}; hector_mapping is not running since {AT}\.",
        r"Power up hokuyo, restart hokuyo_node and start hector_mapping\?",
        ("Approve", "Cancel the repair"),
        why="Two faults",
    ),
    "degraded": Case(
        rf"thruster_2 is not as it should be since {AT}, because of c_thruster_2; the robot works without "
        rf"it; search works by fd_spiral_medium since {AT}, as sees_high is not as it should be "
        rf"\(2\.9, at least 3\.25\); motion works by fd_recover_thrusters since {AT}, as c_thruster_2 is "
        r"blamed\.",
        r"A person is needed: robomend only observes it\.",
        ("Plan without acting",),
        why="because of c_thruster_2",
    ),
}


def repairs(service: Service, robot: str, state: str = "") -> list[str]:
    found = service.api("GET", f"/robots/{robot}/repairs").json()["items"]
    return [one["id"] for one in found if not state or one["state"] == state]


@pytest.fixture(scope="module")
def six(service: Service) -> Iterator[Service]:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("robomend.repairs.reasons.AGAIN_S", 3600.0)  # what is given up stays so meanwhile
        yield with_situations(service)


def with_situations(service: Service) -> Service:
    for robot, case in SITUATIONS.items():
        if robot != "degraded":
            service.with_robot(robot, **case.config)
    dive(service, "degraded")
    service.observe("not ok(thruster_2)", "active(motion, fd_recover_thrusters)", robot="degraded")
    service.observe("ok(scan)", "on(hokuyo)", robot="healthy")
    volts = {"value": 0, "unit": "of 12 V"}
    service.observe(
        "not on(hokuyo)", "not ok(scan)", "not ok(map)", robot="asks", readings=[volts, None, None]
    )
    code = {"value": "exit code 1: no map", "symptom": "ended"}
    service.observe("not running(hector_mapping)", robot="runs", readings=[code])
    service.observe(
        "not running(hector_mapping)", robot="gave_up", readings=[{"value": "signal 11", "symptom": "ended"}]
    )
    service.observe("not on(jaguar)", robot="escalated")
    silent = {"value": 0, "unit": "of 1 Hz", "symptom": "silent"}
    service.observe("not ok(map)", robot="doubtful", readings=[silent])
    service.observe("not on(hokuyo)", "not running(hector_mapping)", robot="twofold")
    seen = {"observations": ["ok(scan)", "on(hokuyo)"], "lifetime_s": 0.5}
    service.api("POST", "/robots/unheard/observations", json=seen)
    service.observe("ok(scan)", "on(hokuyo)", robot="partly", source="board")
    nodes = ["running(hector_mapping)", "running(hokuyo_node)", "ok(imu_data)", "ok(odom)"]
    seen = {"observations": nodes, "lifetime_s": 0.5, "source": "onboard"}
    service.api("POST", "/robots/partly/observations", json=seen)
    until(lambda: repairs(service, "escalated", "awaiting-approval"), "a plan waits", 60)
    refusal = {"decision": "cancel", "reason": "not today"}
    service.api("POST", f"/repairs/{repairs(service, 'escalated', 'awaiting-approval')[0]}", json=refusal)
    for robot in ("asks", "twofold"):
        until(lambda robot=robot: repairs(service, robot, "awaiting-approval"), "a plan waits", 60)  # type: ignore[misc]  # bound here
    until(lambda: repairs(service, "runs", "running"), "a repair runs", 60)
    until(lambda: repairs(service, "gave_up", "escalated"), "a repair is given up", 60)
    return service


def dive(service: Service, robot: str) -> None:
    """Make a robot that searches by its second best variant."""
    source = resource("examples", "suave/model.yaml").read_text(encoding="utf-8")
    if not service.api("GET", "/models/suave").is_success:
        assert service.api("PUT", "/models/suave", json={"source": source}).is_success
    assert service.api("PUT", f"/robots/{robot}", json={"model": "suave", "policy": "observe"}).is_success
    thrusters = [f"ok(thruster_{number})" for number in range(1, 7)]
    modes = ["active(search, fd_spiral_medium)", "active(motion, fd_all_thrusters)"]
    murky = {"value": 2.9, "limit": "at least 3.25"}
    seen = ["not ok(sees_high)", "ok(sees_medium)", *modes, *thrusters]
    service.observe(*seen, robot=robot, readings=[murky] + [None] * (len(seen) - 1))


SHOWN = """(it) => {
    const box = it.getBoundingClientRect();
    const at = document.elementFromPoint(box.left + box.width / 2, box.top + box.height / 2);
    return {
        inside: box.top >= 0 && box.left >= 0 && box.bottom <= innerHeight && box.right <= innerWidth,
        covered: !(at && (it.contains(at) || at.contains(it))),
        cut: it.scrollWidth > it.clientWidth + 1 || it.scrollHeight > it.clientHeight + 1,
    };
}"""


def on_screen(*shown: Locator) -> None:
    """Each is seen whole, without scrolling: nothing lies over it, and none of its words is cut off."""
    for one in shown:
        how = one.evaluate(SHOWN)
        assert how == {"inside": True, "covered": False, "cut": False}, (one, how)


@pytest.mark.parametrize("robot", SITUATIONS)
def test_five_questions_are_answered_without_scrolling(six: Service, look: Look, robot: str) -> None:
    case = SITUATIONS[robot]
    page = live(look(six), f"/ui/robots/{robot}")
    what, then = page.locator("#headline .what"), page.locator("#headline .then")
    expect(then).to_have_text(re.compile(f"^{case.then}$"))
    expect(what).to_have_text(re.compile(f"^({case.what})$"))
    assert re.search(AT, what.inner_text())
    assert re.search(case.why, f"{what.inner_text()} {then.inner_text()}")
    press = [
        page.locator("#headline :is(a, button)").filter(has_text=re.compile(f"^{name}$"))
        for name in case.press
    ]
    for (screen, size), scheme in product(SCREENS.items(), SCHEMES):
        page.set_viewport_size(size)
        page.emulate_media(color_scheme=scheme)
        assert page.evaluate("scrollY") == 0
        on_screen(page.locator("#headline"), what, then, *press)
        assert page.evaluate("document.documentElement.scrollWidth") <= size["width"]
        keep(page, f"situation-{robot}-{screen}-{scheme}")


def test_list_and_status_and_robot_say_the_same(six: Service, look: Look) -> None:
    def listed() -> dict[str, str]:
        return {one["robot"]: one["headline"] for one in six.api("GET", "/status").json()["robots"]}

    for robot, case in SITUATIONS.items():
        whole = re.compile(f"^({case.what}) {case.then}$")
        until(lambda: whole.match(six.api("GET", f"/robots/{robot}").json()["headline"]), "the robot says it")  # noqa: B023  # at once
        until(lambda: whole.match(listed()[robot]), "the list says it")  # noqa: B023  # at once
    page = live(look(six))
    for robot, case in SITUATIONS.items():
        shown = row(page, robot)
        assert re.search(f"({case.what})", shown)
        assert re.search(case.then, shown)


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


FORMAL = re.compile(r"\b(?:ok|on|running)\(|\b(?:start_node|stop_node|power_up|shutdown)\b|\bweight\b")
"""What models and plans are written in: it belongs into titles, and beside rules."""


PARTS = r'<section[^>]*data-part="(?:state|repair|diagnosis|obs)".*?</section>'
NO_TEXT = re.compile(r"<(style|svg|code|head)\b.*?</\1>|<[^>]*>", re.DOTALL)


@pytest.mark.parametrize("robot", ["asks", "runs", "gave_up", "escalated", "twofold"])
def test_no_sentence_is_in_the_letters_of_models_and_plans(six: Service, robot: str) -> None:
    repair = six.api("GET", f"/repairs/{repairs(six, robot)[0]}").json()
    waits = {one["robot"]: one["waits"] for one in six.api("GET", "/status").json()["robots"]}
    told = [repair["headline"], waits[robot], *repair["account"]]
    paths = [f"/ui/robots/{robot}", *(f"/ui/repairs/{repair['id']}{which}" for which in ("", "/report"))]
    page, *records = (six.http.get(path).raise_for_status().text for path in paths)
    told += [*records, *re.findall(PARTS, page, re.DOTALL)]
    assert len(told) == 2 + len(repair["account"]) + 2 + 4
    lines = [line for text in told for line in NO_TEXT.sub("\n", text).splitlines()]
    assert [line for line in lines if FORMAL.search(line)] == []


def test_the_header_of_a_phone_is_one_line(six: Service, look: Look) -> None:
    page = live(look(six, viewport=SCREENS["phone"]), "/ui/robots/asks")
    assert page.locator("header.top").evaluate("(it) => it.offsetHeight") <= 52
    last = page.get_by_role("link", name="Notifications")
    last.focus()
    assert last.evaluate("(it) => it.getBoundingClientRect().right") <= 390
    expect(page.locator("#live")).to_be_in_viewport()
