"""A browser's sign-in: what its cookie opens, from where, how long, and what ends it."""

from __future__ import annotations

import time
from collections.abc import Iterator
from http.cookies import Morsel, SimpleCookie
from pathlib import Path
from typing import Any

import httpx
import pytest
from tests.api.conftest import Service, StartService, running, sign_in

from robomend.api.gate import PLAIN, SECURE
from robomend.security import digest, new_key
from robomend.settings import Settings
from robomend.store import Transaction, api_keys


def cookie_of(answer: httpx.Response) -> Morsel[str]:
    """Return the cookie that an answer sets."""
    found: SimpleCookie = SimpleCookie(answer.headers["set-cookie"])
    assert len(found) == 1
    return next(iter(found.values()))


class Browser:
    """Sends its cookie and where its page is from, as a browser does."""

    def __init__(self, service: Service, key: str) -> None:
        self.service = service
        answer = sign_in(service, key)
        assert answer.status_code == 200, answer.text
        self.session = answer.json()
        self.cookie = f"{PLAIN}={cookie_of(answer).value}"

    def ask(self, method: str, path: str, *, at: Service | None = None, **headers: str) -> httpx.Response:
        """Make a request without a body."""
        where = at or self.service
        return where.api(method, path, headers={"Cookie": self.cookie, **headers})

    def change(self, *, at: Service | None = None) -> httpx.Response:
        """Make a change from the service's own page."""
        where = at or self.service
        return self.ask("DELETE", "/stop", at=where, Origin=where.url)


@pytest.fixture(scope="module")
def keyed(tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[Service, str]]:
    """A service and the key of an operator; each test signs in anew."""
    data = tmp_path_factory.mktemp("keyed")
    with running(Settings(port=0, data=data, sign_ins_per_minute=1e6)) as service:
        yield service, service.key("operator")


def test_a_cookie_opens_what_its_key_opens(keyed: tuple[Service, str]) -> None:
    service, key = keyed
    browser = Browser(service, key)
    assert browser.session["role"] == "operator"
    assert browser.session["expires_ns"] > time.time_ns()
    assert browser.ask("GET", "/session").json() == browser.session
    assert browser.ask("GET", "/robots").status_code == 200
    assert browser.change().is_success
    assert browser.ask("GET", "/audit").status_code == 403
    assert service.api("GET", "/robots").status_code == 401


def test_a_cookie_is_out_of_reach_of_scripts_and_of_other_sites(keyed: tuple[Service, str]) -> None:
    service, key = keyed
    plain = cookie_of(sign_in(service, key))
    assert (plain.key, plain["path"], plain["samesite"]) == (PLAIN, "/", "Strict")
    assert plain["httponly"]
    assert not plain["secure"]
    assert not plain["domain"]
    assert int(plain["max-age"]) == 12 * 3600
    behind_tls = cookie_of(sign_in(service, key, Origin=service.url.replace("http:", "https:")))
    assert (behind_tls.key, behind_tls["path"]) == (SECURE, "/")
    assert behind_tls["secure"]
    assert behind_tls["httponly"]
    assert not behind_tls["domain"]
    head = {"Cookie": f"{SECURE}={behind_tls.value}"}
    assert service.api("GET", "/session", headers=head).status_code == 200


@pytest.mark.parametrize(
    ("headers", "status"),
    [
        ({}, 403),
        ({"Origin": "https://evil.example"}, 403),
        ({"Origin": "null"}, 403),
        ({"Sec-Fetch-Site": "cross-site"}, 403),
        ({"Sec-Fetch-Site": "same-site"}, 403),
        ({"Sec-Fetch-Site": "none"}, 403),
        ({"Sec-Fetch-Site": "same-origin"}, 200),
        ({"Origin": "own"}, 200),
        ({"Origin": "own", "Sec-Fetch-Site": "same-site"}, 403),
    ],
)
def test_a_change_with_a_cookie_must_come_from_our_own_page(
    keyed: tuple[Service, str], headers: dict[str, str], status: int
) -> None:
    service, key = keyed
    own = {name: service.url if value == "own" else value for name, value in headers.items()}
    answer = service.api("DELETE", "/stop", headers={"Cookie": Browser(service, key).cookie, **own})
    assert answer.is_success == (status == 200)  # 202: not on disk yet
    if status == 403:
        assert answer.json()["code"] == "cross-origin"


def test_another_sites_page_reads_nothing_with_a_cookie(keyed: tuple[Service, str]) -> None:
    service, key = keyed
    browser = Browser(service, key)
    for site, status in (("cross-site", 403), ("same-site", 403), ("same-origin", 200), ("none", 200)):
        head = {"Cookie": browser.cookie, "Sec-Fetch-Site": site}
        assert service.api("GET", "/robots", headers=head).status_code == status


@pytest.mark.parametrize("method", ["GET", "DELETE"])
def test_a_foreign_origin_is_believed_where_the_browser_says_no_more(
    keyed: tuple[Service, str], method: str
) -> None:
    service, key = keyed
    head = {"Cookie": Browser(service, key).cookie, "Origin": "https://evil.example"}
    assert service.api(method, "/stop", headers=head).json()["code"] == "cross-origin"


def test_signing_out_ends_the_cookie_on_every_instance(start: StartService) -> None:
    one, other = start(), start()
    key = one.key("operator")
    browser, second = Browser(one, key), Browser(one, key)
    assert browser.change(at=other).is_success  # at once, whichever instance is asked
    assert browser.ask("DELETE", "/session", at=other).status_code == 403
    gone = browser.ask("DELETE", "/session", at=other, Origin=other.url)
    assert gone.status_code == 204
    assert cookie_of(gone)["max-age"] == "0"
    for service in (one, other):
        assert browser.ask("GET", "/robots", at=service).status_code == 401
        assert second.ask("GET", "/robots", at=service).status_code == 200


def test_a_revoked_key_ends_its_cookies_at_once(start: StartService) -> None:
    one, other = start(), start()
    browser = Browser(one, one.key("operator"))

    def revoke(tx: Transaction) -> None:
        api_keys.revoke(tx, api_keys.every(tx)[0].id)

    other.run(other.runtime.store.write(revoke))
    for service in (one, other):
        assert browser.ask("GET", "/robots", at=service).status_code == 401


def test_a_cookie_ends_when_its_time_is_over(keyed: tuple[Service, str]) -> None:
    service, key = keyed
    browser = Browser(service, key)
    hash = digest(browser.cookie.partition("=")[2])

    def past(tx: Transaction) -> None:
        api_keys.end_sign_in(tx, hash)
        api_keys.add_sign_in(tx, hash, api_keys.every(tx)[0].id, expires_ns=tx.now_ns - 1, most=10)

    service.run(service.runtime.store.write(past))
    assert browser.ask("GET", "/robots").status_code == 401


def test_a_stream_ends_with_its_cookie(start: StartService, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("robomend.api.gate.FRESH_S", 0.1)
    monkeypatch.setattr("robomend.api.streams.STILL_S", 0.1)
    service = start(ping_s=0.1)
    browser = Browser(service, service.key("viewer"))
    head = {"Cookie": browser.cookie, "Sec-Fetch-Site": "same-origin"}
    with service.http.stream("GET", "/api/v1/events", headers=head) as answer:
        assert answer.status_code == 200
        assert browser.ask("DELETE", "/session", Origin=service.url).status_code == 204
        assert b"".join(answer.iter_bytes()).startswith(b"retry:")  # it ends by itself


def test_signing_in_needs_a_key_and_not_too_often(start: StartService) -> None:
    service = start(sign_ins_per_minute=0.01)
    service.key("viewer")
    for text in ("", "rm_", new_key(), "x" * 100):
        answer = sign_in(service, text)
        assert answer.status_code == 401
        assert "set-cookie" not in answer.headers
    statuses = [sign_in(service, new_key()).status_code for _ in range(10)]
    assert statuses == [401] * 6 + [429] * 4
    assert int(sign_in(service, new_key()).headers["retry-after"]) > 1
    head = {"Authorization": f"Bearer {service.key('admin')}"}
    assert service.api("GET", "/session", headers=head).status_code == 200  # keys are not held up by it


def test_another_sites_page_signs_nobody_in(keyed: tuple[Service, str]) -> None:
    """Else it could have a person work under the key of the attacker."""
    service, key = keyed
    assert sign_in(service, key, Origin="https://evil.example").status_code == 403
    form = service.api("POST", "/session", data={"key": key})
    assert form.status_code == 415


def test_a_cookie_that_is_none_is_no_cookie(keyed: tuple[Service, str]) -> None:
    service, key = keyed
    for value in ("", "x", "rm_" + "a" * 43, "a" * 43, "é" * 43, "a" * 4000, key):
        head = {"Cookie": f"{PLAIN}={value}".encode(), "Origin": service.url.encode()}
        assert service.api("DELETE", "/stop", headers=head).status_code == 401


def test_a_bearer_key_goes_before_a_cookie_and_needs_no_origin(keyed: tuple[Service, str]) -> None:
    service, key = keyed
    browser = Browser(service, service.key("viewer"))
    assert browser.ask("DELETE", "/stop", Authorization=f"Bearer {key}").is_success
    assert browser.ask("GET", "/robots", Authorization=f"Bearer {new_key()}").status_code == 401


def test_the_oldest_of_too_many_sign_ins_ends(keyed: tuple[Service, str]) -> None:
    service, _ = keyed

    def fill(tx: Transaction) -> list[bool]:
        key = api_keys.every(tx)[0].id
        for number in range(5):
            api_keys.add_sign_in(tx, f"h{number}", key, expires_ns=tx.now_ns + 10**12, most=3)
        return [api_keys.sign_in(tx, f"h{number}") is not None for number in range(5)]

    assert sum(service.run(service.runtime.store.write(fill))) == 3


def test_only_the_hash_of_a_cookie_is_stored_and_the_audit_log_tells(
    start: StartService, tmp_path: Path
) -> None:
    service = start()
    browser = Browser(service, service.key("operator"))
    browser.ask("DELETE", "/session", Origin=service.url)
    head = {"Authorization": f"Bearer {service.key('admin')}"}
    entries: list[dict[str, Any]] = service.api("GET", "/audit", headers=head).json()["items"]
    assert [entry["action"] for entry in entries[:2]] == ["session.end", "session.begin"]
    token = browser.cookie.partition("=")[2].encode()
    assert not any(token in file.read_bytes() for file in tmp_path.iterdir() if file.is_file())


def test_no_get_takes_an_action_unless_a_key_is_in_its_header(start: StartService) -> None:
    service = start()
    service.with_robot("r1")
    action = {"id": "r-1:2", "name": "start_node", "parameters": ["rviz"], "timeout_s": 5.0, "host": "pc"}
    service.repairs.queue["r1"] = action
    refused = service.api("GET", "/robots/r1/actions/next")
    assert (refused.status_code, refused.headers["allow"]) == (405, "POST")
    key = service.key("robot", "r1")
    cookie = sign_in(service, key).headers["set-cookie"].partition(";")[0]
    head = {"Cookie": cookie, "Origin": service.url}
    assert service.api("GET", "/robots/r1/actions/next", headers=head).status_code == 405
    taken = service.api("GET", "/robots/r1/actions/next", headers={"Authorization": f"Bearer {key}"})
    assert taken.json() == action
    assert taken.headers["deprecation"] == "true"
