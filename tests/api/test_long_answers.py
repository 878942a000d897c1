"""Answers that may be long are written beside the event loop."""

from __future__ import annotations

import threading
from typing import Any, ClassVar

import pytest
from tests.api.conftest import TEDUSAR, Service

from robomend.api import views


@pytest.fixture
def writers(monkeypatch: pytest.MonkeyPatch) -> set[threading.Thread]:
    """The threads that have written JSON."""
    found: set[threading.Thread] = set()

    def noted(function: Any) -> Any:
        def wrapper(*given: Any) -> Any:
            found.add(threading.current_thread())
            return function(*given)

        return wrapper

    for name in ("_text", "result_text"):
        monkeypatch.setattr(views, name, noted(getattr(views, name)))
    return found


async def this_thread() -> threading.Thread:
    return threading.current_thread()


PAGES = ("/robots/long/history", "/robots/long/history?kind=diagnosis", "/audit", "/repairs")


def test_long_answers_are_written_in_threads(service: Service, writers: set[threading.Thread]) -> None:
    service.with_robot("long")
    service.observe("not ok(scan)", robot="long")
    loop = service.run(this_thread())
    asked = {"source": TEDUSAR, "observations": ["not ok(scan)"]}
    for method, path, body in (
        *(("GET", page, None) for page in PAGES),
        ("POST", "/diagnoses", asked),
        ("POST", "/plans", asked),
    ):
        writers.clear()
        assert service.api(method, path, json=body).status_code == 200
        assert writers
        assert loop not in writers


class Large:
    """Says which thread frees it."""

    freed_by: ClassVar[list[threading.Thread]] = []

    def __del__(self) -> None:
        self.freed_by.append(threading.current_thread())


@pytest.mark.anyio
async def test_what_a_long_value_was_made_of_is_freed_in_the_thread_that_wrote_it() -> None:
    Large.freed_by.clear()
    given: list[Any] = [Large()]
    await views.value_response(lambda large: [type(large).__name__], given)
    assert given == []
    [freed_by] = Large.freed_by
    assert freed_by is not threading.current_thread()
