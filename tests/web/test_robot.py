"""One robot in a real browser: why it misbehaves, what is done about it, and what a person may do."""

from __future__ import annotations

import re
import time
import urllib.parse
from typing import Any

import pytest
from playwright.sync_api import Page, expect
from tests.api.conftest import Service
from tests.browser import Watched, keep
from tests.web.conftest import Look
from tests.web.test_fleet import LIVE, live, serious

LONG = "a" + "b" * 198 + "c"
MARKUP = "<img src=x onerror=alert(1)>"
HEBREW = "חיישן שמאל"
ODD = f"""
robomend: 1
name: odd
hardware:
  "{MARKUP}": {{channel: 1}}
  "{HEBREW}": {{channel: 2}}
nodes:
  "{LONG}": {{drives: ["{MARKUP}"], publishes: {{"</svg><script>alert(2)</script>": []}}}}
  "right & left": {{drives: ["{HEBREW}"], publishes: {{plain: []}}}}
"""

FIVE_KEY = """
ab: AB
nab: NAB
neg_prefix: not_
rules: ["NAB(a)->ok(x)", "NAB(b),ok(x)->ok(y)"]
props: [ok(x), ok(y), AB(a), NAB(a), AB(b), NAB(b)]
"""


def part(page: Page, name: str) -> str:
    """Return how a part of the page reads."""
    return page.locator(f'[data-part="{name}"]').inner_text()


@pytest.fixture(scope="module")
def ill(service: Service) -> Service:
    """A service with a robot that waits for approval, and others beside it."""
    service.with_robot("ill")
    service.api("PUT", "/robots/silent", json={"model": "tedusar"})
    measured = {"value": "0 of 2 Hz for 3.1 s", "limit": "1 to 3 Hz", "symptom": "silent"}
    service.observe(
        "not ok(map)", "on(hokuyo)", robot="ill", source="general_observer", readings=[measured, None]
    )
    return service


def awaiting(service: Service, look: Look, robot: str) -> Page:
    """Open a robot's page, and wait until its plan waits for a yes."""
    page = live(look(service), f"/ui/robots/{robot}")
    expect(page.locator('[data-part="repair"] .badge').first).to_have_text("awaiting approval")
    return page


LISTENED = """
# It was made by listening for 60 s: what a number rests on is beside it.
robomend: 1
name: heard
nodes:
  camera:
    # drives: []
    publishes:
      image: []
  lidar_driver:
    # drives: []
    publishes:
      scan: []
# Questions that listening does not answer:
#   which device does camera drive, if any?
#   rear was silent all the time: is that so by design?
"""


def test_questions_of_a_model_that_was_made_by_listening_are_answered_with_clicks(
    service: Service, look: Look
) -> None:
    service.api("PUT", "/models/heard", json={"source": LISTENED})
    service.api("PUT", "/robots/heard", json={"model": "heard"})
    page = live(look(service), "/ui/robots/heard")
    questions = page.locator("#questions")
    expect(questions).to_contain_text("made by listening for 60 s: 3 questions")
    questions.locator("summary").click()
    questions.get_by_label("lidar_driver drives it").click()
    expect(page.locator("#questions")).to_contain_text("2 questions")
    page.get_by_label("camera drives no device").click()
    expect(page.locator("#questions")).to_contain_text("1 question")
    page.get_by_label("Yes: rear was silent").click()
    expect(page.locator("#questions")).to_have_count(0)
    model = service.api("GET", "/models/heard").json()["source"]
    assert "hardware:\n  lidar: {blame_hardware: true}\n" in model
    assert "  lidar_driver:\n    drives: [lidar]\n" in model
    assert "  camera:\n    drives: []\n" in model
    assert "is that so by design? yes\n" in model


BELIEVED = """
robomend: 1
name: believed
nodes:
  lidar_driver:
    publishes:
      scan: []
  planner:
    publishes:
      plan: [scan]    # nav_msgs/Path
"""


def test_an_arrow_of_the_model_that_is_contradicted_is_taken_out_with_a_click(
    service: Service, look: Look
) -> None:
    """The plan goes on while the scan is silent."""
    service.api("PUT", "/models/believed", json={"source": BELIEVED})
    service.api("PUT", "/robots/believed", json={"model": "believed", "policy": "observe"})
    now_ns = time.time_ns()
    said: dict[str, Any] = {"observations": ["not ok(scan)", "ok(plan)"], "time": now_ns}
    said |= {"since": [now_ns - 10**9, now_ns - 10**9], "onset": [now_ns - 9 * 10**9, None]}
    said |= {"readings": [{"value": "0 of 10 Hz", "symptom": "silent"}, None]}
    service.api("POST", "/robots/believed/observations", json=said)
    page = live(look(service), "/ui/robots/believed")
    arrows = page.locator("#arrows")
    expect(arrows).to_contain_text("planner was healthy without scan: that plan rests on it may be wrong")
    arrows.get_by_label("Take it out of the model").click()
    expect(page.locator("#arrows")).to_have_count(0)
    model = service.api("GET", "/models/believed").json()["source"]
    assert "      plan: []    # nav_msgs/Path\n" in model
    assert model.endswith("#   does plan rest on scan? no\n")


def test_a_robot_is_told_with_diagnoses_reasons_probes_plan_and_observations(
    ill: Service, look: Look
) -> None:
    page = awaiting(ill, look, "ill")
    order = page.locator("[data-part]").evaluate_all("all => all.map((each) => each.dataset.part)")
    assert order[1:5] == ["state", "repair", "diagnosis", "findings"]
    assert "things will not work" in part(page, "findings")
    diagnosis = part(page, "diagnosis")
    for name in ("hokuyo", "hokuyo_node", "hector_mapping"):
        assert f"{name}\n{name} explains map not ok" in diagnosis
    assert "There are no others." in diagnosis
    assert "Is scan as it should be? Yes leaves hector_mapping; no leaves hokuyo" in diagnosis
    looked = page.get_by_title("ok(scan): expected 0.92 bit for 1.0 s of looking")
    assert "Is scan as it should be?" in looked.inner_text()
    assert "in 1 of 3 diagnoses" in diagnosis
    assert "Approve" in part(page, "state")
    observed = part(page, "obs")
    assert re.search(
        r"map is silent\s+0 of 2 Hz for 3.1 s, 1 to 3 Hz(\s+\d\d:\d\d:\d\d){2}\s+general_observer",
        observed,
    )
    assert page.locator(".timeline rect.suspect").count() >= 3


def test_the_graph_shades_suspects_and_leads_to_the_reasons(ill: Service, look: Look) -> None:
    page = awaiting(ill, look, "ill")
    suspects = page.locator("svg.graph .suspect")
    assert suspects.count() == 3
    assert float(suspects.first.locator("rect").get_attribute("fill-opacity") or 1) < 0.6
    assert (page.locator("svg.graph .topic.silent text").text_content() or "").strip() == "✕ map"
    assert not page.locator("#why-2").get_attribute("open")
    link = page.get_by_role("link", name="node hector_mapping: suspect, 33% of the suspicion")
    link.focus()
    page.keyboard.press("Enter")
    opened = page.locator("details.why[open]")
    expect(opened).to_contain_text(
        "map should be ok because hokuyo, hokuyo_node and hector_mapping are taken"
    )
    expect(opened).to_contain_text("not ab(hector_mapping) and ok(scan) -> ok(map)")
    wide = "document.querySelector('svg.graph').getBoundingClientRect().width"
    assert page.evaluate(wide) <= page.evaluate("document.querySelector('.graph-box').clientWidth"), "it fits"
    before = page.evaluate(wide)
    page.get_by_role("button", name="Larger").click()
    assert page.evaluate(wide) > before


def test_the_graph_shows_the_way_from_cause_to_symptom_and_what_a_thing_rests_on(
    ill: Service, look: Look
) -> None:
    page = awaiting(ill, look, "ill")
    assert page.locator("svg.graph .edge.path").count() == 4  # hokuyo, its node, scan, hector_mapping, map
    page.locator("svg.graph .topic.silent").hover()
    expect(page.locator("svg.graph.tracing")).to_be_attached()
    rests = page.locator("svg.graph .thing.upstream text").all_text_contents()
    upstream = {"hokuyo", "hokuyo_node", "scan", "hector_mapping", "map"}
    assert {text.strip("✕!? ") for text in rests} == upstream
    page.get_by_role("heading", name="What depends on what").hover()
    expect(page.locator("svg.graph.tracing")).to_have_count(0)


def test_what_is_bad_is_seen_first_and_the_rest_is_folded_by_component(service: Service, look: Look) -> None:
    service.with_robot("sorted", policy="observe")
    rate = {"value": 3, "unit": "of 10 Hz", "limit": "8 to 12 Hz", "symptom": "slow"}
    fine = {"value": 2.0, "unit": "of 2 Hz"}
    seen = ("ok(imu_data)", "ok(odom)", "on(hokuyo)", "running(hokuyo_node)", "not ok(scan)", "ok(map)")
    service.observe(*seen, robot="sorted", readings=[None, None, None, None, rate, fine])
    page = live(look(service), "/ui/robots/sorted")
    obs = page.locator('[data-part="obs"]')
    expect(obs.locator("tbody tr").first).to_contain_text("scan is too slow 3 of 10 Hz, 8 to 12 Hz")
    good = obs.locator("#obs-good")
    assert good.get_attribute("open") is None
    expect(good.locator("summary")).to_have_text("5 are as they should be, of 5 components")
    good.locator("summary").click()
    row = good.locator("tr", has=page.get_by_role("rowheader", name="hector_mapping"))
    expect(row).to_contain_text("ok(map) 2 of 2 Hz")
    expect(good.locator("tr", has=page.get_by_role("rowheader", name="hokuyo_node"))).to_contain_text(
        "running(hokuyo_node)"
    )


def test_beside_a_number_stands_how_it_went(service: Service, look: Look) -> None:
    service.with_robot("measured", policy="observe")
    for hertz in (10, 9, 8.5, 4, 3):
        held = "ok(scan)" if hertz >= 8 else "not ok(scan)"
        rate = {"value": hertz, "unit": "Hz", "limit": "8 to 12 Hz"}
        volts = {"value": 24, "unit": MARKUP}
        said = {"value": "exit code 1"}
        seen = (held, "on(jaguar)", "not running(hector_mapping)")
        service.observe(*seen, robot="measured", readings=[rate, volts, said])
    page = live(look(service), "/ui/robots/measured")
    obs = page.locator('[data-part="obs"]')
    course = obs.locator("tr", has_text="scan is not as it should be").get_by_role("img")
    expect(course).to_have_accessible_name(re.compile(r"^ok\(scan\): 3 to 10 Hz in the last .*s, now 3$"))
    assert (course.locator(".line").get_attribute("d") or "").count("M") == 2, "from 10 to 9 and to 8.5"
    assert (course.locator(".amiss").get_attribute("d") or "").count("M") == 2, "to 4, and to 3"
    assert obs.locator("tr", has_text="hector_mapping is not running").get_by_role("img").count() == 0
    obs.locator("#obs-good summary").click()
    steady = obs.locator("tr", has_text="on(jaguar)").get_by_role("img")
    expect(steady).to_have_accessible_name(re.compile(rf"24 to 24 {re.escape(MARKUP)}"))
    assert serious(page) == []
    keep(page, "sparklines")


def test_a_plan_is_approved_carried_out_and_told_in_words(service: Service, look: Look) -> None:
    service.with_robot("approved")
    service.observe("not ok(map)", "not running(hector_mapping)", robot="approved")
    page = awaiting(service, look, "approved")
    page.locator('[data-part="state"]').get_by_label("Why").fill("I looked")
    page.get_by_role("button", name="Approve").click()
    expect(page.locator('[data-part="repair"] .badge').first).not_to_have_text("awaiting approval")
    repair = service.api("GET", "/robots/approved/repairs").json()["items"][0]["id"]
    page.goto(f"{service.url}/ui/repairs/{repair}")
    expect(page.locator(".record")).to_contain_text("Start hector_mapping")
    assert page.locator('.record [title="start_node(hector_mapping)"]').count()
    audit = service.api("GET", "/audit", params={"robot": "approved"}).json()["items"]
    assert [one["reason"] for one in audit if one["action"] == "repair.approve"] == ["I looked"]


def test_a_plan_is_approved_on_the_page_of_its_repair(service: Service, look: Look) -> None:
    service.with_robot("linked")
    service.observe("not ok(map)", "not running(hector_mapping)", robot="linked")
    awaiting(service, look, "linked")
    repair = service.api("GET", "/robots/linked/repairs").json()["items"][0]["id"]
    page = live(look(service), f"/ui/repairs/{repair}")
    page.locator(".card").get_by_label("Why").fill("told by a message")
    page.get_by_role("button", name="Approve").click()
    expect(page.get_by_role("button", name="Approve")).to_have_count(0)
    audit = service.api("GET", "/audit", params={"robot": "linked"}).json()["items"]
    assert [one["reason"] for one in audit if one["action"] == "repair.approve"] == ["told by a message"]


def test_a_click_that_comes_too_late_has_a_clear_answer(service: Service, look: Look) -> None:
    service.with_robot("late")
    service.observe("not on(jaguar)", robot="late")
    page = awaiting(service, look, "late")
    repair = service.api("GET", "/robots/late/repairs").json()["items"][0]["id"]
    form = page.locator(f'form[action="/ui/repairs/{repair}"]')
    # The page would follow the event before anybody clicks.
    page.route("**/ui/robots/late", lambda route: route.abort())
    service.api("POST", f"/repairs/{repair}", json={"decision": "cancel"})
    form.get_by_role("button", name="Approve").click()
    expect(page.locator("#said")).to_contain_text("has ended")
    page.unroute("**/ui/robots/late")


def test_a_second_person_who_says_yes_is_told_that_it_was_said(service: Service, look: Look) -> None:
    service.with_robot("twice")
    service.observe("not on(jaguar)", robot="twice")
    first, second = awaiting(service, look, "twice"), awaiting(service, look, "twice")
    # Their page would follow the event before they click.
    second.route("**/ui/robots/twice", lambda route: route.abort())
    first.get_by_role("button", name="Approve").dblclick()
    expect(first.locator("#said")).to_have_text(re.compile("^Approved|awaits no approval|already"))
    second.get_by_role("button", name="Approve").click()
    expect(second.locator("#said")).to_contain_text(re.compile("awaits no approval|already"))
    second.unroute("**/ui/robots/twice")
    audit = service.api("GET", "/audit", params={"robot": "twice"}).json()["items"]
    assert [one["action"] for one in audit].count("repair.approve") == 1


def test_a_plan_is_shown_without_acting(service: Service, look: Look) -> None:
    service.with_robot("observed", policy="observe")
    service.observe("not on(jaguar)", robot="observed")
    page = live(look(service), "/ui/robots/observed")
    page.get_by_role("link", name="Plan without acting").click()
    expect(page.get_by_text("What a repair would do (nothing is done)")).to_be_visible()
    assert "Power up jaguar" in part(page, "repair")
    assert page.get_by_role("button", name="Ask for a repair").count() == 0
    assert service.api("GET", "/robots/observed/repairs").json()["items"] == []


def test_a_robot_that_never_reported_is_unknown_and_empty_of_claims(ill: Service, look: Look) -> None:
    page = live(look(ill), "/ui/robots/silent")
    assert "unknown" in part(page, "state")
    assert "Nothing has been reported yet" in part(page, "obs")
    assert "Nothing was observed yet." in part(page, "diagnosis")
    assert "No component was blamed" in part(page, "past")
    assert "healthy" not in part(page, "state")
    assert page.locator("svg.graph .good").count() == 0, "silence is not health"
    assert page.locator("svg.graph .unknown").count() >= 14


def test_of_a_robot_whose_observations_are_outlived_nothing_is_shown_as_good(
    service: Service, look: Look
) -> None:
    service.with_robot("gone", policy="observe")
    seen = ["not ok(scan)", "on(hokuyo)", "running(hokuyo_node)", "ok(odom)"]
    service.api("POST", "/robots/gone/observations", json={"observations": seen, "lifetime_s": 1})
    page = live(look(service), "/ui/robots/gone")
    expect(page.locator('[data-part="state"]')).to_contain_text("unknown")
    expect(page.locator('[data-part="obs"] .counted')).to_have_text("None known, 4 expired")
    expect(page.locator('[data-part="diagnosis"]')).to_contain_text("none is seen to work")
    past = page.locator('[data-part="past"] svg.wide')
    expect(past.locator(".suspect").first).to_be_attached()
    expect(past.locator(".good")).to_have_count(0)
    expect(page.locator("svg.graph .good")).to_have_count(0)
    assert "healthy" not in part(page, "state") + part(page, "diagnosis")


SPILLED = """
[...document.querySelectorAll("svg .thing")].filter((thing) => {
  const [text, box] = ["text", "rect"].map((name) => thing.querySelector(name).getBoundingClientRect());
  return text.width > 0 && (text.left < box.left + 2 || text.right > box.right - 2);
}).map((thing) => thing.textContent)
"""
"""The boxes of graphs that their texts leave."""


def test_odd_names_are_shown_as_they_are_and_do_nothing(service: Service, look: Look) -> None:
    service.api("PUT", "/models/odd", json={"source": ODD})
    made = service.api("PUT", "/robots/odd", json={"model": "odd"})
    assert made.status_code == 201, made.text
    seen = service.observe(
        f'not on("{MARKUP}")', f'not on("{HEBREW}")', f'not running("{LONG}")', robot="odd"
    )
    assert seen.status_code == 200, seen.text
    visitor = look(service, viewport={"width": 390, "height": 800})
    said: list[str] = []
    visitor.context.on("dialog", lambda dialog: said.append(dialog.message))
    for path in ("/ui/robots/odd", "/?q=odd", "/ui/robots/odd?plan=true"):
        page = live(visitor, path)
        assert MARKUP in page.inner_text("main")
        assert HEBREW in page.inner_text("main")
        assert page.evaluate("document.documentElement.scrollWidth") <= 390
        assert page.locator("main img, main script").count() == 0
        assert page.evaluate(SPILLED) == []
    assert page.locator("svg .thing").count() > 3
    assert said == []


def test_a_model_of_clauses_has_no_graph_and_no_repair(service: Service, look: Look) -> None:
    service.api("PUT", "/models/clauses", json={"source": FIVE_KEY})
    made = service.api("PUT", "/robots/clauses", json={"model": "clauses", "policy": "observe"})
    assert made.status_code == 201, made.text
    service.observe("not ok(y)", robot="clauses")
    page = live(look(service), "/ui/robots/clauses")
    assert "There is no picture" in part(page, "graph")
    assert re.search(r"a\na explains", part(page, "diagnosis"))


def test_the_past_is_scrolled_back_to_by_addresses(ill: Service, look: Look) -> None:
    page = live(look(ill), "/ui/robots/ill?span=600")
    page.get_by_role("link", name="← earlier").click()
    page.wait_for_selector(LIVE)
    assert "No component was blamed" in part(page, "past")
    asked = urllib.parse.parse_qs(urllib.parse.urlsplit(page.url).query)
    assert asked["span"] == ["600"]
    page.get_by_role("link", name="now").click()
    expect(page.locator(".timeline rect.suspect").first).to_be_attached()


@pytest.mark.parametrize(("width", "scheme"), [(390, "dark"), (1280, "light")])
def test_nothing_serious_stands_in_the_way_of_anybody(
    ill: Service, look: Look, width: int, scheme: str
) -> None:
    visitor: Watched = look(ill, color_scheme=scheme, viewport={"width": width, "height": 800})
    page = live(visitor, "/ui/robots/ill")
    for summary in page.locator("summary").all():
        summary.click()
    keep(page, f"robot-{width}-{scheme}")
    assert serious(page) == []
    assert page.evaluate("document.documentElement.scrollWidth") <= width
