"""A moment of a fault in a real browser: it comes by itself, with its plots."""

from __future__ import annotations

import math
import time

from playwright.sync_api import expect
from tests.api.conftest import Service
from tests.api.test_moments import moment, put_piece
from tests.browser import keep
from tests.web.conftest import Look
from tests.web.test_fleet import live, serious


def test_a_moment_comes_onto_the_robots_page_and_leads_to_all_of_it(service: Service, look: Look) -> None:
    service.with_robot("struck", observed=["ok(scan)"])
    page = live(look(service), "/ui/robots/struck")
    part = page.get_by_role("region", name="Moments")
    expect(part).to_have_count(0)
    frame = moment()["frame"]
    frame["series"] = [
        {"source": "scan", "kind": "rate", "at_s": list(range(-29, 10)), "values": [10.0] * 29 + [0.0] * 10},
        {
            "source": "odom:twist.twist.linear.x",
            "kind": "value",
            "at_s": [tick / 4 for tick in range(-116, 40)],
            "values": [0.4 * math.sin(tick / 20) for tick in range(-116, 40)],
        },
    ]
    body = moment("k1", at_ns=time.time_ns(), frame=frame)
    one = service.api("POST", "/robots/struck/moments", json=body).json()["id"]
    expect(part.locator("svg.moment-plot")).to_have_count(2)
    expect(part).to_contain_text("cannot open <b>/dev/lidar</b>")
    put_piece(service, "struck", one, 0, 3, b"abc")
    expect(part.get_by_role("link", name="Recording")).to_have_attribute(
        "href", f"/api/v1/moments/{one}.mcap"
    )
    assert serious(page) == []
    keep(page, "moments")
    part.get_by_role("link", name="All of it").click()
    expect(page.get_by_role("heading", name="The moment it turned bad: struck")).to_be_visible()
    expect(page.get_by_role("row").filter(has_text="hokuyo_node")).to_contain_text("exit code 1")
    assert serious(page) == []
    keep(page, "moment")
