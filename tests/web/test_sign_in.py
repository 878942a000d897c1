"""Who sees what: signing in and out in a real browser, and what each role is offered."""

from __future__ import annotations

from collections.abc import Iterator

import pytest
from playwright.sync_api import expect
from tests.api.conftest import Service, running
from tests.browser import PATIENCE_MS
from tests.web.conftest import Look

from robomend.settings import Settings

expect.set_options(timeout=PATIENCE_MS)


@pytest.fixture(scope="module")
def keyed(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Service]:
    """A service that wants keys, with a robot."""
    settings = Settings(port=0, data=tmp_path_factory.mktemp("keyed"), sign_ins_per_minute=1e6)
    with running(settings) as service:
        service.with_robot("r1")
        service.key("admin")
        yield service


def test_a_key_opens_the_page_that_was_asked_for_until_signing_out(keyed: Service, look: Look) -> None:
    page = look(keyed).page("/?q=r1")
    expect(page.get_by_role("heading", name="Sign in")).to_be_visible()
    page.get_by_label("Your key").fill("rm_" + "x" * 43)
    page.get_by_role("button", name="Sign in").click()
    expect(page.get_by_role("alert")).to_have_text("this key is unknown or revoked")
    page.get_by_label("Your key").fill(keyed.key("operator"))
    page.get_by_role("button", name="Sign in").click()
    expect(page.get_by_role("link", name="r1")).to_be_visible()
    assert page.url.endswith("/?q=r1")
    page.wait_for_selector('#live[data-state="live"]')
    page.get_by_role("button", name="Sign out").click()
    page.goto(keyed.url)
    expect(page.get_by_role("heading", name="Sign in")).to_be_visible()


@pytest.mark.parametrize(("role", "stops"), [("viewer", 0), ("operator", 1), ("admin", 1)])
def test_a_role_is_offered_what_it_may_do(keyed: Service, look: Look, role: str, stops: int) -> None:
    page = look(keyed).page("/ui/sign-in")
    page.get_by_label("Your key").fill(keyed.key(role))
    page.get_by_role("button", name="Sign in").click()
    expect(page.get_by_role("link", name="r1")).to_be_visible()
    assert page.get_by_role("button", name="Stop all repairs").count() == stops


def test_a_page_says_so_when_its_key_is_gone(keyed: Service, look: Look) -> None:
    visitor = look(keyed)
    page = visitor.page("/ui/sign-in")
    page.get_by_label("Your key").fill(keyed.key("viewer"))
    page.get_by_role("button", name="Sign in").click()
    page.wait_for_selector('#live[data-state="live"]')
    visitor.context.clear_cookies()
    page.get_by_role("searchbox").fill("r")
    expect(page.locator('#live[data-state="lost"]')).to_contain_text("signed out")
