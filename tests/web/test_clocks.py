"""Clocks that differ: the browser's, one that is set while a page is open, and a robot's."""

from __future__ import annotations

import re
import time

import pytest
from playwright.sync_api import Page, expect
from tests.api.conftest import Service
from tests.waiting import until
from tests.web.cable import cable
from tests.web.conftest import Look
from tests.web.test_fleet import LIVE

SINCE_IT_WAS_HEARD = re.compile(r"\b(3[5-9]|[4-9]\d|\d{3,}) s ago or")
"""Two pings and 5 s were waited for before it was known that nothing is heard."""

HOUR_S = 3600
JUST_NOW = re.compile(r"^(\d\d? s|[2-9] min) ago$")
"""Within far less than the hours that clocks differ by here."""


def opened(page: Page, url: str, robot: str) -> Page:
    page.goto(f"{url}/ui/robots/{robot}")
    page.wait_for_selector(LIVE)
    return page


def shown(page: Page, part: str, when: time.struct_time | None = None) -> None:
    """The first time of a part is by the service's clock, and pointed at it says how long ago that was."""
    moment = page.locator(f'[data-part="{part}"] time').first
    if when is not None:
        expect(moment).to_have_text(time.strftime("%H:%M:%S", when))
    moment.hover()
    ago, _, clock = (moment.get_attribute("title") or "").partition(", ")
    assert JUST_NOW.match(ago), ago
    assert clock.endswith(f"{moment.inner_text()} UTC")


@pytest.mark.parametrize("off_s", [-3 * HOUR_S, 3 * HOUR_S])
def test_times_are_right_whatever_the_browsers_clock_and_place(
    service: Service, look: Look, off_s: int
) -> None:
    robot = f"off{off_s}".replace("-", "m")
    service.with_robot(robot, policy="observe")
    service.observe("not ok(map)", robot=robot)
    service.diagnosis(robot, wait_s=30, after=0)
    page = look(service, timezone_id="Asia/Tokyo").context.new_page()
    page.clock.install(time=time.time() + off_s)
    opened(page, service.url, robot)
    shown(page, "obs")
    shown(page, "diagnosis", time.gmtime(service.diagnosis(robot)["time_ns"] // 10**9))


@pytest.mark.parametrize("off_s", [-HOUR_S, HOUR_S])
def test_a_clock_that_is_set_while_a_page_is_open_stops_nothing(
    service: Service, look: Look, off_s: int
) -> None:
    robot = f"set{off_s}".replace("-", "m")
    service.with_robot(robot, policy="observe")
    with cable(service.url) as through:
        page = look(service, url=through.url).context.new_page()
        page.clock.install()
        opened(page, through.url, robot)
        service.observe("not ok(map)", robot=robot)
        expect(page.locator(".diagnoses")).to_contain_text("explains map not ok")
        page.clock.set_system_time(time.time() + off_s)
        service.observe("ok(scan)", robot=robot)
        expect(page.locator('[data-part="obs"]')).to_contain_text("ok(scan)")
        page.wait_for_selector(LIVE)
        shown(page, "obs")
        through.mute()
        page.clock.run_for(60_000)
        expect(page.locator('#live[data-state="lost"]')).to_contain_text(SINCE_IT_WAS_HEARD)


@pytest.mark.parametrize("off_s", [40, -HOUR_S])
def test_what_a_robot_said_is_as_old_as_it_is_by_the_services_clock(
    service: Service, look: Look, off_s: int
) -> None:
    robot = f"robot{off_s}".replace("-", "m")
    service.with_robot(robot, policy="observe")
    began_ms = time.time() * 1000

    def moments() -> list[float]:
        """Report once more, and return when the page says that it was seen and said."""
        stamp = time.time_ns() + off_s * 10**9
        more = {"source": "agent", "time": stamp, "since": [stamp]}
        assert service.observe("ok(scan)", robot=robot, **more).is_success
        page = service.http.get(f"/ui/robots/{robot}", headers={"Robomend-Parts": "obs"}).text
        return [float(moment) for moment in re.findall(r'data-ms="(\d+)"', page)[:2]]

    def believed() -> bool:
        """As many reports as it takes: a clock is believed to be behind once four needed the same time."""
        return all(began_ms - 1 <= moment <= time.time() * 1000 + 1 for moment in moments())

    until(believed, "what was said is as old as it is", 60)
    page = opened(look(service).context.new_page(), service.url, robot)
    shown(page, "obs")
