"""Answers that may be long are written beside the event loop, and say the same."""

from __future__ import annotations

import threading
from typing import Any, ClassVar

import pytest
from tests.api.conftest import TEDUSAR, Service

from robomend.api import long_json


@pytest.fixture
def writers(monkeypatch: pytest.MonkeyPatch) -> set[threading.Thread]:
    """The threads that have written JSON."""
    found: set[threading.Thread] = set()

    def noted(function: Any) -> Any:
        def wrapper(value: Any) -> Any:
            found.add(threading.current_thread())
            return function(value)

        return wrapper

    for name in ("_text", "_long_result"):
        monkeypatch.setattr(long_json, name, noted(getattr(long_json, name)))
    return found


async def this_thread() -> threading.Thread:
    return threading.current_thread()


PAGES = ("/robots/long/history", "/robots/long/history?kind=diagnosis", "/audit", "/repairs")


def test_pages_of_lists_are_written_where_they_are_read(
    service: Service, writers: set[threading.Thread]
) -> None:
    service.with_robot("long")
    service.observe("not ok(scan)", robot="long")
    loop = service.run(this_thread())
    for path in PAGES:
        writers.clear()
        assert service.api("GET", path).json().keys() == {"items", "next"}
        assert writers
        assert loop not in writers


def test_a_long_result_says_the_same_as_a_short_one(
    service: Service, monkeypatch: pytest.MonkeyPatch, writers: set[threading.Thread]
) -> None:
    asked = {"source": TEDUSAR, "observations": ["not ok(scan)"]}
    loop = service.run(this_thread())

    def answer() -> Any:
        value = service.api("POST", "/diagnoses", json=asked, timeout=60).json()
        del value["elapsed_s"]
        return value

    short = answer()
    assert writers == {loop}
    writers.clear()
    monkeypatch.setattr(long_json, "SHORT", 0)
    assert answer() == short
    assert writers
    assert loop not in writers


@pytest.mark.anyio
async def test_a_value_of_many_names_is_written_in_a_thread(writers: set[threading.Thread]) -> None:
    short = await long_json.value_response(dict, [{"gerät": [1]}], long_json.SHORT)
    assert writers == {threading.current_thread()}
    writers.clear()
    long = await long_json.value_response(dict, [{"gerät": [1]}], long_json.SHORT + 1)
    assert long.body == short.body == '{"gerät":[1]}'.encode()
    assert threading.current_thread() not in writers


class Large:
    """Says which thread frees it."""

    freed_by: ClassVar[list[threading.Thread]] = []

    def __del__(self) -> None:
        self.freed_by.append(threading.current_thread())


@pytest.mark.anyio
async def test_what_a_long_value_was_made_of_is_freed_in_the_thread_that_wrote_it() -> None:
    Large.freed_by.clear()
    given: list[Any] = [Large()]
    await long_json.value_response(lambda large: [type(large).__name__], given, long_json.SHORT + 1)
    assert given == []
    [freed_by] = Large.freed_by
    assert freed_by is not threading.current_thread()
