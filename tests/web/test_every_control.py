"""Every link is followed and every button pressed, by each role: nobody is left without an answer."""

from __future__ import annotations

import re
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any
from urllib.parse import parse_qsl, urlsplit

import pytest
from playwright.sync_api import Response, expect
from tests.api.conftest import TEDUSAR, Service, sign_in
from tests.api.conftest import running as serving
from tests.batches.conftest import SCAN, ended, form
from tests.browser import Watched
from tests.robomend_board.processes import running as board_running
from tests.waiting import until
from tests.web.conftest import Look
from tests.web.test_benchmarks_page import RUN
from tests.web.test_robot import FIVE_KEY, ODD

from robomend.settings import Settings
from robomend_bench.charts import cactus
from robomend_bench.tables import markdown

ID = re.compile(r"\b[rbd]-[0-9a-z]{10}\b|(?<=version=)\d+")

FILL = {
    "observation": "ok(scan)",
    "observations": "not ok(scan)",
    "robot": "ill",
    "name": "made-on-a-walk",
    "paths": "a.ndjson",
    "reason": "on a walk",
    "q": "ill",
}
"""What is typed into fields of these names, where they are empty."""

CONTROLS = """() => [...document.querySelectorAll("form button")].map((button) => ({
  action: button.form.getAttribute("action"), live: button.form.dataset.live ?? null,
  method: button.form.method, name: button.name, value: button.value, text: button.textContent.trim(),
}))"""

LINKS = """() => [...document.querySelectorAll("a[href]")].map(
  (link) => new URL(link.getAttribute("href"), location).href)"""


NO_NODES = """
robomend: 1
name: devices
hardware:
  lamp: {channel: 3}
  fan: {}
"""


@contextmanager
def everything(root: Path) -> Iterator[Service]:
    """Serve one of each thing that pages show until the block ends; nobody has a key yet."""
    reports, logs = root / "reports", root / "logs"
    for folder in (reports, logs):
        folder.mkdir(parents=True)
    (reports / "iscas85-first.md").write_text(markdown(RUN))
    (reports / "iscas85-first-cactus.svg").write_text(cactus(RUN))
    (logs / "a.ndjson").write_text(SCAN)
    settings = Settings.model_validate(
        {
            "port": 0,
            "data": root / "data",
            "benchmark_folder": reports,
            "batch_folder": logs,
            "sign_ins_per_minute": 1e6,
            "notify": [{"name": "duty", "url": "http://127.0.0.1:9/told", "secret": "s"}],
            "webhook_hosts": ["127.0.0.1"],
        }
    )
    with board_running("--on", "2,7") as board, serving(settings, repairs=True) as service:
        for name, source in (
            ("tedusar", TEDUSAR),
            ("odd", ODD),
            ("clauses", FIVE_KEY),
            ("devices", NO_NODES),
        ):
            assert service.api("PUT", f"/models/{name}", json={"source": source}).is_success
        newer = {"source": TEDUSAR.replace("rviz: {}", "rviz: {publishes: [picture]}")}
        assert service.api("PUT", "/models/tedusar", json=newer, headers={"If-Match": "*"}).is_success
        service.with_robot("ill")
        service.with_robot("cancelled")
        service.with_robot("silent")
        service.with_robot("watched", policy="observe")
        service.with_robot("wired", board={"host": "127.0.0.1", "port": board.port, "protected": [2]})
        for robot in ("odd", "clauses", "devices"):
            body = {"model": robot, "policy": "observe"}
            assert service.api("PUT", f"/robots/{robot}", json=body).is_success
        service.observe("not ok(map)", "on(hokuyo)", robot="ill", source="general_observer")
        service.observe("not on(jaguar)", robot="cancelled")
        service.observe("not ok(map)", "not ok(odom)", robot="watched")
        service.observe("not ok(y)", robot="clauses")
        service.observe("not on(lamp)", robot="devices")
        batch = service.api("POST", "/batches", **form(("a.ndjson", SCAN), reason="last night")).json()["id"]

        def waits(robot: str) -> list[str]:
            found = service.api("GET", f"/robots/{robot}/repairs").json()["items"]
            return [one["id"] for one in found if one["state"] == "awaiting-approval"]

        until(lambda: waits("ill") and waits("cancelled"), "plans wait for a yes", 60)
        decision = {"decision": "cancel", "reason": "not today"}
        assert service.api("POST", f"/repairs/{waits('cancelled')[0]}", json=decision).is_success
        assert ended(service, batch)["state"] == "done"
        yield service


@pytest.fixture(scope="module")
def service(tmp_path_factory: pytest.TempPathFactory, pytestconfig: pytest.Config) -> Iterator[Service]:
    if not pytestconfig.getoption("--long"):
        pytest.skip("a walk takes ten seconds and more: --long")
    with everything(tmp_path_factory.mktemp("everything")) as found:
        yield found


class Walk:
    """One person's way through the pages."""

    def __init__(self, visitor: Watched, url: str) -> None:
        self.visitor = visitor
        self.page = visitor.context.new_page()
        self.url = url
        self.pressed: set[tuple[str, ...]] = set()
        self.unexplained: list[str] = []

    def all(self) -> set[str]:
        """Follow every link from the list of robots on, and press what is there; return where it led."""
        todo, seen = ["/"], {"/"}
        while todo:
            address = todo.pop(0)
            if address.startswith(("/api/", "/docs")):
                answer = self.visitor.context.request.get(self.url + address)
                assert answer.ok, f"{address}: {answer.status}"
                continue
            self.go(address)
            for link in self.page.evaluate(LINKS):
                there = urlsplit(link)
                assert link.startswith(self.url), f"{address} leads away, to {link}"
                shape = shape_of(f"{there.path}?{there.query}")
                if shape not in seen:
                    seen.add(shape)
                    todo.append(f"{there.path}?{there.query}".rstrip("?"))
            self.press_all(address)
        return seen

    def go(self, address: str) -> None:
        """Open a page; everything that is folded up is unfolded by a click."""
        answer = self.page.goto(self.url + address)
        assert answer is not None
        self.judge(answer, address)
        assert self.page.locator("h1").count() == 1, address
        for summary in self.page.locator("summary").all():
            if summary.is_visible():
                summary.click()

    def press_all(self, address: str) -> None:
        """Press each button of a page that was not pressed elsewhere, on the page as it is then."""
        for button in self.page.locator("button[type=button]").all():
            button.click()
        while new := [one for one in self.page.evaluate(CONTROLS) if self.kind(one) not in self.pressed]:
            self.pressed.add(self.kind(new[0]))
            self.press(new[0])
            self.go(address)

    def kind(self, control: dict[str, Any]) -> tuple[str, ...]:
        """Return what makes a button another one."""
        value = control["value"] if control["name"] == "decision" else control["name"]
        of_stop = control["text"] if control["action"] == "/ui/stop" else ""
        return shape_of(control["action"] or ""), value, of_stop

    def press(self, control: dict[str, Any]) -> None:
        """Fill in a form and press its button; signing out is for the end."""
        if control["action"] == "/ui/sign-out":
            return
        called = re.compile(f"^{re.escape(control['text'])}$")
        forms = self.page.locator(f'form[action="{control["action"]}"]')
        form = forms.filter(has=self.page.locator("button", has_text=called)).first
        for field in form.locator("input:not([type=hidden]):not([type=file]), textarea").all():
            name = field.get_attribute("name") or ""
            if name in FILL and not field.input_value():
                field.fill(FILL[name])
        button = form.locator("button", has_text=called).first

        method, path = str(control["method"]).upper(), urlsplit(str(control["action"])).path

        def answers(response: Response) -> bool:
            return bool(response.request.method == method and urlsplit(response.url).path == path)

        with self.page.expect_response(answers) as waited:
            button.click()
        if control["live"] is None:
            self.page.wait_for_load_state()
        else:
            expect(self.page.locator("#said")).to_be_visible()
        self.judge(waited.value, f"{control['action']} ({control['text']})")

    def judge(self, answer: Response, what: str) -> None:
        """A refusal says why, in words."""
        if answer.status < 400:
            return
        told = self.page.locator("#problem, #said.wrong, [role=alert]:visible").all_inner_texts()
        if len(" ".join(told).split()) < 3:
            self.unexplained.append(f"{what}: {answer.status}, and the page says {told}")


def shape_of(address: str) -> str:
    """Return an address without what only says which one of many."""
    there = urlsplit(address)
    return f"{ID.sub('…', there.path)}?{','.join(sorted({key for key, _ in parse_qsl(there.query)}))}"


@pytest.mark.timeout(900)
@pytest.mark.parametrize("role", ["viewer", "operator", "admin"])
def test_every_link_and_every_button_has_an_answer(service: Service, look: Look, role: str) -> None:
    service.key("admin")
    cookie, _, _ = sign_in(service, service.key(role)).headers["set-cookie"].partition(";")
    name, _, value = cookie.partition("=")
    visitor = look(service)
    visitor.context.add_cookies([{"name": name, "value": value, "url": service.url}])
    walk = Walk(visitor, service.url)
    seen = walk.all()
    assert walk.unexplained == []
    assert {"/ui/audit?", "/ui/keys?", "/ui/notifications?"} & seen == (
        {"/ui/audit?", "/ui/keys?", "/ui/notifications?"} if role == "admin" else set()
    )
    changing = {action for action, *_ in walk.pressed} - {"/?", "/ui/what-if?", "/ui/audit?"}
    changing = {action for action in changing if not re.search(r"/(isolability|compare)\?", action)}
    if role == "viewer":
        assert changing == {"/ui/sign-out?"}, "nothing is offered that would be refused"
    else:
        assert {"/ui/stop?", "/ui/models?", "/ui/batches?", "/ui/repairs/…?"} <= changing
