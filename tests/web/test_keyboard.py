"""The page without a mouse: everything that an operator does, from signing in on, by Tab, Enter and Escape.

Wherever the focus is, it shows by an outline, and it goes forward through the page as one reads.
"""

from __future__ import annotations

from collections.abc import Iterator
from itertools import pairwise

import pytest
from playwright.sync_api import Page, expect
from tests.api.conftest import Service, running
from tests.web.conftest import Look, signed_in
from tests.web.test_fleet import LIVE

from robomend.settings import Settings

STOPS = 120
"""Presses of Tab until something must have been reached."""

FOCUS = """() => {
  const at = document.activeElement, style = getComputedStyle(at);
  const label = at.labels?.[0]?.innerText ?? '';
  const box = at.getBoundingClientRect();
  return {
    text: (at.getAttribute('aria-label') || label || at.innerText || at.value || '').trim(),
    tag: at.tagName.toLowerCase(),
    shown: style.outlineStyle !== 'none' && parseFloat(style.outlineWidth) >= 2,
    inView: box.bottom > 0 && box.top < innerHeight,
    y: box.top + scrollY,
  };
}"""


@pytest.fixture(scope="module")
def keyed(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Service]:
    """A service that wants keys as soon as there is one, with a robot that waits for approval."""
    settings = Settings(port=0, data=tmp_path_factory.mktemp("keyed"), sign_ins_per_minute=1e6)
    with running(settings, repairs=True) as service:
        service.with_robot("other")
        service.with_robot("walker")
        service.observe("not ok(map)", "on(hokuyo)", robot="walker")
        yield service


def reach(page: Page, text: str, tag: str = "") -> None:
    """Press Tab until the focus is on what has this name."""
    for _ in range(STOPS):
        page.keyboard.press("Tab")
        at = page.evaluate(FOCUS)
        if at["tag"] == "body":
            continue  # from the end of the page to its beginning
        if at["text"].startswith(text) and tag in ("", at["tag"]):
            return
    raise AssertionError(f"{text} was not reached: {page.inner_text('main')}")


def test_an_operator_needs_no_mouse(keyed: Service, look: Look) -> None:
    key, admin = keyed.key("operator"), {"Authorization": f"Bearer {keyed.key('admin')}"}
    page = look(keyed, viewport={"width": 1280, "height": 800}).page("/")

    # signing in
    reach(page, "Your key")
    page.keyboard.type(key)
    page.keyboard.press("Enter")
    page.wait_for_selector(LIVE)

    # finding a robot
    page.keyboard.press("/")
    page.keyboard.type("walk")
    expect(page.locator("tbody tr")).to_have_count(1)
    reach(page, "walker", "a")
    page.keyboard.press("Enter")
    page.wait_for_url("**/ui/robots/walker")
    page.wait_for_selector(LIVE)
    expect(page.locator('[data-part="repair"] .badge').first).to_have_text("awaiting approval")

    # opening and closing reasons
    reach(page, "hokuyo", "summary")
    page.keyboard.press("Enter")
    expect(page.locator("#why-0")).to_have_attribute("open", "")
    page.keyboard.press("Escape")
    expect(page.locator("#why-0[open]")).to_have_count(0)
    assert page.evaluate("document.activeElement.parentElement.id") == "why-0"

    # answering a probe
    reach(page, "Yes: is scan as it should be?", "button")
    page.keyboard.press("Enter")
    expect(page.locator(".diagnoses")).to_contain_text("hector_mapping explains map not ok")
    expect(page.locator(".diagnoses li")).to_have_count(1)

    # approving what is planned now
    expect(page.locator('[data-part="repair"]')).to_contain_text("Against hector_mapping")
    expect(page.locator("#approve")).to_be_visible()
    reach(page, "Approve", "button")
    page.keyboard.press("Enter")
    expect(page.locator("#approve")).to_have_count(0)
    audit = keyed.api("GET", "/audit", params={"robot": "walker"}, headers=admin).json()["items"]
    assert "repair.approve" in {one["action"] for one in audit}

    # the stop, and its end
    reach(page, "Stop all repairs", "button")
    page.keyboard.press("Enter")
    expect(page.locator(".stopped")).to_be_visible()
    reach(page, "Lift the stop", "button")
    page.keyboard.press("Enter")
    expect(page.locator(".stopped")).to_have_count(0)

    # a model, refused at its line and then saved
    reach(page, "Models", "a")
    page.keyboard.press("Enter")
    page.wait_for_url("**/ui/models")
    reach(page, "tedusar", "a")
    page.keyboard.press("Enter")
    page.wait_for_url("**/ui/models/tedusar")
    reach(page, "Text", "textarea")
    page.keyboard.press("Control+End")
    page.keyboard.type("nodes_: {}\n")
    reach(page, "Save", "button")
    page.keyboard.press("Enter")
    expect(page.locator("#problem, .notice.bad").first).to_contain_text("nodes_")
    reach(page, "Text", "textarea")
    page.keyboard.press("Control+End")
    page.keyboard.press("Shift+ArrowUp")
    page.keyboard.press("Delete")
    page.keyboard.type("# by hand\n")
    reach(page, "Save", "button")
    page.keyboard.press("Enter")
    page.wait_for_url("**/ui/models/tedusar")
    assert keyed.api("GET", "/models/tedusar", headers=admin).json()["source"].endswith("# by hand\n")


def test_the_focus_goes_through_the_page_as_one_reads(keyed: Service, look: Look) -> None:
    page = signed_in(
        look(keyed, viewport={"width": 1280, "height": 800}), keyed, "operator", "/ui/robots/other"
    )
    places = []
    for _ in range(STOPS):
        page.keyboard.press("Tab")
        at = page.evaluate(FOCUS)
        if at["tag"] == "body":
            break
        assert at["shown"], f"the focus on {at} does not show"
        assert at["inView"], f"{at} is not in view"
        places.append((at["y"], at["text"]))
    content = [place for place in places if place[1] != "Skip to the content"]
    # Things of one line differ by some pixels, and columns stand beside each other.
    late = [(a, b) for a, b in pairwise(content) if b[0] < a[0] - 300]
    assert places[0][1] == "Skip to the content"
    assert len(content) > 20
    assert late == []


def test_whoever_is_about_to_say_no_does_not_say_yes_because_the_page_changed(
    keyed: Service, look: Look
) -> None:
    admin = {"Authorization": f"Bearer {keyed.key('admin')}"}

    def observe(*sentences: str) -> None:
        body = {"observations": list(sentences)}
        keyed.api("POST", "/robots/asked/observations", json=body, headers=admin).raise_for_status()

    asked = {"model": "tedusar", "policy": "observe"}
    keyed.api("PUT", "/robots/asked", json=asked, headers=admin).raise_for_status()
    observe("not ok(map)")
    page = signed_in(look(keyed), keyed, "operator", "/ui/robots/asked")
    button = page.get_by_role("button", name="No: is scan as it should be?")
    button.focus()
    old = button.element_handle()
    observe("not ok(odom)")
    page.wait_for_function("button => !button.isConnected", arg=old)
    assert (
        page.evaluate("document.activeElement.getAttribute('aria-label')") == "No: is scan as it should be?"
    )


def test_what_escape_closes_may_be_within_what_stays_open(keyed: Service, look: Look) -> None:
    page = signed_in(look(keyed), keyed, "operator", "/ui/robots/walker")
    page.get_by_label("Seen by you, just now").fill("not ok(sca)")
    page.keyboard.press("Enter")
    expect(page.locator("#said")).to_contain_text("scan")
    page.keyboard.press("Escape")
    expect(page.locator("#said")).to_be_hidden()
    assert page.get_by_label("Seen by you, just now").input_value() == "not ok(sca)"
