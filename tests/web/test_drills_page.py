"""The drills of a robot in a real browser."""

from __future__ import annotations

from playwright.sync_api import expect
from tests.api.conftest import Service
from tests.browser import PATIENCE_MS, keep
from tests.web.conftest import Look
from tests.web.test_fleet import live, serious

expect.set_options(timeout=PATIENCE_MS)


def test_a_robots_drills_are_listed_with_their_state(service: Service, look: Look) -> None:
    service.with_robot("drilled", observed=["running(hokuyo_node)", "ok(scan)"])
    page = live(look(service), "/ui/robots/drilled")
    page.get_by_role("link", name="Drills").click()
    expect(page.get_by_text("No drill was held on this robot.")).to_be_visible()
    service.observe("running(hokuyo_node)", "ok(scan)", robot="drilled")
    service.diagnosis("drilled", wait_s=30, after=0)
    body = {"fault": "node-killed", "component": "hokuyo_node", "reason": "<b>x</b>"}
    answer = service.api("POST", "/robots/drilled/drills", json=body)
    assert answer.status_code == 202, answer.text
    row = page.get_by_role("row").filter(has_text="node-killed")
    expect(row).to_contain_text("hokuyo_node")
    expect(row).to_contain_text("local")
    assert serious(page) == []
    keep(page, "drills")
