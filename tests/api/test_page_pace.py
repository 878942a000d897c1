"""How soon open pages may ask again."""

from __future__ import annotations

import heapq

import pytest
from tests.api.conftest import Service

from robomend.api.page_route import PER_S, PagePace


@pytest.mark.parametrize(("pages", "asked_per_s"), [(1, 5.0), (3, 15.0), (50, PER_S), (500, PER_S)])
def test_all_pages_together_ask_no_more_than_is_said(pages: int, asked_per_s: float) -> None:
    """Each wants to ask five times a second, and waits longer where it is told to."""
    pace, seconds, asked = PagePace(), 200.0, 0
    turns = [0.0] * pages
    while turns[0] < seconds:
        now_s = heapq.heappop(turns)
        asked += 1
        heapq.heappush(turns, now_s + max(0.2, pace.again_s(now_s)))
    assert asked / seconds == pytest.approx(asked_per_s, rel=0.15)


def test_after_a_quiet_while_a_page_waits_for_nobody() -> None:
    pace = PagePace()
    for _ in range(100):
        pace.again_s(0.0)
    assert pace.again_s(60.0) == pytest.approx(1 / PER_S)


def test_an_answer_with_parts_says_when_to_ask_again(service: Service) -> None:
    asked = service.http.get("/", headers={"Robomend-Parts": "fleet"})
    assert float(asked.headers["robomend-again-ms"]) > 0
    assert "robomend-again-ms" not in service.http.get("/").headers
