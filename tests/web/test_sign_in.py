"""Who sees what: signing in and out, keys, and what each role is offered."""

from __future__ import annotations

import json
import re
from pathlib import Path

import pytest
from playwright.sync_api import expect
from tests.api.conftest import Service, running
from tests.browser import keep
from tests.web.conftest import Look, signed_in
from tests.web.test_fleet import LIVE, live, serious

from robomend.settings import Settings


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
    page.wait_for_selector(LIVE)
    page.get_by_role("button", name="Sign out").click()
    page.goto(keyed.url)
    expect(page.get_by_role("heading", name="Sign in")).to_be_visible()


@pytest.mark.parametrize(("role", "stops", "audit"), [("viewer", 0, 0), ("operator", 1, 0), ("admin", 1, 1)])
def test_a_role_is_offered_what_it_may_do(
    keyed: Service, look: Look, role: str, stops: int, audit: int
) -> None:
    page = signed_in(look(keyed), keyed, role, "/ui/models/tedusar")
    assert page.get_by_role("link", name="Audit").count() == audit
    assert page.get_by_role("link", name="Keys").count() == audit
    assert page.get_by_role("button", name="Save").count() == stops
    answer = page.goto(keyed.url + "/ui/keys")
    assert answer is not None
    assert answer.status == (200 if audit else 403)
    assert ("in use" in page.inner_text("main")) == bool(audit)
    assert "rm_" not in page.content()
    page.goto(keyed.url)
    expect(page.get_by_role("link", name="r1", exact=True)).to_be_visible()
    assert page.get_by_role("button", name="Stop all repairs").count() == stops


def test_a_page_says_so_when_its_key_is_gone(keyed: Service, look: Look) -> None:
    visitor = look(keyed)
    page = signed_in(visitor, keyed, "viewer")
    visitor.context.clear_cookies()
    page.get_by_role("searchbox").fill("r")
    expect(page.locator('#live[data-state="lost"]')).to_contain_text("signed out")


def test_keys_are_made_shown_once_used_and_revoked_without_the_terminal(tmp_path: Path, look: Look) -> None:
    with running(Settings(port=0, data=tmp_path, sign_ins_per_minute=1e6)) as fresh:
        page = live(look(fresh), "/ui/keys")
        expect(page.locator("#new option")).to_have_text(["admin: everything, the audit log and keys"])
        page.get_by_label("Name").fill("Ada")
        page.get_by_role("button", name="Make the key").click()
        admin = page.get_by_label("Key", exact=True).input_value()
        assert serious(page) == []
        page.goto(fresh.url + "/ui/keys")
        assert admin not in page.content()
        page.get_by_label("Your key").fill(admin)
        page.get_by_role("button", name="Sign in").click()
        row = page.get_by_role("row", name=re.compile("^Ada"))
        expect(row).to_contain_text("in use, by you")
        expect(row.get_by_text("Revoke …")).to_have_count(0)
        page.get_by_text("Make a key").click()
        page.get_by_label("Role").select_option("robot")
        page.get_by_role("textbox", name="Robot").fill("r1")
        page.locator("#new").get_by_label("Why").fill("a new laptop")
        page.get_by_role("button", name="Make the key").click()
        text = page.get_by_label("Key", exact=True).input_value()
        bearer = {"Authorization": f"Bearer {text}"}
        assert fresh.http.get("/api/v1/session", headers=bearer).json()["robot"] == "r1"
        keep(page, "keys")
        page.get_by_text("Revoke …").click()
        page.get_by_role("button", name="Revoke robot-r1").click()
        expect(page.get_by_role("row", name=re.compile("^robot-r1"))).to_contain_text("revoked")
        assert fresh.http.get("/api/v1/session", headers=bearer).status_code == 401
        audit = fresh.http.get("/api/v1/audit", headers={"Authorization": f"Bearer {admin}"}).json()["items"]
        told = [(one["actor"], one["reason"]) for one in audit if one["action"] == "key.create"]
        assert told == [("Ada", "a new laptop"), ("local", "")]
        assert text not in json.dumps(audit)


@pytest.mark.parametrize(
    ("fields", "said"),
    [
        ({"role": "robot"}, "a robot is named with the role robot"),
        ({"role": "viewer", "robot": "r1"}, "a robot is named with the role robot"),
        ({"role": "robot", "robot": "r 1"}, "is no id of a robot"),
        ({"role": "king"}, "the role is one of viewer, robot, operator, admin"),
        ({"role": "viewer", "name": "Eve"}, "there is a key named"),
    ],
)
def test_a_key_that_makes_no_sense_is_refused_in_words(
    keyed: Service, fields: dict[str, str], said: str
) -> None:
    head = {"Authorization": f"Bearer {keyed.key('admin')}"}
    if "name" in fields:
        keyed.http.post("/ui/keys", data=fields, headers=head)
    answer = keyed.http.post("/ui/keys", data=fields, headers=head)
    assert answer.status_code in {409, 422}
    assert said in answer.text


def test_nobody_revokes_the_key_that_they_are_signed_in_with(keyed: Service) -> None:
    head = {"Authorization": f"Bearer {keyed.key('admin')}"}
    audit = keyed.http.get("/ui/keys", headers=head).text
    own = re.findall(r'class="quiet">(k-\w+)</span></th>(?:(?!</tr>).)*in use, by you', audit)
    assert keyed.http.post(f"/ui/keys/{own[0]}", data={"reason": ""}, headers=head).status_code == 409
    assert keyed.http.post("/ui/keys/k-none", data={"reason": ""}, headers=head).status_code == 404
    assert keyed.http.get("/ui/keys", headers=head).status_code == 200
