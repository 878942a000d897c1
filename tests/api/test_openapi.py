"""The OpenAPI document is complete and true: fuzzed by schemathesis, and its page asks nobody else."""

from __future__ import annotations

import re
from collections.abc import Iterator
from typing import Any

import pytest
from hypothesis import HealthCheck, Phase, given, settings
from hypothesis import strategies as st
from tests.api.conftest import TEDUSAR, Service, running

from robomend.api.routers.docs import FILES, PAGE

STREAMS = {"/api/v1/events", "/api/v1/robots/{robot}/events"}
SHORT, LONG = 6, 600
"""Cases for each operation; 42 operations make 20,000 and more of the long one."""


@pytest.fixture(scope="module")
def fuzzed(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Service]:
    from robomend.settings import Settings

    values = {"port": 0, "data": tmp_path_factory.mktemp("fuzz"), "max_wait_s": 0.05, "solver_timeout_s": 0.5}
    with running(Settings.model_validate(values)) as service:
        service.with_robot("tedusar-1")
        service.api("PUT", "/models/tedusar", json={"source": TEDUSAR})
        yield service


def test_every_operation_is_described(fuzzed: Service) -> None:
    document = fuzzed.http.get("/openapi.json").json()
    assert document["openapi"].startswith("3.1")
    tags = {tag["name"] for tag in document["tags"]}
    for path, operations in document["paths"].items():
        for method, operation in operations.items():
            where = f"{method} {path}"
            assert operation["summary"], where
            assert operation["description"], where
            assert set(operation["tags"]) <= tags, where
            errors = {status for status in operation["responses"] if status[0] in "45"}
            assert errors >= {"401", "403", "422", "429", "503"}, where
            for status in errors - {"503"}:
                assert list(operation["responses"][status]["content"]) == ["application/problem+json"], where


@pytest.mark.timeout(5400)  # the long version
def test_no_answer_is_a_server_error_or_undocumented(fuzzed: Service, long: bool) -> None:
    # Here, and not its plugin (pyproject.toml): to load it takes a second, in each process that runs tests.
    import schemathesis
    from schemathesis.checks import load_all_checks, not_a_server_error
    from schemathesis.core.result import Ok
    from schemathesis.specs.openapi.checks import (
        content_type_conformance,
        response_schema_conformance,
        status_code_conformance,
    )

    load_all_checks()
    checks = [
        not_a_server_error,
        status_code_conformance,
        content_type_conformance,
        response_schema_conformance,
    ]
    document = fuzzed.http.get("/openapi.json").json()
    for path in STREAMS:
        del document["paths"][path]  # endless: tests/api/test_events.py
    schema = schemathesis.openapi.from_dict(document)
    for found in schema.get_all_operations():
        assert isinstance(found, Ok), found
        operation = found.ok()

        @settings(
            max_examples=LONG if long else SHORT,
            deadline=None,
            derandomize=not long,
            database=None,
            phases=[Phase.generate],
            suppress_health_check=list(HealthCheck),
        )
        @given(case=st.one_of(operation.as_strategy()))
        def fuzz(case: schemathesis.Case[Any]) -> None:
            answer = case.call(base_url=fuzzed.url, timeout=60)  # a busy computer is no fault of the service
            case.validate_response(answer, checks=checks)

        fuzz()
    assert fuzzed.http.get("/readyz").json()["ready"]


def test_the_docs_page_asks_no_other_host(fuzzed: Service) -> None:
    page = fuzzed.http.get("/docs")
    assert page.text == PAGE
    assert "default-src 'self'" in page.headers["content-security-policy"]
    wanted = re.findall(r'(?:src|href)="([^"]+)"', PAGE)
    assert [place for place in wanted if "//" in place] == []
    for place in wanted:
        if not place.startswith("data:"):
            answer = fuzzed.http.get(f"/{place}")
            assert answer.status_code == 200
            assert len(answer.content) > 100
    assert fuzzed.http.get("/docs/../gate.py").status_code == 404
    assert fuzzed.http.get("/docs/passwd").status_code == 404


def test_the_page_starts_on_our_document_and_no_validator() -> None:
    start = FILES["start.js"].path.read_text()
    assert 'url: "openapi.json"' in start
    assert "validatorUrl: null" in start
    assert "http" not in start
