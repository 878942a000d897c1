"""What tests do to this computer's network, and who waits for whom."""

from __future__ import annotations

import threading
from collections.abc import Callable
from contextlib import AbstractContextManager
from pathlib import Path

import pytest
from tests import network


class Wanted:
    """Somebody who wants the network in a certain way, and has it until told to let it go."""

    def __init__(self, way: Callable[[], AbstractContextManager[None]]) -> None:
        self.got, self._let_go = threading.Event(), threading.Event()
        self._way = way
        self._thread = threading.Thread(target=self._have, daemon=True)
        self._thread.start()

    def _have(self) -> None:
        with self._way():
            self.got.set()
            self._let_go.wait(30)

    def let_go(self) -> None:
        """Return when it is free again."""
        self._let_go.set()
        self._thread.join(30)


@pytest.fixture(autouse=True)
def apart(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Not the locks that tests beside this one wait for."""
    for name in ("NETWORK", "NEXT"):
        (tmp_path / name).touch()
        monkeypatch.setattr(network, name, tmp_path / name)


def waits(wanted: Wanted) -> bool:
    """Whether it still has nothing after a while."""
    return not wanted.got.wait(0.2)


def test_pages_share_a_still_network_and_a_change_waits_for_all_of_them() -> None:
    pages = [Wanted(network.still) for _ in range(2)]
    assert all(page.got.wait(30) for page in pages)
    change = Wanted(network.changing)
    assert waits(change)
    pages[0].let_go()
    assert waits(change)
    pages[1].let_go()
    assert change.got.wait(30)
    change.let_go()


def test_a_page_waits_for_a_change_that_waits_so_that_pages_cannot_go_on_for_ever() -> None:
    first = Wanted(network.still)
    assert first.got.wait(30)
    change = Wanted(network.changing)
    assert waits(change)
    second = Wanted(network.still)
    assert waits(second)
    first.let_go()
    assert change.got.wait(30)
    assert waits(second)
    change.let_go()
    assert second.got.wait(30)
    second.let_go()
