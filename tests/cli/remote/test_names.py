"""What a shell completes names of robots and repairs to."""

from __future__ import annotations

import os
import subprocess

import pytest
from click.shell_completion import ShellComplete
from tests.api.test_process import command
from tests.cli.remote.conftest import Shared
from tests.waiting import until

from robomend.cli.commands import cli
from robomend.cli.remote import names


def completed(*words: str) -> list[str]:
    """Return what the shell offers for the last word."""
    shell = ShellComplete(cli, {}, "robomend", "_ROBOMEND_COMPLETE")
    return [item.value for item in shell.get_completions(list(words[:-1]), words[-1])]


def test_robots_and_repairs_of_the_service_are_offered(
    shared: Shared, robot: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(names, "COMPLETION_S", 60.0)  # nobody waits at a prompt here
    repair = shared.awaiting_approval(robot)
    for line in (["status"], ["watch"], ["observe"], ["probes"], ["robot", "get"], ["repairs", "--robot"]):
        assert robot in completed(*line, robot[:1])
        assert completed(*line, "zz") == []
    for name in ("repairs", "approve", "cancel"):
        assert repair in completed(name, "r-")
    shared.client.cancel(repair)
    until(lambda: repair not in completed("approve", "r-"), "it waits for nobody any more")
    assert completed("stop", "") == ["set", "lift", "show"]


def test_a_shell_sees_no_error_where_nobody_answers() -> None:
    line = {"COMP_WORDS": "robomend status r", "COMP_CWORD": "2", "_ROBOMEND_COMPLETE": "bash_complete"}
    done = subprocess.run(
        command(),
        env={**os.environ, **line, "ROBOMEND_URL": "http://127.0.0.1:1"},
        capture_output=True,
        text=True,
        timeout=60,
    )
    assert (done.stdout.strip(), done.stderr) == ("", "")
