"""The lines of results.ndjson: the bytes that polars writes of the parts, of all logs in their order."""

from __future__ import annotations

from io import BytesIO
from itertools import chain, permutations
from pathlib import Path

import numpy as np
import polars as pl
import pytest
from hypothesis import given
from hypothesis import strategies as st
from tests.robomend_batch.running import batch_run, ndjson, tree

from robomend_batch.one_log import RESULTS, Record
from robomend_batch.parts import AFTER, BEFORE, lines, schema
from robomend_batch.run import Joined

NAMES = st.lists(st.text(st.characters(codec="utf-8"), max_size=8), max_size=3)
ANSWERS = st.tuples(
    st.text(st.characters(codec="utf-8"), max_size=8),
    st.none() | st.lists(NAMES, max_size=3),
    st.none() | st.lists(st.floats(0, 1), max_size=3),
    st.none() | st.lists(NAMES, max_size=3),
    st.booleans(),
    st.none() | st.sampled_from(["limit", "time"]),
    st.booleans(),
    st.none() | st.integers(0, 9),
    st.none() | st.integers(0, 9),
)
COLUMNS = (*BEFORE, *AFTER)


@given(
    st.text(st.characters(codec="utf-8"), max_size=20),
    st.lists(ANSWERS, min_size=1, max_size=4),
    st.lists(NAMES, min_size=1, max_size=4),
    st.data(),
)
def test_lines_are_those_of_the_table(
    log: str, answers: list[tuple[object, ...]], grounds: list[list[str]], data: st.DataObject
) -> None:
    columns = schema()
    table = pl.DataFrame(answers, schema={name: columns[name] for name in COLUMNS}, orient="row")
    observations = pl.Series("observations", grounds, dtype=columns["observations"])
    places = st.tuples(st.integers(0, len(answers) - 1), st.integers(0, len(grounds) - 1))
    rows = data.draw(st.lists(places, max_size=8))
    answer_of, ground_of = (np.array([row[at] for row in rows], dtype=np.intp) for at in (0, 1))
    start = np.arange(len(rows), dtype=np.int64) * 1000 - 2000
    segment = np.arange(len(rows), dtype=np.int32)
    given_rows = segment, start, start + 7, table, answer_of, observations, ground_of
    frame = table[answer_of].with_columns(
        pl.lit(log).alias("log"),
        pl.Series("segment", segment),
        pl.Series("start_ns", start),
        pl.Series("end_ns", start + 7),
        observations[ground_of],
    )
    expected = BytesIO()
    frame.select(list(columns)).write_ndjson(expected)
    assert b"".join(lines(log, *given_rows)) == (expected.getvalue() if rows else b"")


def test_lines_that_are_not_there_are_made_of_the_parts(tmp_path: Path) -> None:
    logs = [ndjson(tmp_path / f"{name}.ndjson", (1, "ok(scan)"), (2, "not ok(scan)")) for name in "abc"]
    assert batch_run(tmp_path / "one", *logs) == 0
    assert batch_run(tmp_path / "two", *logs[:2], "--no-ndjson") == 0
    assert not (tmp_path / "two" / "results.ndjson").exists()
    stale = next((tmp_path / "two" / RESULTS).glob("*.parquet")).with_suffix(".ndjson")
    assert batch_run(tmp_path / "two", *logs) == 0
    assert tree(tmp_path / "two") == tree(tmp_path / "one")
    assert not stale.exists()


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


def test_without_any_lines_there_is_an_empty_file(tmp_path: Path) -> None:
    Joined(tmp_path, []).close()
    assert (tmp_path / "results.ndjson").read_bytes() == b""
