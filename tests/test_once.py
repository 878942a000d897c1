"""What workers share is made once, and again if it could not be made."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest
from tests.once import made_once


def test_who_needs_it_at_the_same_time_waits_for_the_first(
    tmp_path_factory: pytest.TempPathFactory, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delenv("PYTEST_XDIST_WORKER", raising=False)
    made: list[Path] = []

    def make(folder: Path) -> None:
        made.append(folder)
        (folder / "page").write_text("it is whole")

    def read(_: int) -> str:
        return (made_once(tmp_path_factory, "together", make) / "page").read_text()

    with ThreadPoolExecutor(4) as others:
        assert set(others.map(read, range(8))) == {"it is whole"}
    assert len(made) == 1


def test_what_could_not_be_made_is_tried_again_from_nothing(
    tmp_path_factory: pytest.TempPathFactory, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delenv("PYTEST_XDIST_WORKER", raising=False)

    def fail(folder: Path) -> None:
        (folder / "half").touch()
        raise ZeroDivisionError

    with pytest.raises(ZeroDivisionError):
        made_once(tmp_path_factory, "twice", fail)
    assert list(made_once(tmp_path_factory, "twice", lambda folder: None).iterdir()) == []


def test_workers_of_one_run_share_a_folder(
    tmp_path_factory: pytest.TempPathFactory, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    found = []
    for worker in ("gw0", "gw1"):
        (tmp_path / worker).mkdir()
        monkeypatch.setattr(tmp_path_factory, "_basetemp", tmp_path / worker)
        monkeypatch.setenv("PYTEST_XDIST_WORKER", worker)
        found.append(made_once(tmp_path_factory, "shared", lambda folder: None))
    assert found == [tmp_path / "shared"] * 2
