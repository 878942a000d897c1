"""The search of the documentation's site, opened as a file, as somebody on a robot without a network does."""

from __future__ import annotations

import re
from pathlib import Path

from playwright.sync_api import Browser, expect
from tests.browser import PATIENCE_MS
from tests.test_site import site

__all__ = ["site"]  # a fixture


FOUND = {
    "it blames the wrong node": "troubleshooting",
    "lidar no power": "troubleshooting",
    "approve a repair": "page",
    "topic rate": "observers",
    "compare with RC2": "compare",
    "api key": "security",
    "exit code": "commands",
    "python client": "python",
    "benchmarks": "benchmarks",
}
"""What is asked, and the page that answers."""


def test_the_first_hit_from_a_file_is_the_page_that_answers(site: Path, browser: Browser) -> None:
    with browser.new_context() as context:
        context.set_default_timeout(PATIENCE_MS)
        opened = context.new_page()
        opened.goto((site / "index.html").as_uri())
        box = opened.locator("input.md-search__input")
        first = opened.locator("a.md-search-result__link").first
        for asked, page in FOUND.items():
            box.click()
            box.fill("")
            expect(first).to_have_count(0)  # nothing is left of what was asked before
            box.press_sequentially(asked)
            expect(first).to_have_attribute("href", re.compile(rf"/{page}\.html"), timeout=PATIENCE_MS)
