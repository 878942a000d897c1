"""People are told that a person is needed, by a service as it is run; who and what is on its page."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import httpx
import pytest
from tests.api.conftest import Service, running
from tests.notifications.receivers import Hook, serving
from tests.waiting import until

from robomend.settings import Settings


@pytest.fixture(scope="module")
def hook() -> Iterator[Hook]:
    server = Hook()
    with serving(server):
        yield server


def told_by(data: Path, hook: Hook) -> Settings:
    duty = {"name": "duty", "url": f"http://{hook.host}/told?token=t0ken", "secret": "s3cret"}
    return Settings.model_validate(
        {
            "data": data,
            "port": 0,
            "notify": [duty, {**duty, "name": "lab", "robots": ["lab-*"], "about": ["approval"]}],
            "webhook_hosts": [hook.host],
            "public_url": "https://robots.example",
        }
    )


@pytest.fixture(scope="module")
def service(tmp_path_factory: pytest.TempPathFactory, hook: Hook) -> Iterator[Service]:
    with running(told_by(tmp_path_factory.mktemp("told"), hook), repairs=True) as service:
        yield service


def of(hook: Hook, about: str) -> list[dict[str, Any]]:
    return [one for one in hook.told if one["about"] == about]


def test_a_plan_that_waits_for_a_yes_is_told_with_a_link(service: Service, hook: Hook) -> None:
    service.with_robot("r1", policy="approve")
    service.observe("not ok(scan)", "not on(hokuyo)", robot="r1")
    until(lambda: of(hook, "approval"), "nobody was told of the plan", 150)
    [one] = of(hook, "approval")
    assert one["robot"] == "r1"
    assert one["url"] == f"https://robots.example/ui/repairs/{one['repair']}"
    assert "plan: " in one["text"]
    [open_one] = service.api("GET", "/robots/r1/repairs").json()["items"]
    assert (open_one["id"], open_one["state"]) == (one["repair"], "awaiting-approval")


def test_the_stop_is_told_when_it_is_set_and_lifted(service: Service, hook: Hook) -> None:
    before = len(of(hook, "stop"))
    service.api("POST", "/stop", json={"reason": "smoke in hall 2"})
    service.api("DELETE", "/stop", params={"reason": "it was steam"})
    until(lambda: len(of(hook, "stop")) == before + 2, "nobody was told of the stop", 60)
    first, last = of(hook, "stop")[before:]
    assert (first["title"], last["title"]) == ("the global stop was set", "the global stop was lifted")
    assert "smoke in hall 2" in first["text"]
    assert first["url"] == "https://robots.example/"


def test_a_robot_that_becomes_unknown_is_told(service: Service, hook: Hook) -> None:
    service.with_robot("r2", policy="observe", observed=["on(jaguar)"])
    service.observe("on(jaguar)", robot="r2", lifetime_s=0.2)
    until(lambda: any(one["robot"] == "r2" for one in of(hook, "unknown")), "nobody was told of r2", 60)


def test_a_test_says_what_came_of_it(service: Service, hook: Hook) -> None:
    sent = service.api("POST", "/notifications/recipients/duty/test").json()
    assert (sent["state"], sent["answer"], sent["about"]) == ("delivered", "answered 200", "test")
    assert sent["id"] in {one["id"] for one in hook.told}
    hook.status = 503
    try:
        failed = service.api("POST", "/notifications/recipients/lab/test").json()
    finally:
        hook.status = 200
    assert (failed["state"], failed["answer"], failed["tries"]) == ("waiting", "answered 503", 1)
    assert service.api("POST", "/notifications/recipients/nobody/test").status_code == 404
    [entry, *_] = service.api("GET", "/audit").json()["items"]
    assert (entry["action"], entry["subject"]) == ("notification.test", "lab")


def test_who_is_told_and_what_they_were_told_is_shown_without_secrets(service: Service, hook: Hook) -> None:
    found = service.api("GET", "/notifications/recipients").json()
    assert [one["name"] for one in found["items"]] == ["duty", "lab"]
    assert found["items"][0]["to"] == f"http://{hook.host}/…"
    page = service.http.get("/ui/notifications")
    assert "Send duty a test" in page.text
    listed = service.api("GET", "/notifications")
    for text in (str(found), page.text, listed.text, service.api("GET", "/audit").text):
        assert "t0ken" not in text
        assert "s3cret" not in text


def test_what_could_not_be_delivered_survives_a_restart(tmp_path: Path) -> None:
    away = Hook()
    settings = told_by(tmp_path, away)

    def waiting(service: Service) -> list[dict[str, Any]]:
        found: httpx.Response = service.api("GET", "/notifications")
        return [one for one in found.json()["items"] if one["state"] == "waiting" and one["tries"]]

    away.status = 500
    with serving(away):
        with running(settings) as service:
            service.api("POST", "/stop", json={"reason": "smoke"})
            until(lambda: waiting(service), "nobody was told", 60)
        away.status = 200
        with running(settings) as service:
            until(lambda: not waiting(service), "what was put off did not come", 60)
    titles = [one["title"] for one in away.told]
    assert set(titles) == {"the global stop was set"}
    assert len({one["id"] for one in away.told}) == 1
