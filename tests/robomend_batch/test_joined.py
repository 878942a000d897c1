"""The lines of all logs become one file while others are still diagnosed, in the order of their names."""

from __future__ import annotations

from itertools import chain, permutations
from pathlib import Path

import pytest

from robomend_batch.one_log import RESULTS, Record
from robomend_batch.run import Joined

LOGS = {"a": ["a"], "a!": ["a!"], "b": ["b#x", "b#y"], "b#": [], "c": ["c"]}
"""File -> its logs."""


def records(out: Path, name: str) -> list[Record]:
    """Write the lines of a file's logs, as a worker does; return what it says of them."""
    found = []
    for log in LOGS[name]:
        parts = [f"{log}-{number}.parquet" for number in range(2)]
        for part in parts:
            (out / RESULTS / part).with_suffix(".ndjson").write_text(f"{part}\n")
        found.append({"log": log, "parts": parts})
    return found


@pytest.mark.parametrize("order", list(permutations(LOGS))[::7])
def test_they_are_in_the_order_of_the_logs_in_whatever_order_these_are_done(
    order: tuple[str, ...], tmp_path: Path
) -> None:
    (tmp_path / RESULTS).mkdir()
    joined = Joined(tmp_path, LOGS)
    for name in order:
        joined.finished(name, records(tmp_path, name))
    joined.close()
    expected = [f"{log}-{number}.parquet" for log in sorted(chain(*LOGS.values())) for number in range(2)]
    assert (tmp_path / "results.ndjson").read_text().splitlines() == expected
    assert list((tmp_path / RESULTS).iterdir()) == []


def test_what_comes_first_is_joined_before_the_last_log_is_done(tmp_path: Path) -> None:
    (tmp_path / RESULTS).mkdir()
    joined = Joined(tmp_path, ["a", "b", "c"])
    joined.finished("c", records(tmp_path, "c"))
    assert not (tmp_path / "results.ndjson.tmp").exists()
    joined.finished("a", records(tmp_path, "a"))
    assert (tmp_path / "results.ndjson.tmp").read_text() == "a-0.parquet\na-1.parquet\n"
    assert not (tmp_path / "results.ndjson").exists()


def test_without_any_lines_there_is_an_empty_file(tmp_path: Path) -> None:
    Joined(tmp_path, []).close()
    assert (tmp_path / "results.ndjson").read_bytes() == b""
