"""Every command and code block of README.md and docs/*.md is run, read or compiled.

How a page says what a block is, and why one is not run: tests/blocks.py.

A page's blocks share a folder, as a reader's would: a file that one names (`# checks.py`) is there for the
next. In it are the examples, and what readers have of their own: a model, an agent's file, logs.
"""

from __future__ import annotations

import contextlib
import io
import json
import os
import re
import shlex
import shutil
import subprocess
import sys
import tomllib
from collections.abc import Callable, Iterator
from importlib.metadata import entry_points
from pathlib import Path
from typing import Any

import pytest
from tests.api.conftest import TEDUSAR
from tests.api.test_process import served
from tests.blocks import BLOCKS, ROOT, Block
from tests.robomend_board.processes import running as board_running
from tests.waiting import until

from robomend.api.schemas.observations import OBSERVATIONS
from robomend.api.schemas.robots import RobotBody
from robomend.api.schemas.session import SignInBody
from robomend.cli.commands import run
from robomend.planning.domain.loading import load_domain
from robomend.settings import load as load_settings
from robomend_client.agent.config import load as load_agent
from robomend_client.rest import Client
from robomend_client.rest.errors import StateConflict
from robomend_client.yaml_tree import read_tree

END_S = 300.0
"""For one block; a safety net."""

SERVICE = "http://127.0.0.1:8600"
BOARD_PORT = "5000"
ASKS = re.compile(r"\bcurl\b|\brobomend (?:robot|observe|status|watch|probes|repairs|drill)\b")
AGENT = """
robot: my_robot
service: {url: "http://127.0.0.1:8600"}
processes: {hokuyo_node: {command: [sleep, "60"]}}
"""
UNLIKE = re.compile(r"\d+(?:\.\d+)? (?:ms|s)\b")
"""What differs from run to run in the output of a command."""

PROGRAMS = ("robomend", "robomend-agent", "robomend-batch", "robomend-bench", "robomend-board")


@pytest.fixture(scope="module")
def service(tmp_path_factory: pytest.TempPathFactory) -> Iterator[str]:
    """The service that README.md starts, on a port of the test's own, with the robot that pages speak of."""
    [block] = [block for block in BLOCKS if block.use == "serve" and block.page == "README.md"]
    _, _, arguments = block.text.partition("robomend serve ")
    assert shlex.split(arguments) == ["--data", "/tmp/robomend"]
    with served(tmp_path_factory.mktemp("service")) as (_, url), Client(url) as client:
        client.put_model("tedusar", TEDUSAR)
        yield url


def healthy_robot(url: str) -> None:
    """Leave the robot that pages speak of as before the first of them."""
    with Client(url) as client:

        def left_open() -> list[str]:
            return [repair["id"] for repair in client.all_repairs(open_only=True)["items"]]

        for repair in left_open():
            with contextlib.suppress(StateConflict):  # it has ended meanwhile
                client.cancel(repair)
        until(lambda: not left_open(), "no repair of the page before is open", 60)
        for robot in client.robots()["items"]:
            client.delete_robot(robot["id"], "*")
        client.put_robot("r1", {"model": "tedusar", "observed": ["ok(scan)"]})
        revision = client.observe("r1", ["ok(scan)"])["revision"]
        client.diagnosis("r1", wait_s=30, after=revision - 1)


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """What a reader has: a checkout to work in, and a robot of their own."""
    for name in ("examples", "clients"):
        (tmp_path / name).symlink_to(ROOT / name)
    programs = tmp_path / ".programs"
    programs.mkdir()
    script(programs / "curl", f'exec {shutil.which("curl")} -sS --fail-with-body "$@"')
    script(tmp_path / "dev", 'shift; exec "$@"')  # `./dev run` would look whether everything is installed
    monkeypatch.setenv("PATH", f"{programs}:{Path(sys.executable).parent}:{os.environ['PATH']}")
    monkeypatch.setenv("ROBOMEND_DATA", str(tmp_path / "data"))
    monkeypatch.setenv("COLUMNS", "80")
    monkeypatch.chdir(tmp_path)
    assert run(["init", "my_robot.yaml"]) == 0
    shutil.copy(ROOT / "examples" / "agent.yaml", "agent.yaml")
    Path("r1.json").write_text('{"model": "my_robot", "observed": ["ok(scan)"]}')
    Path("bags").mkdir()
    lines = (
        {"time": time, "literal": sentence} for time, sentence in ((1.5, "ok(scan)"), (2.5, "not ok(scan)"))
    )
    Path("bags/night.ndjson").write_text("".join(json.dumps(line) + "\n" for line in lines))
    for name in ("before", "after"):  # two runs over the same logs, as `robomend-batch diff` wants them
        Path(name).symlink_to("out")
    return tmp_path


def script(path: Path, command: str) -> None:
    path.write_text(f"#!/bin/sh\n{command}\n")
    path.chmod(0o755)


TUTORIAL = "docs/tutorial.md"
"""Its blocks build on one another, and take a while: tests/test_tutorial.py."""


@pytest.mark.timeout(600)
@pytest.mark.parametrize("page", sorted({block.page for block in BLOCKS} - {TUTORIAL}))
def test_the_blocks_of_a_page_do_what_they_say(
    page: str, folder: Path, request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch
) -> None:
    blocks = [block for block in BLOCKS if block.page == page]
    wanted = [block for block in blocks if not block.reason]
    url = SERVICE
    if any(ASKS.search(block.text) for block in wanted):
        url = request.getfixturevalue("service")
        healthy_robot(url)
        monkeypatch.setenv("ROBOMEND_URL", url)
    with contextlib.ExitStack() as stack:
        for block in wanted:
            text = block.text.replace(SERVICE, url)
            if block.kind == "python" and BOARD_PORT in text:
                board = stack.enter_context(board_running("--on", "2"))
                text = text.replace(BOARD_PORT, str(board.port))
            try:
                CHECKS[block.kind](block, text, folder)
            except BaseException as error:
                error.add_note(f"the block at {block}")
                raise


def shell(block: Block, text: str, folder: Path) -> None:
    """Run commands; where the page shows what they write, they write that."""
    commands, output = commands_and_output(block, text)
    if block.use == "serve":
        return  # it is the service of the other blocks: see `service`
    done = subprocess.run(
        ["bash", "-euo", "pipefail", "-c", commands],
        capture_output=True,
        text=True,
        timeout=END_S,
        cwd=folder,
    )
    assert done.returncode == 0, f"{commands}\n{done.stdout}{done.stderr}"
    assert not output or same(output, done.stdout), f"the page shows\n{output}\nbut it is\n{done.stdout}"


def commands_and_output(block: Block, text: str) -> tuple[str, str]:
    """Return what is typed, and what the page says is written then."""
    if not any(line.startswith("$ ") for line in text.split("\n")):
        return text, ""
    typed: list[str] = []
    written: list[str] = []
    for line in text.split("\n"):
        if line.startswith("$ ") or (typed and typed[-1].endswith("\\")):
            typed.append(line.removeprefix("$ "))
        else:
            written.append(line)
    return "\n".join(typed), "\n".join(written).strip()


def same(shown: str, written: str) -> bool:
    """Return whether a command wrote what the page shows, but for times; `...` stands for any lines."""
    pattern = re.escape(UNLIKE.sub("SOME TIME", shown)).replace(r"\.\.\.", ".*")
    return re.fullmatch(pattern, UNLIKE.sub("SOME TIME", written.strip()), re.DOTALL) is not None


def python(block: Block, text: str, folder: Path) -> None:
    """Execute a block; one that names its file is also written there."""
    if named := re.match(r"# (\w+\.py)\b", text):
        (folder / named[1]).write_text(text)
    with contextlib.redirect_stdout(io.StringIO()) as written:
        exec(compile(text, str(block), "exec"), {"__name__": "docs"})
    after = BLOCKS[BLOCKS.index(block) + 1] if block is not BLOCKS[-1] else block
    if after.use == "output":
        assert written.getvalue().strip() == after.text.strip()


def yaml(block: Block, text: str, folder: Path) -> None:
    file = folder / "block.yaml"
    file.write_text(text)
    read_tree(text)
    if block.use == "settings":
        load_settings({}, {}, file)
    elif block.use == "agent":
        file.write_text(text if "robot:" in text else AGENT + text)
        load_agent(file)
    else:
        assert not block.use


def json_text(block: Block, text: str, folder: Path) -> None:
    value = json.loads(text)
    if block.use == "robot":
        RobotBody.model_validate({"model": "m", **value})
    else:
        assert not block.use


BODIES: dict[str, Callable[[str], Any]] = {
    r"PUT /api/v1/robots/[^/]+": RobotBody.model_validate_json,
    r"POST /api/v1/robots/[^/]+/observations": OBSERVATIONS.validate_json,
    r"POST /api/v1/session": SignInBody.model_validate_json,
}


def http(block: Block, text: str, folder: Path) -> None:
    """Read a request as the service does."""
    line, _, body = text.partition("\n")
    [read] = [read for pattern, read in BODIES.items() if re.fullmatch(pattern, line)]
    read(body)


def c(block: Block, text: str, folder: Path) -> None:
    compiler = shutil.which("cc")
    if compiler is None:
        pytest.skip("there is no C compiler here")
    (folder / "block.c").write_text(text)
    subprocess.run(
        [compiler, "-Wall", "-Werror", "-fsyntax-only", "block.c"], check=True, cwd=folder, timeout=END_S
    )


def toml(block: Block, text: str, folder: Path) -> None:
    tomllib.loads(text)


def pddl(block: Block, text: str, folder: Path) -> None:
    load_domain(text)


def nothing(block: Block, text: str, folder: Path) -> None:
    """A picture, a formula, how something looks, or output; docs/draw.py draws mermaid."""
    assert block.use in ("", "output")


CHECKS = {
    "sh": shell,
    "bash": shell,
    "console": shell,
    "python": python,
    "yaml": yaml,
    "json": json_text,
    "toml": toml,
    "http": http,
    "c": c,
    "pddl": pddl,
    "text": nothing,
    "mermaid": nothing,
}


def test_every_block_says_what_it_is() -> None:
    known = CHECKS.keys() | {"lisp"}
    assert [f"{block}: {block.kind or 'no kind'}" for block in BLOCKS if block.kind not in known] == []


def test_what_is_not_run_has_its_reason() -> None:
    left_out = [block for block in BLOCKS if block.reason]
    assert [str(block) for block in left_out if len(block.reason.split()) < 2] == []
    assert len(left_out) < len(BLOCKS) / 3


NOT_RUN = [
    (str(block), line)
    for block in BLOCKS
    if block.reason and block.kind in ("sh", "console")
    for line in re.findall(
        r"^(?:\$ )?(?:\./dev run )?((?:robomend)\S* .*?)(?:\s{2,}.*| > .*)?$", block.text, re.M
    )
]


@pytest.mark.parametrize(("block", "line"), NOT_RUN)
def test_what_is_not_run_has_at_least_the_options_that_there_are(
    block: str, line: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    program, *arguments = shlex.split(line)
    assert program in PROGRAMS
    [point] = entry_points(group="console_scripts", name=program)
    monkeypatch.setattr(sys, "argv", [program, *arguments, "--help"])
    try:
        code = point.load()()
    except SystemExit as ended:
        code = ended.code
    assert not code, f"{block}: {capsys.readouterr().err}"
    assert "Options:" in capsys.readouterr().out
