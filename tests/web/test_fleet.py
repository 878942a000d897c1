"""The list of robots in a real browser: what it says, how it follows events, and the stop."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
from axe_playwright_python.sync_playwright import Axe  # type: ignore[import-untyped]  # it has no types
from playwright.sync_api import Page, expect
from tests.api.conftest import Service, running
from tests.browser import Watched, keep
from tests.web.cable import cable
from tests.web.conftest import Look

from robomend.settings import Settings

LIVE = '#live[data-state="live"]'


def row(page: Page, robot: str) -> str:
    """Return a robot's row as it reads, once it is there."""
    return page.locator("tr", has=page.get_by_role("link", name=robot, exact=True)).inner_text()


def live(visitor: Watched, path: str = "/") -> Page:
    """Open a page and wait until it follows events."""
    page = visitor.page(path)
    page.wait_for_selector(LIVE)
    return page


@pytest.fixture(scope="module")
def seen(service: Service) -> Service:
    """A service with a robot of each kind."""
    service.with_robot("broken")
    service.observe("not ok(scan)", "on(hokuyo)", robot="broken")
    for robot in ("works", "never-reported", "changes"):
        service.api("PUT", f"/robots/{robot}", json={"model": "tedusar"})
    service.api("PUT", "/robots/looked-at", json={"model": "tedusar", "policy": "observe"})
    service.observe("ok(scan)", robot="works")
    service.observe("not on(jaguar)", robot="looked-at")
    for robot in ("broken", "works", "looked-at"):
        service.diagnosis(robot, wait_s=60, after=0)
    return service


def test_every_robot_is_told_with_its_state_its_diagnosis_and_what_it_waits_for(
    seen: Service, look: Look
) -> None:
    page = live(look(seen))
    broken = page.locator("tr", has=page.get_by_role("link", name="broken", exact=True))
    expect(broken.locator("td.person")).to_contain_text("?")
    at = r"since \d\d:\d\d:\d\d"
    assert re.search(rf"scan is not as it should be {at}, because of one of two: hokuyo", row(page, "broken"))
    assert "Restart hokuyo_node?" in row(page, "broken")
    assert re.search(
        rf"jaguar has no power {at}\.\s+A person is needed: robomend only observes", row(page, "looked-at")
    )
    assert re.search(rf"Healthy {at}\.\s+Nothing is to be done\.", row(page, "works"))
    assert "Nothing has been reported yet." in row(page, "never-reported")
    # In one look: the list is put in its order anew with each change that comes in.
    rows = page.locator("tbody tr")
    persons = rows.evaluate_all("all => all.map(one => one.querySelectorAll('td.person').length)")
    assert persons == sorted(persons, reverse=True), "who waits for a person comes first"


def test_an_empty_list_says_how_to_begin_and_shows_no_empty_table(tmp_path: Path, look: Look) -> None:
    with running(Settings(port=0, data=tmp_path)) as empty:
        page = live(look(empty))
        expect(page.get_by_role("heading", name="No robots yet")).to_be_visible()
        for way in ("robomend attach", "robomend demo --page", "tutorial"):
            expect(page.locator(".first")).to_contain_text(way)
        assert page.locator("table, .counts").count() == 0
        expect(page.get_by_role("searchbox")).to_have_count(0)  # there is nothing to be found
        assert serious(page) == []
        empty.with_robot("first")
        expect(page.get_by_role("link", name="first", exact=True)).to_be_visible()
        expect(page.get_by_role("searchbox")).to_be_visible()


def test_search_and_filter_have_addresses(seen: Service, look: Look) -> None:
    visitor = look(seen)
    page = live(visitor)
    page.get_by_role("searchbox").fill("hokuyo approv")
    expect(page.locator("tbody tr")).to_have_count(1)
    assert page.url.endswith("/?q=hokuyo+approv")
    page.goto(seen.url + "/?state=healthy")
    assert page.locator("tbody th").all_inner_texts().count("works") == 1
    page.get_by_role("link", name=re.compile("unhealthy")).click()
    assert page.url.endswith("/?state=unhealthy")
    expect(page.locator("tbody tr")).to_have_count(2)


def test_a_diagnosis_shows_without_reloading(seen: Service, look: Look) -> None:
    page = live(look(seen))
    assert "unknown" in row(page, "changes")
    seen.observe("not on(hokuyo)", robot="changes")
    changed = page.locator("tr", has=page.get_by_role("link", name="changes", exact=True))
    expect(changed.locator(".badge")).to_have_text("unhealthy")
    expect(changed).to_contain_text("hokuyo")


def test_the_stop_is_set_and_lifted(seen: Service, look: Look) -> None:
    page = live(look(seen))
    page.get_by_label("Why").fill("a person is in the hall")
    page.get_by_role("button", name="Stop all repairs").click()
    expect(page.locator(".stopped")).to_contain_text("Set by local")
    assert seen.api("GET", "/stop").json()["reason"] == "a person is in the hall"
    page.get_by_role("button", name="Lift the stop").click()
    expect(page.get_by_role("button", name="Stop all repairs")).to_be_visible()
    assert not seen.api("GET", "/stop").json()["active"]


def test_without_scripts_the_list_is_there_and_the_stop_works(seen: Service, look: Look) -> None:
    page = look(seen, java_script_enabled=False).page()
    assert "unhealthy" in row(page, "broken")
    assert "Scripts are off" in page.inner_text("body")
    page.get_by_role("button", name="Stop all repairs").click()
    expect(page.locator(".stopped")).to_be_visible()
    page.get_by_role("button", name="Lift the stop").click()
    expect(page.get_by_role("button", name="Stop all repairs")).to_be_visible()


@pytest.mark.parametrize(("width", "scheme"), [(390, "light"), (1280, "dark")])
def test_nothing_serious_stands_in_the_way_of_anybody(
    seen: Service, look: Look, width: int, scheme: str
) -> None:
    page = live(look(seen, color_scheme=scheme, viewport={"width": width, "height": 800}))
    keep(page, f"robots-{width}-{scheme}")
    assert serious(page) == []
    assert page.evaluate("document.documentElement.scrollWidth") <= width, "no scrolling sideways"


def serious(page: Page) -> list[str]:
    """Return what axe-core calls serious or critical, with where it is."""
    found = Axe().run(page).response["violations"]
    return [
        f"{one['id']}: {one['nodes'][0]['html']}" for one in found if one["impact"] in {"serious", "critical"}
    ]


def test_losing_the_service_is_shown_and_its_return_too(seen: Service, look: Look) -> None:
    with cable(seen.url) as through:
        page = live(look(seen, url=through.url))
        through.cut()
        expect(page.locator('#live[data-state="lost"]')).to_contain_text("shown is how it was")
        assert page.evaluate("document.body.classList.contains('stale')")
        seen.api("PUT", "/robots/meanwhile", json={"model": "tedusar"})
        through.mend()
        page.wait_for_selector(LIVE)
        expect(page.get_by_role("link", name="meanwhile")).to_be_visible()
        assert not page.evaluate("document.body.classList.contains('stale')")


def test_a_connection_that_dies_without_a_word_is_lost_as_well(seen: Service, look: Look) -> None:
    with cable(seen.url) as through:
        visitor = look(seen, url=through.url)
        page = visitor.context.new_page()
        page.clock.install()
        page.goto(through.url)
        page.wait_for_selector(LIVE)
        through.mute()
        page.clock.run_for(60_000)
        page.wait_for_selector('#live[data-state="lost"]')
        through.mend()
        page.wait_for_selector(LIVE)


def test_many_robots_come_page_by_page(seen: Service, look: Look) -> None:
    page = live(look(seen), "/?rows=2")
    expect(page.locator("caption")).to_contain_text("page 1 of 3")
    assert page.locator("tbody tr").count() == 2
    page.get_by_role("link", name="Page 2").click()
    page.wait_for_selector(LIVE)
    assert page.locator("tbody tr").count() == 2
    page.get_by_role("link", name="Page 3").click()
    expect(page.get_by_role("link", name="Page 4")).to_have_count(0)
