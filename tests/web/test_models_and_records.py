"""Models, what-if, repairs, audit and keys in a real browser."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
from playwright.sync_api import expect
from tests.api.conftest import TEDUSAR, Service
from tests.browser import keep
from tests.waiting import until
from tests.web.conftest import Look
from tests.web.test_fleet import live, serious


@pytest.fixture(scope="module")
def kept(service: Service) -> Service:
    """A service with a model, a robot, and a repair that was cancelled."""
    service.with_robot("r1")
    service.observe("not on(jaguar)")

    def waits() -> list[str]:
        found = service.api("GET", "/robots/r1/repairs").json()["items"]
        return [one["id"] for one in found if one["state"] == "awaiting-approval"]

    until(waits, "a plan waits for a yes")
    decision = {"decision": "cancel", "reason": "<b>not today</b>"}
    assert service.api("POST", f"/repairs/{waits()[0]}", json=decision).is_success
    return service


def test_a_model_is_mended_and_refused_with_its_line(kept: Service, look: Look) -> None:
    page = live(look(kept), "/ui/models")
    page.get_by_text("Write a new model").click()
    page.get_by_label("Name").fill("mended")
    page.get_by_role("button", name="Save").click()
    expect(page.get_by_role("heading", name="Model mended")).to_be_visible()
    text = page.get_by_label("Text")
    good = text.input_value()
    text.fill(good.replace("publishes:", "publsihes:"))
    page.get_by_role("button", name="Save").click()
    expect(page.get_by_role("alert").first).to_contain_text("publishes")
    expect(page.locator(".excerpt .fault")).to_contain_text("publsihes")
    assert page.locator(".excerpt .fault th").inner_text() == "5"
    assert "publsihes" in page.get_by_label("Text").input_value(), "what was written is not lost"
    assert kept.api("GET", "/models/mended").json()["number"] == 1, "and the old one stays"
    page.get_by_label("Text").fill(good + "# mended\n")
    page.get_by_role("button", name="Save").click()
    expect(page.get_by_text("version 2 (component)")).to_be_visible()
    assert kept.api("GET", "/models/mended").json()["source"] == good + "# mended\n"


def test_two_people_do_not_overwrite_one_another(kept: Service, look: Look) -> None:
    kept.api("PUT", "/models/shared", json={"source": TEDUSAR})
    page = live(look(kept), "/ui/models/shared")
    etag = kept.api("GET", "/models/shared").headers["etag"]
    theirs = {"source": TEDUSAR + "# theirs\n"}
    kept.api("PUT", "/models/shared", json=theirs, headers={"If-Match": etag})
    page.get_by_label("Text").fill(TEDUSAR + "# mine\n")
    page.get_by_role("button", name="Save").click()
    expect(page.get_by_text("Somebody else has changed it meanwhile")).to_be_visible()
    assert "# mine" in page.get_by_label("Text").input_value()
    assert kept.api("GET", "/models/shared").json()["source"].endswith("# theirs\n")


def test_what_if_has_an_address_and_touches_no_robot(kept: Service, look: Look) -> None:
    visitor = look(kept)
    page = live(visitor, "/ui/what-if?model=tedusar")
    page.get_by_label("Observations").fill("not ok(scan)\non(hokuyo)\nrunning(hokuyo_node)")
    page.get_by_label("Taken to be healthy").fill("hokuyo")
    page.get_by_role("button", name="Ask").click()
    expect(page.locator(".diagnoses li")).to_have_count(1)
    assert "hokuyo_node explains scan not ok" in page.inner_text(".diagnoses")
    assert "Start hokuyo_node" in page.inner_text(".plan")
    assert "model=tedusar" in page.url
    keep(page, "what-if")
    again = live(visitor, page.url.removeprefix(kept.url))
    assert again.inner_text(".diagnoses") == page.inner_text(".diagnoses")
    again.get_by_label("Observations").fill("not ok(sacn)")
    again.get_by_role("button", name="Ask").click()
    expect(again.get_by_role("alert").first).to_contain_text("sacn")


def test_repairs_and_the_audit_log_tell_who_did_what_and_why(kept: Service, look: Look) -> None:
    page = live(look(kept), "/ui/repairs")
    expect(page.locator("tbody tr")).to_have_count(1)
    assert re.search(r"cancelled\s+r1", page.inner_text("tbody"))
    page.get_by_role("link", name="Audit").click()
    row = page.locator("tbody tr", has=page.get_by_text("repair.cancel", exact=True))
    expect(row).to_contain_text("<b>not today</b>")
    expect(row).to_contain_text("local")
    keep(page, "audit")
    machine = page.locator("tbody tr", has=page.get_by_role("rowheader", name="robomend"))
    # What it did to one repair, between two things that people did to it, is one line.
    assert 1 <= machine.count() <= 2
    machine = machine.last
    machine.get_by_text("steps").click()
    expect(machine).to_contain_text("repair.create")
    assert machine.locator("td.reason").inner_text().count("the only cause") <= 1, "a reason is told once"
    page.get_by_label("Who").select_option("people")
    page.get_by_role("button", name="Show").click()
    expect(page.get_by_role("rowheader", name="robomend")).to_have_count(0)
    expect(page.locator("tbody tr", has=page.get_by_text("repair.cancel", exact=True))).to_have_count(1)
    assert "observations.report" not in page.inner_text("tbody")


def test_a_repair_is_one_file_to_print_and_to_send(kept: Service, look: Look, tmp_path: Path) -> None:
    repair = kept.api("GET", "/robots/r1/repairs").json()["items"][0]
    page = live(look(kept), f"/ui/repairs/{repair['id']}")
    with page.expect_download() as downloading:
        page.get_by_role("link", name="to send").click()
    file = tmp_path / downloading.value.suggested_filename
    assert file.name == f"{repair['id']}.html"
    downloading.value.save_as(file)
    text = file.read_text()
    assert not re.search(r"(?:src|href)=|<script|@import|url\(", text), "it needs nothing else"
    page.get_by_role("link", name="Report to print").click()
    shown = page.inner_text("body")
    for said in (repair["headline"], "<b>not today</b>", "Decided by people", "local", "Power up", "Account"):
        assert said in shown
    people = page.locator("table", has=page.get_by_text("Who", exact=True))
    expect(people.locator("tbody tr")).to_have_count(1)
    expect(people.get_by_role("cell", name="cancel", exact=True)).to_have_attribute("title", "repair.cancel")
    assert page.evaluate("getComputedStyle(document.querySelector('td')).whiteSpace") == "nowrap", "its style"
    page.set_viewport_size({"width": 390, "height": 800})
    assert page.evaluate("document.documentElement.scrollWidth") <= 390
    assert serious(page) == []
    keep(page, "report")


def test_nothing_serious_stands_in_the_way_of_anybody(kept: Service, look: Look) -> None:
    visitor = look(kept, viewport={"width": 390, "height": 800}, color_scheme="dark")
    for name in ("models", "models/tedusar", "what-if", "repairs", "audit", "keys", "notifications"):
        page = live(visitor, f"/ui/{name}")
        assert (name, serious(page)) == (name, [])
        assert page.evaluate("document.documentElement.scrollWidth") <= 390, name
        page.close()  # each keeps a connection, of which a browser has six
