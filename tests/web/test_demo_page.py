"""The paper's power-up scenario, seen on the page: real processes, an emulated board, a real browser."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path

import pytest
from playwright.sync_api import Browser, expect
from tests.browser import Watched, keep
from tests.forked import popen
from tests.robomend_demo.playing import playing
from tests.web.test_fleet import LIVE

NO_DESKTOP = {"DISPLAY": "", "WAYLAND_DISPLAY": ""}


@pytest.fixture
def visitor(browser: Browser) -> Iterator[Watched]:
    context = browser.new_context(viewport={"width": 1280, "height": 900})
    visitor = Watched(context, "")
    yield visitor
    visitor.check()
    context.close()


def test_the_power_up_scenario_is_seen_from_the_diagnosis_to_the_verified_repair(
    visitor: Watched, tmp_path: Path
) -> None:
    options = ("--scenario", "power-up", "--page", "--format", "json")
    with playing(tmp_path / "demo", *options, environment=NO_DESKTOP, start=popen) as demo:
        demo.until_said("the page: ")
        address = re.findall(r"the page: (\S+)", demo.said())[0]
        visitor.url = address.partition("/ui/")[0]
        page = visitor.page("/ui/robots/tedusar")
        page.wait_for_selector(LIVE)
        expect(page.locator(".record")).to_contain_text("repaired, and seen to work")
        expect(page.locator('[data-part="state"] .badge')).to_have_text("healthy")
        record = page.locator(".record").inner_text()
        for step in ("Power up jaguar", "Power up hokuyo", "Start hector_mapping"):
            assert step in record
        drawn = page.locator(".timeline .wide rect.action")
        expect(drawn).to_have_count(12)
        assert page.locator("svg.graph .good").count() >= 14
        board = page.locator('[data-part="board"]')
        expect(board.locator(".badge").first).to_have_text("connected")
        row = board.locator("tr", has_text="jaguar")
        expect(row).to_contain_text(re.compile(r"on\s+\d+\.\d\d A\s*\d+\.\d V"))

        keep(page, "robot-demo")

        # What the page switches, the board does; the service finds out and brings it back.
        row.get_by_text("Switch off …").click()
        row.get_by_role("button", name="Switch channel 7 off").click()
        # It is repaired in a second or two, so the page may never show the diagnosis: the record keeps it.
        expect(page.locator(".record")).to_contain_text("against jaguar:")
        expect(page.locator(".record")).to_contain_text("repaired, and seen to work")
        page.locator(".record summary").first.click()
        expect(page.locator(".record details").first).to_contain_text("Seen: jaguar has no power")
        expect(page.locator(".record details").first).to_contain_text("Conflict: jaguar should be on because")
        expect(page.locator(".record")).to_contain_text(re.compile(r"Seen after it: .*\bjaguar has power"))
        expect(page.locator(".record")).to_contain_text("In the end: it helped: every effect was seen.")
        expect(page.locator('[data-part="state"] .badge')).to_have_text("healthy")
        demo.process.terminate()
        expect(page.locator('#live[data-state="lost"]')).to_be_visible()
