"""Pages are made in slices: robots go first, one page after another, and no page waits without end."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Iterator
from itertools import count

import pytest

from robomend.api import page_turns
from robomend.api.page_turns import PageTurns


@pytest.fixture(autouse=True)
def every_piece_is_a_slice(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(page_turns, "SLICE_S", 0.0)


def told(what: str, log: list[str], pieces: int = 3) -> Iterator[str]:
    for number in range(pieces):
        log.append(what)
        yield f"{what}{number}"


async def made(turns: PageTurns, what: str, log: list[str]) -> str:
    async with turns.turn() as turn:
        return await turn.joined(told(what, log))


def test_a_page_is_whole_and_others_run_between_its_pieces() -> None:
    log: list[str] = []

    async def other() -> None:
        while log.count("page") < 3:
            log.append("other")
            await asyncio.sleep(0)

    async def both() -> str:
        beside = asyncio.create_task(other())
        text = await made(PageTurns(lambda: 0), "page", log)
        await beside
        return text

    assert asyncio.run(both()) == "page0page1page2"
    first, last = log.index("page"), len(log) - 1 - log[::-1].index("page")
    assert "other" in log[first:last]


def test_pages_are_made_one_after_another() -> None:
    log: list[str] = []

    async def both() -> None:
        turns = PageTurns(lambda: 0)
        await asyncio.gather(made(turns, "a", log), made(turns, "b", log))

    asyncio.run(both())
    assert log == ["a"] * 3 + ["b"] * 3


def test_a_page_waits_while_a_batch_is_under_way_and_goes_on_after_it(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(page_turns, "MOST_S", 60.0)
    log: list[str] = []
    left = iter([2, 1, 1])

    def under_way() -> int:
        found = next(left, 0)
        log.append(f"asked {found}")
        return found

    asyncio.run(made(PageTurns(under_way), "page", log))
    assert log[:5] == ["asked 2", "asked 1", "asked 1", "asked 0", "page"]


def test_of_many_pages_that_ask_together_a_few_come_at_once_and_the_others_apart(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    now_s = 100.0
    waited: list[float] = []

    async def sleep(seconds: float) -> None:
        if seconds > 1e-6:
            waited.append(seconds)

    async def ask(turns: PageTurns, pages: int) -> list[float]:
        waited.clear()
        for _ in range(pages):
            await turns.apart()
        return [round(one / page_turns.APART_S, 3) for one in waited]

    monkeypatch.setattr(time, "monotonic", lambda: now_s)
    monkeypatch.setattr(asyncio, "sleep", sleep)
    turns, few = PageTurns(lambda: 0), page_turns.AT_ONCE
    assert asyncio.run(ask(turns, few)) == []
    assert asyncio.run(ask(turns, 3)) == [1, 2, 3]
    now_s += 60  # a quiet while
    assert asyncio.run(ask(turns, few + 1)) == [1]
    asyncio.run(ask(turns, 1000))
    assert max(waited) < page_turns.LONGEST_S


def test_a_page_comes_however_busy_robots_are(monkeypatch: pytest.MonkeyPatch) -> None:
    # The clock ticks with each look at it, so that nothing here depends on how fast the machine is.
    ticks = count()
    monkeypatch.setattr(time, "perf_counter", lambda: next(ticks) * 0.001)
    log: list[str] = []
    assert asyncio.run(made(PageTurns(lambda: 1), "page", log)) == "page0page1page2"
