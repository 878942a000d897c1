"""The first result of each action, remembered."""

from __future__ import annotations

from pathlib import Path

from robomend_client.actions import ActionResult
from robomend_client.agent.memory import FirstResults


def test_the_first_result_counts(tmp_path: Path) -> None:
    memory = FirstResults(tmp_path / "results")
    assert memory.get("r:1") is None
    first = memory.remember("r:1", ActionResult(1, "no"))
    assert memory.remember("r:1", ActionResult(0, "yes")) == first == memory.get("r:1")


def test_it_survives_the_agent_and_a_torn_line(tmp_path: Path) -> None:
    file = tmp_path / "results"
    FirstResults(file).remember("r:1", ActionResult(0, "a “quoted” line\nand another"))
    file.write_text(file.read_text() + '["r:2", 0, "to')
    memory = FirstResults(file)
    memory.remember("r:3", ActionResult(3))
    again = FirstResults(file)
    assert again.get("r:1") == ActionResult(0, "a “quoted” line\nand another")
    assert (again.get("r:2"), again.get("r:3")) == (None, ActionResult(3))


def test_it_keeps_the_newest_in_memory_and_on_the_disk(tmp_path: Path) -> None:
    file = tmp_path / "results"
    memory = FirstResults(file, limit=10)
    for number in range(100):
        memory.remember(f"r:{number}", ActionResult(number))
        assert len(file.read_text().splitlines()) <= 21
    for known in (memory, FirstResults(file, limit=10)):
        assert known.get("r:89") is None
        assert known.get("r:90") == ActionResult(90)
