"""Reads the commands of a block as they would be read, and does nothing else.

Each word goes through the program's own parser: programs and subcommands, options, values with their ranges
and choices, files that must be there. What a program looks at only when it works is not seen here.
"""

from __future__ import annotations

import glob
import re
import shlex
import subprocess
from collections.abc import Callable, Iterator
from importlib import import_module
from pathlib import Path

import click
import pytest
from tests.blocks import ROOT

from robomend.cli.commands import cli
from robomend_batch.commands import batch
from robomend_bench.main import OTHERS
from robomend_bench.main import command as bench
from robomend_board.main import main as board

PROGRAMS: dict[str, click.Command] = {
    "robomend": cli,
    "robomend-batch": batch,
    "robomend-board": board,
}

LAUNCHED = re.compile(r"(\w+):=")


def parse(text: str, pytest_of: pytest.Config) -> None:
    """Read all commands of a block; what would be refused before the work is refused here."""
    subprocess.run(["bash", "-n", "-c", text], check=True, timeout=60)
    for words in commands(text):
        read(words, pytest_of)


def commands(text: str) -> Iterator[list[str]]:
    """Yield the commands of a block, each as its words."""
    whole = text.replace("\\\n", " ")
    for line in whole.split("\n"):
        words: list[str] = []
        for word in shlex.split(line.removeprefix("$ "), comments=True):
            if word in ("&&", "||", "|", ";", "&"):
                yield words
                words = []
            else:
                words.append(word)
        if ">" in words:
            del words[words.index(">") :]
        while words and re.match(r"[A-Z_]+=", words[0]):  # a variable that is set
            del words[0]
        if words:
            yield words


def read(words: list[str], pytest_of: pytest.Config) -> None:
    """Hand a command to its parser."""
    program, *arguments = words
    if program == "./dev":
        what, *arguments = arguments
        if what != "run":
            return DEV[what](arguments, pytest_of)
        program, *arguments = arguments
    arguments = [path for word in arguments for path in (sorted(glob.glob(word)) or [word])]
    if program == "robomend-bench":
        _bench(arguments)
    elif program == "ros2":
        _launch(arguments)
    else:
        _click(PROGRAMS[program], program, arguments)
    return None


def _click(command: click.Command, name: str, arguments: list[str]) -> None:
    """Parse as click does before it calls a command, one subcommand after the other."""
    context = command.make_context(name, arguments)
    if isinstance(command, click.Group) and context._protected_args:
        rest = [*context._protected_args, *context.args]
        found, inner, rest = command.resolve_command(context, rest)
        assert inner is not None, f"{name} has no command {found}"
        with context:
            _click(inner, f"{name} {found}", rest)


def _bench(arguments: list[str]) -> None:
    if arguments and arguments[0] in OTHERS:
        name, *arguments = arguments
        _click(import_module(OTHERS[name][0]).command, f"robomend-bench {name}", arguments)
    else:
        _click(bench, "robomend-bench", arguments)


def _launch(arguments: list[str]) -> None:
    """`ros2 launch PACKAGE FILE NAME:=VALUE …`: there is such a file, and it declares these arguments."""
    verb, package, file, *given = arguments
    assert verb == "launch"
    text = (ROOT / "clients" / package / "launch" / file).read_text()
    declared = re.search(r"names = \((.*?)\)", text)
    assert declared
    names = re.findall(r'"(\w+)"', declared[1])
    for word in given:
        assert (name := LAUNCHED.match(word)), word
        assert name[1] in names, word


def _tests(arguments: list[str], pytest_of: pytest.Config) -> None:
    """Options of pytest, files that there are, and tests that an expression picks."""
    asked, unknown = pytest_of._parser.parse_known_and_unknown_args(arguments)
    assert unknown == []
    files = [ROOT / path for path in asked.file_or_dir]
    assert all(path.exists() for path in files), arguments
    if asked.keyword:
        tests = [path for file in files for path in ([file] if file.is_file() else file.rglob("test_*.py"))]
        assert any(re.search(rf"def test_\w*{asked.keyword}", path.read_text()) for path in tests), arguments


def _demo(arguments: list[str], pytest_of: pytest.Config) -> None:
    _click(cli, "robomend", ["demo", *arguments])


DEV: dict[str, Callable[[list[str], pytest.Config], None]] = {
    "demo": _demo,
    "test": _tests,
}
"""What `./dev` hands its options to."""

assert all(re.search(rf"^{name}\)", Path(ROOT / "dev").read_text(), re.MULTILINE) for name in DEV)
