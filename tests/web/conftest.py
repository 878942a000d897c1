"""Pages of a running service in a real browser."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import ExitStack
from typing import Any

import pytest
from playwright.sync_api import Browser, Page
from tests.api.conftest import Service, running
from tests.browser import Watched, browser, chromium

from robomend.settings import Settings

__all__ = ["browser", "chromium"]  # fixtures


@pytest.fixture(scope="module")
def service(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Service]:
    """A service that the tests of a module share, with real repairs; each uses names of its own."""
    with running(Settings(port=0, data=tmp_path_factory.mktemp("data")), repairs=True) as shared:
        yield shared


@pytest.fixture(scope="module")
def keyed(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Service]:
    """A service that wants keys, with a robot."""
    settings = Settings(port=0, data=tmp_path_factory.mktemp("keyed"), sign_ins_per_minute=1e6)
    with running(settings) as service:
        service.with_robot("r1")
        service.key("admin")
        yield service


Look = Callable[..., Watched]


def signed_in(visitor: Watched, service: Service, role: str, path: str = "/") -> Page:
    """Sign in on the way to a page, with a new key."""
    page = visitor.page(path)
    page.get_by_label("Your key").fill(service.key(role))
    page.get_by_role("button", name="Sign in").click()
    page.wait_for_selector('#live[data-state="live"]')
    return page


@pytest.fixture
def look(browser: Browser) -> Iterator[Look]:
    """Look at a service as a new visitor; at the end nothing may have gone wrong in the browser."""
    with ExitStack() as stack:
        visitors = []

        def begin(service: Service, *, url: str | None = None, **options: Any) -> Watched:
            context = stack.enter_context(browser.new_context(**options))
            visitors.append(Watched(context, url or service.url))
            return visitors[-1]

        yield begin
        for visitor in visitors:
            visitor.check()
