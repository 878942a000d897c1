"""docs/benchmarks.md: every command on the page can be run, everything that can be run is on the page."""

from __future__ import annotations

import re
import shlex
from pathlib import Path

import pytest

from robomend_bench.baselines import BASELINES
from robomend_bench.contenders import MODES
from robomend_bench.main import command
from robomend_bench.service.command import PARTS
from robomend_bench.service.command import command as service
from robomend_bench.suite import find_suite, suite_names

PAGE = (Path(__file__).parents[2] / "docs" / "benchmarks.md").read_text()
COMMANDS = sorted(
    {
        *re.findall(r"`robomend-bench ([a-z][^`]*)`", PAGE),
        *re.findall(r"^robomend-bench ([a-z].*)$", PAGE, re.M),
    }
)


@pytest.mark.parametrize("line", COMMANDS)
def test_every_command_on_the_page_can_be_run(line: str) -> None:
    context = command.make_context("robomend-bench", shlex.split(line))
    suite = find_suite(context.params["suite"])
    assert (context.params["mode"] or next(iter(suite.modes))) in suite.modes


DOCS = Path(__file__).parents[2] / "docs"
FIGURES = [DOCS / name for name in ("planning.md", "repair.md", "service-figures.md")]
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


@pytest.mark.parametrize("line", [line for line in SHOWN if line.split()[0] != "service"])
def test_every_command_that_made_figures_can_be_run(line: str) -> None:
    test_every_command_on_the_page_can_be_run(line)


@pytest.mark.parametrize("line", [line for line in SHOWN if line.split()[0] == "service"])
def test_every_command_that_measured_the_service_can_be_run(line: str) -> None:
    context = service.make_context("robomend-bench service", shlex.split(line)[1:])
    assert set(filter(None, context.params["only"].split(","))) <= set(PARTS)


def test_each_part_of_the_service_s_figures_is_shown() -> None:
    assert len(SHOWN) >= 9
    text = " ".join(SHOWN)
    for part in PARTS:
        assert part in text, part


def test_the_page_names_every_suite_mode_and_baseline() -> None:
    assert len(COMMANDS) >= 9
    for word in (*suite_names(), *MODES, *BASELINES):
        assert f"`{word}`" in PAGE, word
