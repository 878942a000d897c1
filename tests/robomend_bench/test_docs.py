"""docs/benchmarks.md: every command on the page can be run, everything that can be run is on the page."""

from __future__ import annotations

import re
import shlex
from importlib import import_module
from pathlib import Path

import pytest
from click.testing import CliRunner

from robomend_bench.baselines import BASELINES
from robomend_bench.batch.command import PARTS as BATCH_PARTS
from robomend_bench.faults.bench import LATE_S
from robomend_bench.faults.command import command as faults
from robomend_bench.faults.field import BY_NAME
from robomend_bench.faults.observing import PRESETS
from robomend_bench.faults.policy import MOST_NODES, MOST_STATES
from robomend_bench.faults.robot import robot_names
from robomend_bench.faults.stretches import STRETCHES
from robomend_bench.main import OTHERS, command
from robomend_bench.robots.command import PARTS as ROBOT_PARTS
from robomend_bench.service.command import PARTS
from robomend_bench.suite import find_suite

DOCS = Path(__file__).parents[2] / "docs"
PAGE = (DOCS / "benchmarks.md").read_text()
FIGURES = ("batch.md", "planning.md", "repair.md", "service-figures.md", "score.md", "observers.md")
COMMANDS = sorted(
    {
        *re.findall(r"`robomend-bench ([a-z][^`]*)`", PAGE),
        *re.findall(r"^ *robomend-bench ([a-z].*)$", PAGE, re.M),
    }
)
SHOWN = sorted(
    {
        line.strip()
        for page in FIGURES
        for line in (
            *re.findall(r"`robomend-bench ([a-z][^`\n]*)`", (DOCS / page).read_text()),
            *re.findall(r"^    robomend-bench (.+?)(?:  .*)?$", (DOCS / page).read_text(), re.M),
        )
    }
)


@pytest.mark.parametrize("line", sorted({*COMMANDS, *SHOWN} - {"faults --list"}))  # a list ends at once
def test_every_command_of_the_pages_can_be_run(line: str) -> None:
    shown = line.replace(" DIR ", " . ").replace("/N", "/1").replace("OBSERVERS", "fast")
    name, *words = shlex.split(shown, comments=True)
    if name in OTHERS:
        asked = import_module(OTHERS[name][0]).command.make_context(name, words).params
        assert set(asked.get("parts", ())) <= {*PARTS, *BATCH_PARTS, *ROBOT_PARTS}
    else:
        asked = command.make_context("robomend-bench", [name, *words]).params
        suite = find_suite(asked["suite"])
        assert (asked["mode"] or next(iter(suite.modes))) in suite.modes


def test_the_list_of_the_score_names_every_class_stretch_and_robot_with_its_share() -> None:
    printed = CliRunner().invoke(faults, ["--list"])
    assert printed.exit_code == 0
    rows = [line.split(" | ") for line in printed.output.splitlines() if line.startswith("| `")]
    named = {row[0].strip("| `") for row in rows}
    assert named == {*BY_NAME, *(each.name for each in STRETCHES), *robot_names("field")}
    assert all(len(row[-1]) > 10 for row in rows)
    assert "robomend-bench faults --list" in (DOCS / "score.md").read_text()


def test_the_score_s_page_gives_the_bounds_as_they_are() -> None:
    page = " ".join((DOCS / "score.md").read_text().split())
    published, fast = (PRESETS[name].delay_s() for name in ("published", "fast"))
    assert f"{published:g} s published, {fast:g} s fast" in page
    assert f"more than {LATE_S:g} s late" in page
    assert f"more than {MOST_STATES} states" in page
    assert f"{MOST_NODES:,} beliefs" in page


def test_each_part_of_the_service_s_figures_is_shown() -> None:
    assert len(SHOWN) >= 9
    text = " ".join(SHOWN)
    for part in PARTS:
        assert part in text, part


def test_the_page_names_every_baseline_and_the_list_of_the_rest() -> None:
    assert len(COMMANDS) >= 9
    for word in BASELINES:
        assert f"`{word}`" in PAGE, word
    assert "`robomend-bench --list`" in PAGE
