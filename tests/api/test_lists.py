"""Every list has a link to its next page, and comes as NDJSON for who asks."""

from __future__ import annotations

import json
from collections.abc import Iterator
from typing import Any
from urllib.parse import urljoin

import httpx
import pytest
from tests.api.conftest import Service
from tests.waiting import until

from robomend.api.app import routes
from robomend.api.lists import is_list

NDJSON = {"Accept": "application/x-ndjson"}

REASON = 'a "quoted" word, \\n and ,"next":"x"}'


@pytest.fixture(autouse=True, scope="module")
def _robots(service: Service) -> None:
    for number in range(5):
        service.with_robot(f"r{number}")
    for sentence in ("ok(scan)", "not ok(scan)", "not ok(map)", "ok(map)"):
        service.observe(sentence, robot="r0")
    service.api("POST", "/stop", json={"reason": REASON})
    until(lambda: service.api("GET", "/stop").json()["written"], "the stop is in the audit log", 60)


def lines(answer: httpx.Response) -> list[Any]:
    assert answer.status_code == 200, answer.text
    assert answer.headers["content-type"] == "application/x-ndjson"
    assert answer.text == "" or answer.text.endswith("\n")
    return [json.loads(line) for line in answer.text.split("\n")[:-1]]


def pages(service: Service, path: str, **options: Any) -> Iterator[httpx.Response]:
    """Yield the pages of a list, each by the link of the one before."""
    url: str | None = f"/api/v1{path}"
    while url is not None:
        page = service.http.get(url, **options)
        yield page
        following = page.links.get("next", {}).get("url")
        url = None if following is None else urljoin(str(page.url), following)


@pytest.mark.parametrize(
    "path",
    [
        "/models",
        "/models/tedusar/versions",
        "/robots",
        "/robots/r0/history",
        "/robots/r0/history?kind=diagnosis",
        "/robots/r0/history?kind=repair",
        "/robots/r0/repairs",
        "/robots/r0/drills",
        "/robots/r0/sovd/components",
        "/repairs",
        "/batches",
        "/audit?action=robot.put",
        "/audit",
        "/notifications",
    ],
)
def test_a_list_has_the_same_items_as_ndjson_and_as_json(service: Service, path: str) -> None:
    whole = service.api("GET", path).json()["items"]
    assert lines(service.api("GET", path, headers=NDJSON)) == whole
    if "/sovd/" in path:  # those come whole
        return
    limited = f"{path}{'&' if '?' in path else '?'}limit=2"
    assert [item for page in pages(service, limited) for item in page.json()["items"]] == whole
    assert [item for page in pages(service, limited, headers=NDJSON) for item in lines(page)] == whole


def test_the_lists_of_this_test_are_not_all_empty(service: Service) -> None:
    reasons = [entry["reason"] for entry in lines(service.api("GET", "/audit", headers=NDJSON))]
    assert REASON in reasons
    assert len(list(pages(service, "/robots?limit=2"))) == 3
    assert len(list(pages(service, "/robots/r0/history?limit=3", headers=NDJSON))) == 2


def test_the_link_keeps_what_was_asked_for_and_ends_with_the_list(service: Service) -> None:
    page = service.api("GET", "/audit", params={"limit": 2, "action": "robot.put", "cursor": "9999"})
    assert page.json()["next"] is not None
    link = httpx.URL(page.links["next"]["url"])
    assert link.path == "/api/v1/audit"
    assert dict(link.params) == {"limit": "2", "action": "robot.put", "cursor": page.json()["next"]}
    assert "link" not in service.api("GET", "/audit", params={"limit": 1000}).headers


@pytest.mark.parametrize(
    ("accept", "media_type"),
    [
        (None, "application/json"),
        ("application/x-ndjson, application/json", "application/json"),
        ("application/x-ndjson;q=0.6, application/json;q=0.5", "application/x-ndjson"),
        ("application/x-ndjson, */*;q=0.1", "application/x-ndjson"),
        ("Application/X-NDJSON ; Q=0.7 , */*;q=0.1", "application/x-ndjson"),
        ("application/x-ndjson;q=0, */*", "application/json"),
        ("*/*;q=0.9, application/json;q=0.3", "application/x-ndjson"),
        ("application/json;q=2, application/x-ndjson;q=much", "application/json"),
        (", ;, application/x-ndjson;q=1.000", "application/x-ndjson"),
    ],
)
def test_json_comes_unless_ndjson_is_wanted_more(
    service: Service, accept: str | None, media_type: str
) -> None:
    headers = {} if accept is None else {"Accept": accept}
    answer = service.api("GET", "/robots", headers=headers)
    assert answer.headers["content-type"] == media_type
    assert answer.headers["vary"] == "Accept"


def test_a_page_as_ndjson_has_a_version_of_its_own(service: Service) -> None:
    page = {"limit": 2}
    first = service.api("GET", "/robots", params=page, headers=NDJSON)
    assert first.headers["etag"] != service.api("GET", "/robots", params=page).headers["etag"]
    asked = {**NDJSON, "If-None-Match": first.headers["etag"]}
    again = service.api("GET", "/robots", params=page, headers=asked)
    assert (again.status_code, again.content) == (304, b"")
    assert again.headers["link"] == first.headers["link"]
    head = service.api("HEAD", "/robots", params=page, headers=NDJSON)
    assert head.headers["content-type"] == "application/x-ndjson"


@pytest.mark.parametrize(("path", "status"), [("/robots?cursor=%00", 422), ("/robots/none/history", 404)])
def test_an_error_is_a_problem_whatever_is_asked_for(service: Service, path: str, status: int) -> None:
    answer = service.api("GET", path, headers=NDJSON)
    assert answer.status_code == status
    assert answer.headers["content-type"] == "application/problem+json"


def test_what_is_no_list_stays_json(service: Service) -> None:
    answer = service.api("GET", "/robots/r0", headers=NDJSON)
    assert answer.headers["content-type"] == "application/json"
    assert "link" not in answer.headers


def test_the_document_says_so_of_every_list(service: Service) -> None:
    document = service.http.get("/openapi.json").json()
    lists = {route.path_format for route in routes(service.runtime.app) if is_list(route.response_model)}
    assert "/api/v1/repairs" in lists
    for path, operations in document["paths"].items():
        answer = operations.get("get", {}).get("responses", {}).get("200", {})
        linked = "Link" in answer.get("headers", {})
        named = list(answer.get("content", {})) == ["application/json", "application/x-ndjson"]
        assert linked == named == (path in lists), path
