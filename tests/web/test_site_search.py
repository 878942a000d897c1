"""The search of the documentation's site, opened as a file, as somebody on a robot without a network does."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
from playwright.sync_api import Browser, expect
from tests.browser import PATIENCE_MS
from tests.test_site import site

__all__ = ["site"]  # a fixture


@pytest.mark.parametrize(
    ("asked", "page"),
    [
        ("wrong node", "troubleshooting"),
        ("it blames the wrong node", "troubleshooting"),
        ("lidar no power", "troubleshooting"),
        ("approve", "page"),
        ("approve a repair", "page"),
        ("ros 1 topics", "ros"),
        ("topic rate", "observers"),
        ("compare with RC2", "compare"),
        ("slack notifications", "notifications"),
        ("run behind nginx", "deploy/index"),
        ("what does settle mean", "glossary"),
        ("api key", "security"),
        ("exit code", "commands"),
        ("install", "deploy/index"),
        ("upgrade", "deploy/index"),
        ("python client", "python"),
        ("backup", "storage"),
        ("benchmarks", "benchmarks"),
    ],
)
def test_the_first_hit_from_a_file_is_the_page_that_answers(
    asked: str, page: str, site: Path, browser: Browser
) -> None:
    with browser.new_context() as context:
        context.set_default_timeout(PATIENCE_MS)
        opened = context.new_page()
        opened.goto((site / "index.html").as_uri())
        box = opened.locator("input.md-search__input")
        box.click()
        box.press_sequentially(asked)
        first = opened.locator("a.md-search-result__link").first
        expect(first).to_have_attribute("href", re.compile(rf"/{page}\.html"), timeout=PATIENCE_MS)
