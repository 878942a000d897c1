"""docs/benchmarks.md: every command on the page can be run, everything that can be run is on the page."""

from __future__ import annotations

import re
import shlex
from pathlib import Path

import pytest

from robomend_bench.baselines import BASELINES
from robomend_bench.contenders import MODES
from robomend_bench.main import command
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


def test_the_page_names_every_suite_mode_and_baseline() -> None:
    assert len(COMMANDS) >= 9
    for word in (*suite_names(), *MODES, *BASELINES):
        assert f"`{word}`" in PAGE, word
