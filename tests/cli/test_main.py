"""The entry point: quick to start, exit codes, no traceback for what a user can mend."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import click
import pytest
from tests.distributions import install

from robomend.cli.commands import OTHERS, cli, run


def test_version_and_help_load_no_solver_and_no_web_framework() -> None:
    code = (
        "import sys; from robomend.cli.commands import run; "
        "assert run(['--version']) == 0; assert run(['--help']) == 0; "
        "heavy = {'pysat', 'clingo', 'yaml', 'fastapi', 'unified_planning', 'rich'}; "
        "print(*sorted(heavy & set(sys.modules)))"
    )
    done = subprocess.run(  # one process per test: what this one has imported does not count
        [sys.executable, "-c", code], capture_output=True, text=True, timeout=60, check=True
    )
    assert done.stdout.startswith("robomend ")
    assert done.stdout.endswith("\n\n")


def test_a_command_that_is_not_installed_says_so(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setitem(cli.registry.built_in, "ghost", "robomend.cli.ghost:command")
    assert "ghost" not in cli.list_commands(click.Context(cli))
    assert run(["ghost"]) == 2
    assert "error: `ghost` is not part of this installation" in capsys.readouterr().err


def test_other_packages_add_commands_and_a_broken_one_spoils_no_help(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    code = "import click\n@click.command()\ndef wave():\n    'Wave.'\n    click.echo('hello')\n"
    points = {OTHERS: {"wave": "wave", "broken": "nothing", "serve": "wave"}}
    monkeypatch.syspath_prepend(str(install(tmp_path, "waving", code, points)))
    assert run(["wave"]) == 0
    assert capsys.readouterr().out == "hello\n"
    assert run(["--help"]) == 0
    shown = capsys.readouterr().out
    assert "wave      Wave." in shown
    assert "broken    command 'broken' (waving:nothing) could not be loaded" in shown
    assert "serve     Run the service." in shown
    assert run(["broken"]) == 2
    assert "could not be loaded" in capsys.readouterr().err


def test_bad_input_exits_with_2_and_one_line(capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["compile", "/nowhere.yaml"]) == 2
    captured = capsys.readouterr()
    assert captured.out == ""
    assert captured.err == "error: /nowhere.yaml: cannot be read: No such file or directory\n"
    assert run(["compile"]) == 2
    assert "error: Missing argument 'MODEL'." in capsys.readouterr().err
    assert run(["nonsense"]) == 2


def test_a_reader_that_has_seen_enough_is_no_error() -> None:
    code = "from robomend.cli.main import main; main(['--help'])"
    reader, writer = os.pipe()
    os.close(reader)
    try:
        done = subprocess.run(
            [sys.executable, "-c", code], stdout=writer, stderr=subprocess.PIPE, timeout=60, check=False
        )
    finally:
        os.close(writer)
    assert (done.returncode, done.stderr) == (0, b"")


def test_an_interrupt_before_all_is_imported_is_quiet() -> None:
    code = """
import sys

class Interrupt:
    def find_spec(self, name, *_):
        if name == "click":
            raise KeyboardInterrupt

sys.meta_path.insert(0, Interrupt())
from robomend.cli.main import main
main(["--version"])
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, timeout=60, check=False)
    assert (done.returncode, done.stdout, done.stderr) == (130, b"", b"")


@pytest.mark.parametrize("kept_s", [0.0, 0.5])  # from the processor, while it is seen that one was dropped
@pytest.mark.parametrize("program", ["robomend.cli.main", "robomend_batch.main"])
def test_an_interrupt_that_comes_inside_a_finalizer_is_not_lost(program: str, kept_s: float) -> None:
    code = f"""
import signal, sys, threading, time

start = threading.Thread.start

def slowly(thread):
    start(thread)
    time.sleep({kept_s})

threading.Thread.start = slowly

class Dropped:
    def __del__(self):
        signal.raise_signal(signal.SIGINT)

class Interrupt:
    def find_spec(self, name, *_):
        if name == "click":
            Dropped()
            time.sleep(600)

sys.meta_path.insert(0, Interrupt())
from {program} import main
main(["--version"])
"""
    done = subprocess.run(
        ["env", "--default-signal=INT", sys.executable, "-c", code],
        capture_output=True,
        timeout=300,
        check=False,
    )
    assert (done.returncode, done.stdout, done.stderr) == (130, b"", b"")
