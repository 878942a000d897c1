"""Batches in a real browser: handed in as a form, followed, read; a report of hostile logs does nothing."""

from __future__ import annotations

from pathlib import Path

from playwright.sync_api import expect
from tests.api.conftest import Service
from tests.batches.conftest import SCAN, ended, form
from tests.browser import PATIENCE_MS, browser, chromium
from tests.web.conftest import Look, look
from tests.web.test_fleet import live, serious

__all__ = ["browser", "chromium", "look"]  # fixtures

expect.set_options(timeout=PATIENCE_MS)


def test_logs_are_handed_in_and_their_report_is_read(batching: Service, look: Look, tmp_path: Path) -> None:
    page = live(look(batching), "/ui/batches")
    page.get_by_text("Hand in logs").click()
    (tmp_path / "drive.ndjson").write_text(SCAN)
    page.get_by_label("Logs", exact=True).set_input_files(tmp_path / "drive.ndjson")
    page.get_by_placeholder("optional; it goes").fill("<b>night</b>")
    page.get_by_role("button", name="Diagnose them").click()
    expect(page.get_by_role("heading", name="Batch b-")).to_be_visible()
    expect(page.get_by_text("1 of 1 log, 1 with faults")).to_be_visible(timeout=90_000)
    expect(page.get_by_text("<b>night</b>")).to_be_visible()
    assert not serious(page)
    page.get_by_role("link", name="Report").click()
    expect(page.get_by_role("heading", name="What the logs show")).to_be_visible()
    assert page.evaluate("self.origin") == "null"  # a sandbox: not the page's own origin


def test_a_batch_is_cancelled_on_the_page(batching: Service, look: Look) -> None:
    slow = "".join(f'{{"time": {at}000, "literal": "ok(scan)"}}\n' for at in range(20_000))
    batch = batching.api("POST", "/batches", **form(("a.ndjson", slow))).json()["id"]
    page = look(batching).page("/ui/batches")
    page.get_by_role("link").filter(has=page.locator("time")).first.click()
    page.get_by_role("button", name="Cancel it").click()
    expect(page.get_by_text("cancelled")).to_be_visible()
    assert ended(batching, batch)["state"] == "cancelled"


def test_logs_of_the_folder_are_named_on_the_page(batching: Service, look: Look) -> None:
    field = "Or names below"
    page = live(look(batching), "/ui/batches")
    page.get_by_text("Hand in logs").click()
    page.get_by_label(field).fill("night/a.ndjson\n../outside/secret.ndjson\n")
    page.get_by_role("button", name="Diagnose them").click()
    expect(page.get_by_text("and below it")).to_be_visible()
    page.go_back()
    page.get_by_text("Hand in logs").click()
    page.get_by_label(field).fill("night/a.ndjson\n")
    page.get_by_role("button", name="Diagnose them").click()
    expect(page.get_by_role("heading", name="Batch b-")).to_be_visible()
