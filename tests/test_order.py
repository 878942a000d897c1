"""What takes long is begun first, and by different workers."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from tests import order
from tests.order import LONG, ROOT, dealt, load


def found_in(**files: int) -> list[Any]:
    """Return so many tests of each file, in the order in which pytest finds them."""
    return [
        SimpleNamespace(path=ROOT / name.replace("__", "/"), number=number)
        for name, count in sorted(files.items())
        for number in range(count)
    ]


def test_what_is_named_is_there() -> None:
    assert [name for name in LONG if not (ROOT / name).exists()] == []


def test_each_piece_begins_with_what_takes_long_and_none_is_lost() -> None:
    found = found_in(board=40, web=3, **{"test_tutorial.py": 1, "drills": 5, "model": 10})
    pieces: list[Any] = list(dealt(found, 2))
    assert sorted(map(id, pieces)) == sorted(map(id, found))
    half = len(found) // 2
    names = [Path(one.path).name for one in pieces]
    assert names[0] == "test_tutorial.py"
    assert set(names[1:half]) == {"board"}
    assert names[half : half + 8] == ["web"] * 3 + ["drills"] * 5
    assert [one.number for one in pieces if one.path.name == "board"] == list(range(40))


def test_a_piece_is_longer_than_the_others_where_all_of_it_takes_long() -> None:
    found = found_in(web=9, model=1)
    assert len(dealt(found, 2)) == 10
    assert {one.path.name for one in dealt(found, 2)[:1]} == {"web"}


def test_each_worker_begins_to_load_elsewhere_and_loads_all_that_is_asked_for(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    loaded: list[str] = []

    def importing(name: str) -> None:
        loaded.append(name)
        raise SyntaxError("pytest says so when it comes to this module")

    monkeypatch.setattr(order, "import_module", importing)
    asked = [str(ROOT / "board"), str(ROOT / "web" / "test_pages.py::test_one")]
    wanted = [f"tests.board.{file.stem}" for file in sorted((ROOT / "board").glob("test_*.py"))]
    wanted.append("tests.web.test_pages")
    begun = []
    for number in range(3):
        loaded.clear()
        load(asked, number, 3)
        assert sorted(loaded) == wanted
        begun.append(loaded[0])
    assert len(set(begun)) == 3
