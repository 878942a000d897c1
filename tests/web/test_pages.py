"""Pages without a browser: headers, forms of strangers, addresses, escaping."""

from __future__ import annotations

import asyncio
import re
from typing import Any

import httpx
import pytest
from tests.api.conftest import Service, sign_in

from robomend.api.routers.control import ANSWER_S
from robomend.api.routers.pages import ours
from robomend.security import RULES
from robomend.store.records import AuditEntry
from robomend.web.rendering import percent, static_address, static_files
from robomend.web.words import duration, folded, listed, without

FORM = {"Content-Type": "application/x-www-form-urlencoded"}


def cookie(service: Service, role: str) -> str:
    return sign_in(service, service.key(role)).headers["set-cookie"].partition(";")[0]


def test_no_page_allows_code_of_others(service: Service) -> None:
    answers = [service.http.get(path) for path in ("/", "/ui/sign-in", "/?rows=0", "/ui/static/x/none.js")]
    assert [answer.status_code for answer in answers] == [200, 200, 422, 404]
    for answer in answers:
        policy = answer.headers["content-security-policy"]
        assert policy.startswith("default-src 'none'; script-src 'self';")
        assert "unsafe" not in policy
        assert "frame-ancestors 'none'" in policy
        assert answer.headers["referrer-policy"] == "same-origin"
        assert answer.headers["content-type"].startswith("text/html")
        assert " style=" not in answer.text
        assert " onclick=" not in answer.text


def test_who_follows_a_link_to_nothing_has_the_stop_in_reach(keyed: Service) -> None:
    viewer, operator = ({"Cookie": cookie(keyed, role)} for role in ("viewer", "operator"))
    for path, status in (("/ui/robots/nobody", 404), ("/?rows=0", 422)):
        answer = keyed.http.get(path, headers=operator)
        assert answer.status_code == status
        assert 'id="stop-button"' in answer.text
        assert 'href="/ui/repairs"' in answer.text
        assert 'id="problem"' in answer.text
        assert 'id="stop-button"' not in keyed.http.get(path, headers=viewer).text
        assert 'id="stop-button"' not in keyed.http.get(path).text, "a stranger is asked for a key"
    refused = keyed.http.get("/ui/keys", headers=viewer)
    assert refused.status_code == 403
    assert 'href="/ui/sign-in"' in refused.text, "or a browser with the wrong key is stuck"
    # The script of that page fetches its stop anew; that of a robot that was deleted is told so.
    stop = keyed.http.get("/ui/robots/nobody", headers={**operator, "Robomend-Parts": "stop"})
    assert (stop.status_code, stop.text.count("data-part=")) == (200, 1)
    gone = keyed.http.get("/ui/robots/nobody", headers={**operator, "Robomend-Parts": "stop,state"})
    assert gone.status_code == 404


def test_scripts_are_kept_as_long_as_they_are_of_this_version(service: Service) -> None:
    for name in static_files():
        answer = service.http.get(static_address(name))
        assert answer.status_code == 200
        assert "immutable" in answer.headers["cache-control"]
        assert not re.search(r"^\s*(//|/\*)", answer.text, re.MULTILINE), "comments are not for browsers"
        assert service.http.get(f"/ui/static/older/{name}").headers["cache-control"] == "no-store"


@pytest.mark.parametrize(
    ("headers", "status"),
    [
        ({"Origin": "https://evil.example"}, 403),
        ({"Origin": "null"}, 403),
        ({"Sec-Fetch-Site": "cross-site"}, 403),
        ({"Sec-Fetch-Site": "same-site"}, 403),
        ({}, 400),
        ({"Sec-Fetch-Site": "same-origin"}, 303),
        ({"Origin": "OURS"}, 303),
    ],
)
def test_a_form_must_be_ours_with_and_without_keys(
    service: Service, keyed: Service, headers: dict[str, str], status: int
) -> None:
    for asked, more in ((service, {}), (keyed, {"Cookie": cookie(keyed, "operator")})):
        told = {name: value.replace("OURS", asked.url) for name, value in headers.items()}
        answer = asked.http.post("/ui/stop", content="reason=x", headers={**FORM, **more, **told})
        assert answer.status_code in {status, 403 if status == 400 else status}
        assert asked.http.get("/api/v1/stop", headers=more).json()["active"] == (status == 303)
        asked.http.post("/ui/stop", content="active=no", headers={**FORM, **more, "Origin": asked.url})


@pytest.mark.parametrize("path", [path for method, path in RULES if method == "POST" and "/ui/" in path])
def test_no_form_is_taken_that_does_not_say_whose_page_it_is_on(service: Service, path: str) -> None:
    asked = re.sub(r"\{\w+\}", "1", path)
    for headers, status in (({}, 400), ({"Origin": "https://evil.example"}, 403)):
        answer = service.http.post(asked, content="", headers={**FORM, **headers})
        assert answer.status_code == status


def test_the_page_after_the_form_that_lifts_the_stop_is_without_it(
    service: Service, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It is lifted when that is on disk, which may take longer than an answer about the stop waits."""
    own = {**FORM, "Origin": service.url}
    store = service.runtime.store
    write = store.write

    async def slow(*what: Any, **options: Any) -> Any:
        await asyncio.sleep(5 * ANSWER_S)  # the disk is busy: that is what is tested
        return await write(*what, **options)

    service.http.post("/ui/stop", content="reason=smoke", headers=own)
    assert "Lift the stop" in service.http.get("/").text
    monkeypatch.setattr(store, "write", slow)
    service.http.post("/ui/stop", content="active=no", headers=own)
    assert "Lift the stop" not in service.http.get("/").text


def test_a_form_that_is_none_is_a_clear_answer(service: Service) -> None:
    def post(content: bytes, kind: str = FORM["Content-Type"]) -> httpx.Response:
        headers = {"Content-Type": kind, "Origin": service.url}
        return service.http.post("/ui/stop", content=content, headers=headers)

    assert post(b"{}", "application/json").status_code == 415
    assert post(b"reason=%ff").status_code == 400
    assert post(b"&".join(b"a=b" for _ in range(51))).status_code == 400
    assert post(b"reason=" + b"x" * 100_000).status_code == 413


@pytest.mark.parametrize(
    ("asked", "taken"),
    [
        ("/ui/robots/r1?a=b", "/ui/robots/r1?a=b"),
        ("/?q=x", "/?q=x"),
        ("https://evil.example/", "/"),
        ("//evil.example/ui/x", "/"),
        ("/\\evil.example", "/"),
        ("/api/v1/robots", "/"),
        ("javascript:alert(1)", "/"),
        ("/ui/a\r\nSet-Cookie: b", "/"),
    ],
)
def test_a_form_leads_back_to_our_own_pages_only(asked: str, taken: str) -> None:
    assert ours(asked) == taken


def test_whatever_is_asked_for_is_shown_as_text(service: Service) -> None:
    for path in ("/", "/ui/sign-in"):
        answer = service.http.get(path, params={"q": '"><script>alert(1)</script>', "to": '/?q="><i>'})
        assert "<script>alert" not in answer.text
        assert '"><i>' not in answer.text


def test_parts_of_a_page_are_all_that_is_sent(service: Service) -> None:
    whole = service.http.get("/")
    stop = service.http.get("/", headers={"Robomend-Parts": "stop"})
    assert "<html" not in stop.text
    assert 'data-part="stop"' in stop.text
    assert 'data-part="fleet"' not in stop.text
    assert len(stop.content) < len(whole.content) / 2


def test_numbers_have_units_and_claim_no_more_than_is_known() -> None:
    assert [percent(p) for p in (0, 0.004, 0.5, 0.996, 1)] == ["0 %", "< 1 %", "50 %", "> 99 %", "100 %"]
    assert [duration(s) for s in (0.02, 3.21, 90, 7200, 200_000)] == [
        "20 ms",
        "3.2 s",
        "2 min",
        "2.0 h",
        "2 days",
    ]
    assert listed(["a", "b", "c", "d", "e", "f"]) == "a, b, c, d and 2 more"


def test_a_reason_does_not_name_again_what_was_named_right_before() -> None:
    assert without("a, b: helps with probability 1 at cost 4", ["a", "b"]) == "helps with probability 1"
    assert without("every leading diagnosis blames a", ["a"]) == "every leading diagnosis blames a"
    assert without("nothing is bad", []) == "nothing is bad"


def test_what_the_machine_did_in_one_repair_is_one_line_of_the_audit_log() -> None:
    newest_first = [
        AuditEntry("robomend", "repair.escalated", "r-2", "a", "no help"),
        AuditEntry("robomend", "action.result", "start_node(n)", "a", "failed"),
        AuditEntry("robomend", "action.sent", "power_up(d)", "b", "of another robot"),
        AuditEntry("agent", "observations.report", "agent", "a"),
        AuditEntry("robomend", "action.sent", "start_node(n)", "a", "n is blamed"),
        AuditEntry("robomend", "repair.running", "r-2", "a", "n is blamed"),
        AuditEntry("ann", "repair.approve", "r-2", "a", "go on"),
        AuditEntry("robomend", "repair.awaiting-approval", "r-2", "a", "n is blamed"),
        AuditEntry("robomend", "repair.cancelled", "r-1", "a"),
    ]
    lines = folded(newest_first, "robomend")
    assert [(line.entry.action, len(line.before)) for line in lines] == [
        ("repair.escalated", 3),
        ("action.sent", 0),
        ("observations.report", 0),
        ("repair.approve", 0),
        ("repair.awaiting-approval", 0),
        ("repair.cancelled", 0),
    ]
    assert lines[0].reasons == ["n is blamed", "failed", "no help"]
