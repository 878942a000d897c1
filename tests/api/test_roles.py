"""Every route × every role, against the table; and what keys open and do not."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import httpx
import pytest
from tests.api.conftest import Service, StartService, running, sign_in

from robomend.api.app import routes
from robomend.security import OWN, RULES, Role, digest, loopback, new_key
from robomend.settings import Settings
from robomend.store import api_keys

PLACES = {
    "name": "tedusar",
    "robot": "r1",
    "repair": "r-1",
    "change": "c-1",
    "drill": "d-1",
    "moment": "m-1",
    "batch": "b-1",
    "action": "r-1:0",
    "assertion": "a",
    "channel": "3",
    "component": "jaguar",
    "key": "k-1",
    "recipient": "duty",
    "file": "start.js",
    "version": "1",
    "report": "suite-first",
    "plot": "suite-first.svg",
}

SIGN_OUT = ("DELETE", "/api/v1/session")

STREAMS = {"/api/v1/events", "/api/v1/robots/{robot}/events"}


class Keyed:
    """A service with one key for each role, the robot's for r1."""

    def __init__(self, service: Service) -> None:
        self.service = service
        service.with_robot("r1")
        service.with_robot("r2")
        service.repairs.owners.update({"r-1:0": "r1", "r-2:0": "r2"})
        self.keys = {role: service.key(role, "r1" if role is Role.ROBOT else None) for role in Role}
        self._cookies: dict[Role, str] = {}

    def ask(self, method: str, path: str, role: Role | None, way: str = "key") -> int:
        """Return the status of a request; of a stream, only its head is read."""
        if role is None:
            headers = {}
        elif way == "key":
            headers = {"Authorization": f"Bearer {self.keys[role]}"}
        else:
            headers = {"Cookie": self._signed_in(role), "Origin": self.service.url}
            if (method, path) == SIGN_OUT:
                del self._cookies[role]
        with self.service.http.stream(method, path, headers=headers) as answer:
            return answer.status_code

    def _signed_in(self, role: Role) -> str:
        if role not in self._cookies:
            answer = sign_in(self.service, self.keys[role])
            self._cookies[role] = answer.headers["set-cookie"].partition(";")[0]
        return self._cookies[role]


@pytest.fixture(scope="module")
def keyed(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Keyed]:
    data = tmp_path_factory.mktemp("keyed")
    with running(Settings(port=0, data=data, sign_ins_per_minute=1e6)) as service:
        yield Keyed(service)


def test_every_route_is_in_the_table_and_no_other(keyed: Keyed) -> None:
    there = {
        (method, route.path_format)
        for route in routes(keyed.service.runtime.app)
        for method in route.methods or ()
    }
    assert there == RULES.keys()


@pytest.mark.parametrize("way", ["key", "cookie"])
def test_roles_decide_who_may(keyed: Keyed, way: str) -> None:
    wrong = {}
    for (method, template), roles in RULES.items():
        for role in (None, *Role):
            status = keyed.ask(method, template.format(**PLACES), role, way)
            if roles is None:  # EVERYONE
                right = status not in {401, 403}
            elif role is None:
                right = status == 401
            elif role in roles:
                right = status not in {401, 403, 500}
            else:
                right = status == 403
            if not right:
                wrong[method, template, role] = status
    assert wrong == {}


def test_a_robots_key_opens_no_other_robot(keyed: Keyed) -> None:
    headers = {"Authorization": f"Bearer {keyed.keys[Role.ROBOT]}"}
    opened = {}
    for (method, template), roles in RULES.items():
        about_one = "{robot}" in template or "{action}" in template
        if roles and roles & OWN and about_one:
            path = template.format(**{**PLACES, "robot": "r2", "action": "r-2:0"})
            answer = keyed.service.http.request(method, path, headers=headers, json={"code": 0})
            if answer.status_code not in {403, 404}:
                opened[method, template] = answer.status_code
    assert opened == {}


def test_a_revoked_or_unknown_key_opens_nothing(keyed: Keyed) -> None:
    for text in ("", "Bearer", "Bearer x", f"Bearer {new_key()}", f"Basic {keyed.keys[Role.ADMIN]}"):
        answer = keyed.service.http.get("/api/v1/robots", headers={"Authorization": text})
        assert answer.status_code == 401
        assert answer.headers["www-authenticate"].startswith("Bearer")


def test_revoking_the_last_key_does_not_open_the_door(start: StartService) -> None:
    service = start()
    key = service.key("admin")
    head = {"Authorization": f"Bearer {key}"}
    assert service.api("GET", "/robots", headers=head).status_code == 200
    found = service.run(service.runtime.store.read(api_keys.every))
    service.run(service.runtime.store.write(lambda tx: api_keys.revoke(tx, found[0].id) and None))
    service.runtime.app.state.gate.ring.forget()
    assert service.api("GET", "/robots", headers=head).status_code == 401
    assert service.api("GET", "/robots").status_code == 401


def test_only_the_hash_of_a_key_is_stored(start: StartService, tmp_path: Path) -> None:
    service = start()
    key = service.key("viewer")
    stored = service.run(service.runtime.store.read(api_keys.every))
    assert stored[0].hash == digest(key)
    assert not any(key.encode() in file.read_bytes() for file in tmp_path.iterdir() if file.is_file())


def test_without_keys_a_foreign_host_name_is_refused(start: StartService) -> None:
    """DNS rebinding: a page's own name may point at 127.0.0.1, but its Host header tells."""
    service = start(allowed_hosts=("robot.lan",))
    for host, status in (
        ("evil.example", 421),
        ("robot.lan:8600", 200),
        ("localhost", 200),
        ("[::1]:1", 200),
        ("LOCALHOST:8600", 200),
        ("localhost@evil.example:1", 421),
    ):
        assert service.api("GET", "/robots", headers={"Host": host}).status_code == status


def test_a_change_from_another_origin_is_refused(service: Service) -> None:
    def put(**headers: str) -> httpx.Response:
        return service.api("POST", "/stop", json={}, headers=headers)

    assert put(Origin="https://evil.example").json()["code"] == "cross-origin"
    assert put(Origin="null").status_code == 403
    assert put(Origin=service.url.replace("http:", "https:")).is_success  # a proxy that ends TLS
    assert put(**{"Sec-Fetch-Site": "cross-site"}).status_code == 403
    assert put(Origin=service.url).is_success
    assert put().is_success


@pytest.mark.parametrize("headers", [{"Origin": "https://evil.example"}, {"Sec-Fetch-Site": "cross-site"}])
@pytest.mark.parametrize("path", ["/robots", "/robots/r1/actions/next", "/events", "/stop", "/audit"])
def test_without_keys_a_page_of_another_origin_is_told_nothing(
    service: Service, path: str, headers: dict[str, str]
) -> None:
    answer = service.api("GET", path, headers=headers)
    assert (answer.status_code, answer.json()["code"]) == (403, "cross-origin")


def test_without_keys_the_person_at_this_computer_and_its_own_page_are_answered(service: Service) -> None:
    for headers in ({}, {"Sec-Fetch-Site": "none"}, {"Origin": service.url, "Sec-Fetch-Site": "same-origin"}):
        assert service.api("GET", "/robots", headers=headers).status_code == 200


def test_loopback_is_known() -> None:
    assert all(map(loopback, ("127.0.0.1", "::1", "localhost", "127.8.9.1", "[::1]")))
    assert not any(map(loopback, ("0.0.0.0", "::", "10.0.0.1", "example.org", "")))
