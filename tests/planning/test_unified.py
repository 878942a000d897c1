"""What a worker loads before it can plan: it is most of the time of `robomend plan`."""

from __future__ import annotations

import subprocess
import sys

import pytest

HEAVY = ("scipy", "ConfigSpace", "unified_planning", "clingo")


def loaded(*planners: str, then: str = "") -> str:
    """Return which of the heavy packages a process has loaded that is ready for these planners."""
    code = (
        f"import sys; from robomend.planning.planner_pool import warm; warm({planners!r}); {then}\n"
        f"print(*[name for name in {HEAVY!r} if name in sys.modules])"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=110)
    assert done.returncode == 0, done.stderr
    return done.stdout.strip()


@pytest.mark.parametrize(("before", "after"), [("NOTSET", "WARNING"), ("ERROR", "ERROR")])
def test_the_planner_that_logs_each_step_of_its_search_says_only_what_is_worth_a_warning(
    before: str, after: str
) -> None:
    then = (
        "import logging; from robomend.planning.planners.pyperplan import Pyperplan; "
        f"logging.root.setLevel({before!r}); Pyperplan(); "
        f"assert logging.getLevelName(logging.root.level) == {after!r}"
    )
    loaded("pyperplan", then=then)
