"""Isolability and the comparison of versions, as values and in a real browser."""

from __future__ import annotations

from typing import Any

from playwright.sync_api import expect
from tests.api.conftest import Service
from tests.browser import keep
from tests.web.conftest import Look
from tests.web.test_fleet import live, serious

from robomend.model.loading import load_text
from robomend.web.comparison import Difference, compare, isolability_change

BEFORE = """\
robomend: 1
name: cart
hardware: {base: {channel: 1}, lidar: {channel: 2}}
nodes:
  lidar_node: {drives: [lidar], publishes: {scan: []}}
  mapper: {publishes: {map: [scan]}}
"""
AFTER = """\
robomend: 1
name: cart
# one line further down
hardware: {base: {channel: 3, prior: 0.1}, camera: {}}
nodes:
  mapper: {publishes: {map: []}}
rules: ["not ab(base) -> ok(odom)"]
properties: {odom: {}}
"""


def test_what_came_and_went_is_told_by_what_the_models_mean() -> None:
    found = compare(load_text(BEFORE), load_text(AFTER))
    assert found.components == Difference(("camera",), ("lidar", "lidar_node"))
    assert ("base", "channel", "1", "3") in found.changed
    assert ("base", "prior", "–", "0.1") in found.changed
    assert ("mapper", "publishes", "map: scan", "map: –") in found.changed
    assert not any(key == "line" for _, key, _, _ in found.changed)
    assert "not ab(base) -> ok(odom)" in found.rules.came
    assert "ok(odom)" in found.observables.came
    assert "ok(scan)" in found.observables.went


def report(matrix: list[str], *detectable: bool) -> dict[str, Any]:
    names = "abc"[: len(matrix)]
    faults = [{"components": [n], "detectable": d} for n, d in zip(names, detectable, strict=True)]
    return {"faults": faults, "matrix": matrix}


def test_pairs_that_are_told_apart_better_or_worse_are_counted() -> None:
    change = isolability_change(report(["--", "+-"], False, True), report(["-+", "~-"], True, True))
    assert change is not None
    assert (change.better, change.worse) == (1, 1)
    assert change.pairs[0] == ("a", "b", "never", "always")
    assert change.detectable == Difference(("a",), ())


def test_faults_that_only_one_version_has_are_in_no_pair() -> None:
    change = isolability_change(report(["--", "--"], True, True), report(["---", "---", "+++"], *[True] * 3))
    assert change is not None
    assert change.pairs == ()
    assert isolability_change({"matrix": None}, {"matrix": None}) is None


def test_versions_are_compared_and_isolability_shown_on_pages(service: Service, look: Look) -> None:
    service.api("PUT", "/models/cart", json={"source": BEFORE})
    etag = service.api("GET", "/models/cart").headers["etag"]
    service.api("PUT", "/models/cart", json={"source": AFTER}, headers={"If-Match": etag})
    visitor = look(service)
    page = live(visitor, "/ui/models/cart")
    page.get_by_role("link", name="Compare versions").click()
    expect(page.get_by_role("heading", name="cart: version 1 and version 2")).to_be_visible()
    expect(page.get_by_role("row", name="base channel 1 3")).to_be_visible()
    expect(page.get_by_text("not ab(base) -> ok(odom)")).to_be_visible()
    assert serious(page) == []
    keep(page, "compare")
    page.get_by_label("From").select_option("version 2")
    page.get_by_role("button", name="Compare").click()
    expect(page.get_by_text("This is one version")).to_be_visible()
    again = {"source": f"{AFTER}# one more line\n"}
    etag = service.api("GET", "/models/cart").headers["etag"]
    assert service.api("PUT", "/models/cart", json=again, headers={"If-Match": etag}).is_success
    page.reload()
    page.locator('select[name="after"]').select_option("version 3")
    page.get_by_role("button", name="Compare").click()
    expect(page.get_by_text("They mean the same")).to_be_visible()
    page.get_by_role("link", name="The model").click()
    page.get_by_role("link", name="Isolability").click()
    expect(page.locator("#matrix svg")).to_be_visible()
    expect(page.locator("main .notice")).to_contain_text("can be detected")
    assert serious(page) == []
    keep(page, "isolability")
    page.get_by_label("With what is observed of robot").fill("nobody")
    page.get_by_role("button", name="Look").click()
    expect(page.get_by_role("alert")).to_contain_text("nobody")
