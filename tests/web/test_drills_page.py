"""The drills of a robot in a real browser."""

from __future__ import annotations

import re

from playwright.sync_api import expect
from tests.api.conftest import Service
from tests.browser import keep
from tests.web.conftest import Look
from tests.web.test_fleet import live, serious


def test_a_fault_is_chosen_planted_answered_and_undone_on_the_page(service: Service, look: Look) -> None:
    service.with_robot("pulled", observed=["running(hokuyo_node)", "ok(scan)"], protected=["jaguar"])
    service.observe("running(hokuyo_node)", "ok(scan)", robot="pulled")
    service.diagnosis("pulled", wait_s=30, after=0)
    page = live(look(service, viewport={"width": 1440, "height": 900}), "/ui/robots/pulled/drills")
    expect(page.get_by_text("No drill was held on this robot.")).to_be_visible()
    row = page.get_by_role("row").filter(has_text="Pull the data cable of hokuyo").first
    expect(row).to_contain_text("scan not ok")
    expect(row).to_contain_text("one of several")
    page.locator("#never summary").click()
    expect(page.locator("#never")).to_contain_text("pull the data cable of jaguar: jaguar is protected")
    keep(page, "plantable")
    assert serious(page) == []
    row.get_by_text("Plant …").click()
    row.get_by_label("Why").fill("<b>to see it</b>")
    row.get_by_role("button").click()
    held = page.locator('[data-part="drills"] tbody tr')
    expect(held).to_contain_text("Pull the data cable of hokuyo")
    expect(held).to_contain_text("local")
    expect(page.get_by_text("Nothing is planted now: a drill is under way.")).to_be_visible()
    held.get_by_role("button", name="Done").click()
    expect(held.locator("b")).to_have_text("planted")
    held.get_by_role("button", name="Cancel the drill").click()
    expect(held).to_contain_text("plug it in")
    held.get_by_role("button", name="Done").click()
    expect(held.locator("b")).not_to_have_text(re.compile("planted|undoing"))
    service.observe("running(hokuyo_node)", "ok(scan)", robot="pulled")
    expect(held.locator("b")).to_have_text("cancelled")
    expect(row).to_contain_text("not watched to its end")
    audit = service.api("GET", "/audit", params={"robot": "pulled"}).json()["items"]
    assert [one["reason"] for one in audit if one["action"] == "drill.create"] == ["<b>to see it</b>"]
    assert {"drill.cancel", "drill.done"} <= {one["action"] for one in audit}


def test_what_a_drill_may_not_do_is_answered_in_words(service: Service) -> None:
    service.with_robot("kept", policy="observe", observed=["ok(scan)"])
    head = {"Origin": service.url}
    fields = {"fault": "node-killed", "component": "hokuyo_node"}
    refused = service.http.post("/ui/robots/kept/drills", data=fields, headers=head)
    assert (refused.status_code, "nothing is ever done to it" in refused.text) == (403, True)
    fields["fault"] = "struck by lightning"
    assert service.http.post("/ui/robots/kept/drills", data=fields, headers=head).status_code == 422
    unknown = service.http.post("/ui/drills/d-none", data={"decision": "explode"}, headers=head)
    assert (unknown.status_code, "cancel, done, abandon" in unknown.text) == (422, True)
