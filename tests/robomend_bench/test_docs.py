"""docs/benchmarks.md: every command on the page can be run, everything that can be run is on the page."""

from __future__ import annotations

import re
import shlex
from pathlib import Path

import pytest
from click.testing import CliRunner

from robomend_bench.baselines import BASELINES
from robomend_bench.batch.command import PARTS as BATCH_PARTS
from robomend_bench.batch.command import command as batch
from robomend_bench.faults.bench import LATE_S
from robomend_bench.faults.command import command as faults
from robomend_bench.faults.field import BY_NAME
from robomend_bench.faults.observing import PRESETS
from robomend_bench.faults.policy import MOST_NODES, MOST_STATES
from robomend_bench.faults.robot import robot_names
from robomend_bench.faults.stretches import STRETCHES
from robomend_bench.main import OTHERS, command
from robomend_bench.robots.command import command as robots
from robomend_bench.service.command import PARTS
from robomend_bench.service.command import command as service
from robomend_bench.suite import find_suite

PAGE = (Path(__file__).parents[2] / "docs" / "benchmarks.md").read_text()
COMMANDS = sorted(
    {
        *re.findall(r"`robomend-bench ([a-z][^`]*)`", PAGE),
        *re.findall(r"^robomend-bench ([a-z].*)$", PAGE, re.M),
    }
)


@pytest.mark.parametrize("line", COMMANDS)
def test_every_command_on_the_page_can_be_run(line: str) -> None:
    context = command.make_context("robomend-bench", shlex.split(line.replace(" DIR ", " . ")))
    suite = find_suite(context.params["suite"])
    assert (context.params["mode"] or next(iter(suite.modes))) in suite.modes


DOCS = Path(__file__).parents[2] / "docs"
FIGURES = [
    DOCS / name
    for name in ("batch.md", "planning.md", "repair.md", "service-figures.md", "score.md", "observers.md")
]
SHOWN = sorted(
    {
        line.strip()
        for page in FIGURES
        for line in (
            *re.findall(r"`robomend-bench ([a-z][^`\n]*)`", page.read_text()),
            *re.findall(r"^    robomend-bench (.+?)(?:  .*)?$", page.read_text(), re.M),
        )
    }
)


@pytest.mark.parametrize("line", [line for line in SHOWN if line.split()[0] not in OTHERS])
def test_every_command_that_made_figures_can_be_run(line: str) -> None:
    test_every_command_on_the_page_can_be_run(line)


@pytest.mark.parametrize("line", [line for line in SHOWN if line.split()[0] == "service"])
def test_every_command_that_measured_the_service_can_be_run(line: str) -> None:
    context = service.make_context("robomend-bench service", shlex.split(line)[1:])
    assert set(context.params["parts"]) <= set(PARTS)


@pytest.mark.parametrize("line", [line for line in SHOWN if line.split()[0] == "robots"])
def test_every_command_that_measured_the_robot_s_side_can_be_run(line: str) -> None:
    robots.make_context("robomend-bench robots", shlex.split(line)[1:])


@pytest.mark.parametrize("line", [line for line in SHOWN if line.split()[0] == "batch"])
def test_every_command_that_measured_logs_can_be_run(line: str) -> None:
    context = batch.make_context("robomend-bench batch", shlex.split(line)[1:])
    assert set(context.params["parts"]) <= set(BATCH_PARTS)


@pytest.mark.parametrize(
    "line", [line for line in SHOWN if line.split()[0] == "faults" and line != "faults --list"]
)
def test_every_command_of_the_score_can_be_run(line: str) -> None:
    command_line = line.replace("/N", "/1").replace("OBSERVERS", "fast")
    faults.make_context("robomend-bench faults", shlex.split(command_line)[1:])


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
