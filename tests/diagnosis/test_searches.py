"""docs/diagnosis.md on the searches: each that is kept is in its tables, and wins by a figure shown."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from robomend_bench.odd_models import MODELS as ODD

ROOT = Path(__file__).parents[2]
ROOM = ROOT / "service" / "robomend" / "diagnosis"
PAGE = (ROOT / "docs" / "diagnosis.md").read_text()
FIGURES = (ROOT / "docs" / "benchmarks.md").read_text()

CHOSEN = PAGE.partition("\n`sat` picks by model and question")[2].partition(
    "\nEach is kept for what it wins"
)[0]
WINS = PAGE.partition("\nEach is kept for what it wins")[2].partition("\n\nThese put them together")[0]
TOGETHER = PAGE.partition("\nThese put them together")[2].partition("\n\n")[0]

ENGINES = {"sat", "asp", "maxsat", "hs_dag", "cda_star", "snapshots"}
"""Named in the table of engines, or in that of questions."""

NO_SEARCH = {
    "asked and answered": {"result", "search", "base", "engines", "observed", "products", "wcnf"},
    "a solver and what it is asked": {"oracle", "consistency", "masks"},
    "conflicts": {
        "conflicts",
        "sensor_conflicts",
        "shrinking",
        "witnesses",
        "justification",
        "reasons",
        "traces",
    },
    "words, weights and what to look at next": {"explanations", "likelihood", "onsets", "probes"},
    "circuits and snapshots": {"netlist", "snapshot_parts"},
}
"""The other modules of the room: a new one belongs here, or in the tables with what it wins."""


def named(text: str) -> set[str]:
    return set(re.findall(r"`(?:circuits/)?([a-z_]+)\.py`", text))


def test_every_module_is_a_search_that_wins_or_puts_them_together_or_no_search() -> None:
    modules = {path.stem for path in (*ROOM.glob("*.py"), *(ROOM / "circuits").glob("*.py"))} - {"__init__"}
    others = set[str]().union(*NO_SEARCH.values())
    searches = named(WINS) | named(TOGETHER) | ENGINES
    assert not searches & others
    assert searches | others == modules


def test_whatever_search_is_picked_for_a_question_wins_somewhere() -> None:
    assert named(CHOSEN), "the table of questions"
    assert named(CHOSEN) <= named(WINS) | named(TOGETHER)


ROWS = [line for line in WINS.splitlines() if line.startswith("| `")]


@pytest.mark.parametrize("row", ROWS, ids=lambda row: row.split("|")[1].strip())
def test_what_a_search_wins_is_a_figure_of_the_benchmarks(row: str) -> None:
    told = re.findall(r"[0-9.]+×|[0-9.]+ to [0-9.]+ times|[0-9.]+ m?s\b|sizes \d+ and \d+", row)
    suites = re.findall(r"`robomend-bench odd --only ([a-z-]+)`", row)
    assert told or suites, "by how much, or a command that shows it"
    assert not [figure for figure in told if not re.search(rf"(?<![\d.]){re.escape(figure)}", FIGURES)]
    assert not [name for name in suites if name not in ODD]
