"""What a client has already is not sent again, HEAD is GET without a body, the root says what there is."""

from __future__ import annotations

import httpx
import pytest
from tests.api.conftest import Service, StartService

from robomend.security import RULES


@pytest.fixture(autouse=True, scope="module")
def _robot(service: Service) -> None:
    service.with_robot("r1")
    service.observe("ok(scan)")


@pytest.mark.parametrize(
    "path", ["/robots", "/robots/r1", "/models/tedusar", "/robots/r1/observations", "/stop"]
)
def test_an_answer_that_the_client_has_is_a_304(service: Service, path: str) -> None:
    first = service.api("GET", path)
    again = service.api("GET", path, headers={"If-None-Match": first.headers["etag"]})
    assert (again.status_code, again.content) == (304, b"")
    assert again.headers["etag"] == first.headers["etag"]
    assert "content-type" not in again.headers
    weak = service.api("GET", path, headers={"If-None-Match": f'"x", W/{first.headers["etag"]}'})
    assert weak.status_code == 304
    other = service.api("GET", path, headers={"If-None-Match": '"x"'})
    assert other.json() == first.json()


def test_the_openapi_document_tells_of_names_where_there_are_some(service: Service) -> None:
    paths = service.http.get("/openapi.json").json()["paths"]
    gets = {path: operations["get"]["responses"] for path, operations in paths.items() if "get" in operations}
    told = {path for path, answers in gets.items() if "304" in answers}
    assert told == {path for path, answers in gets.items() if "ETag" in answers["200"].get("headers", {})}
    for path in ("/api/v1/robots", "/api/v1/stop", "/healthz", "/readyz"):
        answer = service.http.get(path)
        assert answer.status_code == 200
        assert ("etag" in answer.headers) == (path in told), path


def test_news_is_no_304(service: Service) -> None:
    service.with_robot("news")
    before = service.api("GET", "/robots/news/observations").headers["etag"]
    service.observe("not ok(map)", robot="news")
    after = service.api("GET", "/robots/news/observations", headers={"If-None-Match": before})
    assert after.status_code == 200
    assert after.headers["etag"] != before


def test_a_robot_is_replaced_by_the_version_of_its_configuration_alone(service: Service) -> None:
    service.with_robot("put")
    read = service.api("GET", "/robots/put").headers["etag"]
    service.observe("not ok(map)", robot="put")

    def put(etag: str, hold_s: float) -> httpx.Response:
        body = {"model": "tedusar", "hold_s": hold_s}
        return service.api("PUT", "/robots/put", json=body, headers={"If-Match": etag})

    first = put(read, 1.0)
    assert first.status_code == 200  # how the robot is has changed, what is replaced has not
    assert put(read, 2.0).status_code == 412
    assert put(first.headers["etag"], 2.0).status_code == 200
    bare = service.api("GET", "/robots/put").json()["etag"]
    assert put(f'"{bare}"', 3.0).status_code == 200
    stale = service.api("DELETE", "/robots/put", headers={"If-Match": read})
    assert stale.status_code == 412
    now = service.api("GET", "/robots/put").headers["etag"]
    service.observe("ok(map)", robot="put")
    assert service.api("DELETE", "/robots/put", headers={"If-Match": now}).status_code == 204


def test_errors_have_no_version(service: Service) -> None:
    missing = service.api("GET", "/robots/nobody", headers={"If-None-Match": "*"})
    assert missing.status_code == 404
    assert "etag" not in missing.headers


@pytest.mark.parametrize("path", ["/robots", "/robots/r1/diagnosis", "/stop", ""])
def test_head_is_get_without_a_body(service: Service, path: str) -> None:
    got, head = service.api("GET", path), service.api("HEAD", path)
    assert (head.status_code, head.content) == (got.status_code, b"")
    for name in ("content-type", "etag", "cache-control"):
        assert head.headers.get(name) == got.headers.get(name)


@pytest.mark.parametrize("path", ["/events", "/robots/r1/events", "/robots/r1/actions/next"])
def test_what_has_no_end_or_an_effect_has_no_head(service: Service, path: str) -> None:
    assert service.api("HEAD", path).status_code == 405


def test_head_is_let_in_as_get_is(start: StartService) -> None:
    service = start()
    service.key("admin")
    assert service.api("HEAD", "/robots").status_code == 401


def test_what_is_read_may_be_kept_but_is_asked_for_again(service: Service) -> None:
    assert service.api("GET", "/robots").headers["cache-control"] == "private, no-cache"
    assert service.api("GET", "/robots/r1/diagnosis").headers["cache-control"] == "no-store"


def test_the_root_says_what_there_is(service: Service) -> None:
    root = service.api("GET", "").json()
    assert root["name"] == "robomend"
    links = {(one["method"], one["path"]) for one in root["operations"]}
    assert links == {rule for rule in RULES if rule[1].startswith("/api/v1")}
    assert root["openapi"] == "/openapi.json"


def test_the_root_shows_a_key_what_it_may(start: StartService) -> None:
    service = start()
    head = {"Authorization": f"Bearer {service.key('viewer')}"}
    operations = service.api("GET", "", headers=head).json()["operations"]
    paths = {(one["method"], one["path"]) for one in operations}
    assert ("GET", "/api/v1/robots") in paths
    assert ("POST", "/api/v1/stop") not in paths
    assert ("GET", "/api/v1/audit") not in paths


def test_a_key_is_told_how_many_requests_it_has_left(start: StartService) -> None:
    service = start(requests_per_s=0.05, burst=5)  # none comes back while we look
    answers = [service.api("GET", "/robots", headers={}) for _ in range(2)]
    assert answers[0].headers["ratelimit-policy"] == '"key";q=5;w=100'
    left = [int(answer.headers["ratelimit"].partition("r=")[2].partition(";")[0]) for answer in answers]
    assert left[1] < left[0] < 5
