"""Numbers with what they count."""

from __future__ import annotations

import pytest

from robomend_client.counts import counted


@pytest.mark.parametrize(
    ("count", "said"),
    [(0, "0 logs"), (1, "1 log"), (2, "2 logs"), (1200, "1,200 logs")],
)
def test_one_thing_is_not_many(count: int, said: str) -> None:
    assert counted(count, "log") == said


def test_what_takes_more_than_an_s_is_given() -> None:
    assert [counted(n, "stretch", "stretches") for n in (1, 3)] == ["1 stretch", "3 stretches"]
