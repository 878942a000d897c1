"""The lines of results.ndjson: put together of texts, and the same bytes as polars writes of the parts."""

from __future__ import annotations

from io import BytesIO
from pathlib import Path

import numpy as np
import polars as pl
import pytest
from hypothesis import given
from hypothesis import strategies as st
from tests.robomend_batch.running import batch_run, ndjson, tree

from robomend_batch import parts
from robomend_batch.one_log import RESULTS
from robomend_batch.parts import AFTER, BEFORE, lines, schema

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


def test_the_bytes_do_not_depend_on_how_much_is_spread_out_at_once(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Names are themselves, though numbers stand for them on the way."""
    names = ["a_scanner_that_has_a_long_name", "Kamera2", "x", "left_motor"]
    model = tmp_path / "m.yaml"
    model.write_text(
        "robomend: 1\nname: m\nhardware: {{{}}}\nproperties: {{{}}}\nrules: [{}]\n".format(
            ", ".join(f"c{number}: {{}}" for number in range(4)),
            ", ".join(f'"{name}": {{}}' for name in names),
            ", ".join(
                f'"not ab(c{number}) and not ab(c{(number + 1) % 4}) -> ok({name})"'
                for number, name in enumerate(names)
            ),
        )
    )
    said = [
        (number, f"{'' if number >> place & 1 else 'not '}ok({name})")
        for number in range(40)
        for place, name in enumerate(names)
    ]
    log = ndjson(tmp_path / "a.ndjson", *said)
    assert batch_run(tmp_path / "whole", log, model=model) == 0
    monkeypatch.setattr(parts, "DECODED", 1)
    monkeypatch.setattr(parts, "SPREAD", 3)
    assert batch_run(tmp_path / "pieces", log, model=model) == 0
    found = tree(tmp_path / "whole")
    assert tree(tmp_path / "pieces") == found
    assert all(name.encode() in found["results.ndjson"] for name in names)
