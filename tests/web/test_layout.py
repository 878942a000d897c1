"""Where things stand: what is said is readable on a narrow screen, with odd names, and without scripts."""

from __future__ import annotations

import re
from collections.abc import Iterator
from typing import Any

import pytest
from playwright.sync_api import FloatRect, Locator, expect
from tests.api.conftest import TEDUSAR, Service, running
from tests.robomend_board.processes import running as board_running
from tests.waiting import until
from tests.web.conftest import Look
from tests.web.test_fleet import live
from tests.web.test_robot import HEBREW, ODD

from robomend.settings import Settings

PHONE: dict[str, Any] = {"viewport": {"width": 390, "height": 844}}


@pytest.fixture(scope="module")
def service(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Service]:
    with running(Settings(port=0, data=tmp_path_factory.mktemp("data")), repairs=True) as found:
        found.with_robot("ill")
        found.observe("not on(jaguar)", robot="ill")
        found.api("PUT", "/models/odd", json={"source": ODD})
        found.api("PUT", "/robots/odd", json={"model": "odd", "policy": "observe"})
        found.observe(f'not on("{HEBREW}")', 'not running("right & left")', robot="odd")
        until(lambda: found.diagnosis("odd").get("result"), "odd is diagnosed")

        def open_repairs() -> list[dict[str, Any]]:
            return list(found.api("GET", "/robots/ill/repairs").json()["items"])

        until(open_repairs, "a repair begins")
        reason = "nobody is there " * 40
        decision = {"decision": "cancel", "reason": reason}
        assert found.api("POST", f"/repairs/{open_repairs()[0]['id']}", json=decision).is_success
        yield found


def box(of: Locator) -> FloatRect:
    found: FloatRect = of.evaluate("(it) => it.getBoundingClientRect().toJSON()")  # parts are put anew
    return found


def test_an_answer_is_as_wide_as_a_phone_lets_it_be(service: Service, look: Look) -> None:
    page = live(look(service, **PHONE), "/ui/robots/ill")
    page.get_by_label("Seen by you, just now").fill("not ok(nothing_that_this_robot_has)")
    page.get_by_role("button", name="Report").click()
    expect(page.locator("#said")).to_be_visible()
    said = box(page.locator("#said"))
    assert said["width"] > 300
    assert abs(said["x"] + said["width"] / 2 - 195) < 2


INSIDE = """
(box) => [...box.querySelectorAll("tbody :is(th, td)")].every(
  (cell) => cell.getBoundingClientRect().right <= box.getBoundingClientRect().right + 0.5)
"""


def test_a_channel_of_the_power_board_is_switched_without_scrolling_sideways(
    service: Service, look: Look
) -> None:
    with board_running("--on", "7") as board:
        service.with_robot("wired", board={"host": "127.0.0.1", "port": board.port})
        page = live(look(service, **PHONE), "/ui/robots/wired")
        row = page.locator('[data-part="board"] tr', has_text="laser_alignment")
        inside = page.locator('[data-scroll="board"]')
        expect(row).to_contain_text("off")
        assert inside.evaluate(INSIDE)
        row.get_by_text("Switch on …").click()
        expect(row.get_by_role("button", name="Switch channel 1 on")).to_be_visible()
        assert inside.evaluate("(box) => box.scrollWidth <= box.clientWidth")
        assert page.evaluate("document.documentElement.scrollWidth") <= 390
        # Who clicks twice has switched it once: what would undo it is not opened at the same place.
        row.get_by_role("button", name="Switch channel 1 on").click()
        expect(row.get_by_text("Switch off …")).to_be_visible()
        expect(row.get_by_role("button", name="Switch channel 1 off")).to_be_hidden()


def test_a_long_reason_takes_a_few_lines_of_the_list(service: Service, look: Look) -> None:
    page = live(look(service, **PHONE))
    waits = page.locator("td.brief > span").filter(has_text="nobody is there")
    assert "nobody is there nobody" in waits.inner_text()
    assert box(waits)["height"] < 90
    page.goto(f"{service.url}/ui/robots/ill")
    assert "nobody is there " * 39 in page.locator('[data-part="repair"]').inner_text(), "all of it is there"


def test_the_number_of_a_line_is_not_broken(service: Service, look: Look) -> None:
    page = live(look(service, **PHONE), "/ui/models/tedusar")
    page.get_by_label("Text").fill(TEDUSAR.replace("publishes:", "publsihes:"))
    page.get_by_role("button", name="Save").click()
    number = page.locator(".excerpt .fault th")
    assert len(number.inner_text()) == 2
    lines = number.evaluate("""(cell) => {
      const range = document.createRange();
      range.selectNodeContents(cell);
      return range.getClientRects().length;
    }""")
    assert lines == 1


def test_sentences_with_names_from_right_to_left_stay_in_order(service: Service, look: Look) -> None:
    page = live(look(service), "/ui/robots/odd")
    said = page.locator(".diagnoses .quiet .name").first
    begins = said.evaluate(
        """(element, name) => {
          const walk = document.createTreeWalker(element, NodeFilter.SHOW_TEXT), left = [];
          for (let text = walk.nextNode(); text; text = walk.nextNode()) {
            const range = document.createRange();
            range.selectNodeContents(text);
            left.push(range.getBoundingClientRect().left);
          }
          return left;
        }""",
        HEBREW,
    )
    assert len(begins) > 3
    assert begins == sorted(begins)


def test_without_scripts_times_are_whole(service: Service, look: Look) -> None:
    page = look(service, java_script_enabled=False).page("/")
    cell = page.locator(".fleet td", has=page.locator("time")).first
    assert re.search(r"since \d\d:\d\d:\d\d\.", cell.inner_text())
    assert (cell.locator("time").get_attribute("title") or "").endswith(" UTC")
    expect(page.locator("footer")).to_contain_text("All times are UTC")
    assert (
        box(cell.locator("time"))["x"] + box(cell.locator("time"))["width"]
        <= box(cell)["x"] + box(cell)["width"]
    )
