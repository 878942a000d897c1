"""Every command and code block of README.md and docs/*.md is run, read or compiled.

How a page says what a block is, and how one is looked at that is not run: tests/blocks.py.

A page's blocks share a folder, as a reader's would: a file that one names (`# checks.py`) is there for the
next. In it are the examples, and what readers have of their own: a model, an agent's file, logs.
"""

from __future__ import annotations

import asyncio
import contextlib
import io
import json
import os
import re
import shlex
import shutil
import signal
import subprocess
import sys
import tomllib
from collections.abc import Callable, Iterator
from importlib import import_module
from pathlib import Path
from typing import Any

import click
import pytest
from tests import forked_programs
from tests.api.conftest import TEDUSAR
from tests.api.test_process import served
from tests.blocks import BLOCKS, ROOT, Block, commands
from tests.robomend_batch.recordings import steady, write
from tests.robomend_board.processes import running as board_running
from tests.waiting import until

from robomend.api.routers.session import SignInBody
from robomend.api.schemas.observations import OBSERVATIONS
from robomend.api.schemas.robots import RobotBody
from robomend.cli.commands import cli, run
from robomend.planning.domain.loading import load_domain
from robomend.settings import load as load_settings
from robomend_bench.main import OTHERS
from robomend_bench.main import command as bench
from robomend_client.agent.broker import Broker, TopicMessage
from robomend_client.agent.config import load as load_agent
from robomend_client.rest import Client
from robomend_client.rest.errors import StateConflict
from robomend_client.yaml_tree import read_tree

END_S = 300.0
"""For one block; a safety net."""

SERVICE = "http://127.0.0.1:8600"
BUS_PORT = "7411"
FORKED = ".forked"
"""Where commands are that begin at once."""
BATCH = "b-7k2m9x4qhj"
OPEN_BATCH = "b-3fwt8k6rnz"
ASKS = re.compile(r"\bcurl\b|Client\(\"|\brobomend (?:robot|observe|status|watch|probes|repairs|batches)\b")
AGENT = """
robot: my_robot
service: {url: "http://127.0.0.1:8600"}
processes: {hokuyo_node: {command: [sleep, "60"]}}
"""
UNLIKE = re.compile(r"\d+(?:\.\d+)? (?:ms|s)\b")
"""What differs from run to run in the output of a command."""


@pytest.fixture(scope="module")
def service(tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[str, Path]]:
    """The service that README.md starts, on a port of the test's own: its address and its data."""
    [block] = [block for block in BLOCKS if block.use == "serve" and block.page == "README.md"]
    _, _, arguments = block.text.partition("robomend serve ")
    assert shlex.split(arguments) == ["--data", "/tmp/robomend"]
    data, logs = (tmp_path_factory.mktemp(name) for name in ("service", "logs"))
    (logs / "night").mkdir()
    recording(logs / "night" / "a.bag")
    (settings := data / "settings.yaml").write_text(f"batch_folder: {logs}\n")
    with served(data, "--config", str(settings)) as (_, url), Client(url) as client:
        client.put_model("tedusar", TEDUSAR)
        yield url, data


def recording(file: Path, end_s: float = 20.0) -> None:
    """Record a healthy robot with the topics of examples/agent.yaml."""
    write(file, [*steady("odom", 10.0, end_s), *steady("scan", 10.0, end_s)])


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
    begun = forked_programs.write(tmp_path / FORKED)
    monkeypatch.setenv("PATH", f"{begun}:{programs}:{Path(sys.executable).parent}:{os.environ['PATH']}")
    monkeypatch.setenv("ROBOMEND_DATA", str(tmp_path / "data"))
    monkeypatch.setenv("COLUMNS", "80")
    monkeypatch.chdir(tmp_path)
    assert run(["init", "my_robot.yaml"]) == 0
    shutil.copy(ROOT / "examples" / "agent.yaml", "agent.yaml")
    Path("robot.yaml").write_text("model: my_robot\nobserved: [ok(scan)]\n")
    Path("bags").mkdir()
    lines = (
        {"time": time, "literal": sentence} for time, sentence in ((1.5, "ok(scan)"), (2.5, "not ok(scan)"))
    )
    Path("bags/night.ndjson").write_text("".join(json.dumps(line) + "\n" for line in lines))
    for name in ("before", "after"):  # two runs over the same logs, as `robomend-batch diff` wants them
        Path(name).symlink_to("out")
    return tmp_path


def logs_of_the_reader(url: str) -> dict[str, str]:
    """Make what docs/batch.md speaks of: recordings, faults that were confirmed, and a batch that is done."""
    for folder in ("good", "night"):
        Path(folder).mkdir()
        recording(Path(folder, "a.bag"))
    for name in ("run1.mcap", "run2.mcap"):
        recording(Path(name))
    with Client(url) as client:
        client.put_model("my_robot", Path("my_robot.yaml").read_text())
        client.put_robot("mine", {"model": "my_robot", "policy": "observe"})
        client.observe("mine", ["ok(scan)"])
        Path("confirmed.csv").write_text("log,component\nbags/night.ndjson,lidar\n")
        batch = handed_in(client)
        until(lambda: client.batch(batch)["state"] == "done", "the reader's batch is done", END_S)
        return {BATCH: batch}


def handed_in(client: Client) -> str:
    """Hand in a small log as a batch of its own."""
    log = Path("bags/night.ndjson")
    with log.open("rb") as read:
        return str(client.upload_batch([(log.name, read)], model="my_robot")["id"])


WAITING = 6
"""Batches that wait for one another, so that the last one is open for as long as a block takes."""


def end_batches(url: str) -> None:
    """Cancel what is open."""
    with Client(url) as client:
        for batch in client.batches()["items"]:
            with contextlib.suppress(StateConflict):  # it has ended meanwhile
                client.cancel_batch(batch["id"])


def script(path: Path, command: str) -> None:
    path.write_text(f"#!/bin/sh\n{command}\n")
    path.chmod(0o755)


TUTORIAL = "docs/tutorial.md"
"""Its blocks build on one another, and take a while: tests/test_tutorial.py."""


@pytest.mark.parametrize("page", sorted({block.page for block in BLOCKS} - {TUTORIAL}))
def test_the_blocks_of_a_page_do_what_they_say(
    page: str, folder: Path, request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch
) -> None:
    blocks = [block for block in BLOCKS if block.page == page]
    wanted = [block for block in blocks if not block.how]
    url, batches, ports = SERVICE, dict[str, str](), dict[str, int]()
    if any(ASKS.search(block.text) for block in wanted):
        url, data = request.getfixturevalue("service")
        healthy_robot(url)
        monkeypatch.setenv("ROBOMEND_URL", url)
    if any(BATCH in block.text for block in wanted):
        batches = logs_of_the_reader(url)
        monkeypatch.setenv("ROBOMEND_DATA", str(data))
    if any("run.bag" in block.text for block in wanted):
        recording(Path("run.bag"))
    with contextlib.ExitStack() as stack:
        for block in wanted:
            text = block.text.replace(SERVICE, url)
            if OPEN_BATCH in text:
                with Client(url) as client:
                    batches[OPEN_BATCH] = [handed_in(client) for _ in range(WAITING)][-1]
            if block.use == "board":
                [words] = commands(commands_and_output(block, text)[0])
                options = words[words.index("robomend-board") + 1 :]
                board = stack.enter_context(board_running(*options))
                ready = json.loads(commands_and_output(block, text)[1])
                ports |= {str(ready["port"]): board.port, str(ready["control_port"]): board.control_port}
                continue
            for shown, real in ports.items():
                text = re.sub(rf"\b{shown}\b", str(real), text)
            for shown, real_batch in batches.items():
                text = text.replace(shown, real_batch)
            if "5001" in ports:
                text = text.replace("board control ", f"board control --port {ports['5001']} ")
            try:
                CHECKS[block.kind](block, text, folder)
            except BaseException as error:
                error.add_note(f"the block at {block}")
                raise
            if OPEN_BATCH in block.text:
                end_batches(url)


def shell(block: Block, text: str, folder: Path) -> None:
    """Run commands; where the page shows what they write, they write that."""
    typed, output = commands_and_output(block, text)
    if block.use == "serve":
        return  # it is the service of the other blocks: see `service`
    if block.use == "endless":
        endless(typed, folder)
        return
    assert block.use == ""
    # A console is as a person has it: there a pipe is as good as its last command.
    strict = () if block.kind == "console" else ("-o", "pipefail")
    done = subprocess.run(
        ["bash", "-eu", *strict, "-c", typed],
        capture_output=True,
        text=True,
        timeout=END_S,
        cwd=folder,
    )
    assert done.returncode == 0, f"{typed}\n{done.stdout}{done.stderr}"
    assert not output or same(output, done.stdout), f"the page shows\n{output}\nbut it is\n{done.stdout}"


def endless(typed: str, folder: Path) -> None:
    """Run what goes on until it has said something, here or on the bus of an agent; then end it."""

    async def first() -> None:
        said = asyncio.Event()

        def heard(message: TopicMessage) -> None:
            said.set()

        broker = Broker("tcp:127.0.0.1:0", heard)
        await broker.open()
        _, _, killable = os.environ["PATH"].partition(":")
        assert FORKED not in killable
        process = await asyncio.create_subprocess_exec(
            *("bash", "-euo", "pipefail", "-c", typed.replace(BUS_PORT, broker.address.rpartition(":")[2])),
            cwd=folder,
            stdout=asyncio.subprocess.PIPE,
            env={**os.environ, "PATH": killable},
            start_new_session=True,
        )
        assert process.stdout is not None
        line = asyncio.ensure_future(process.stdout.readline())
        waited = asyncio.ensure_future(said.wait())
        try:
            await asyncio.wait({line, waited}, timeout=END_S, return_when=asyncio.FIRST_COMPLETED)
            assert said.is_set() or line.done(), f"{typed}\nsays nothing"
            assert said.is_set() or line.result(), f"{typed}\nhas an end"
        finally:
            waited.cancel()
            os.killpg(process.pid, signal.SIGKILL)
            await process.wait()
            await line
            await broker.close()

    asyncio.run(first())


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


@pytest.mark.parametrize("block", [block for block in BLOCKS if block.how], ids=str)
def test_what_is_not_run_here_says_why_and_by_what_it_is_run(block: Block) -> None:
    assert len(block.reason.split()) > 1
    if block.how == "run by":
        text = (ROOT / block.test).read_text()
        assert "BLOCKS" in text or f'"{Path(block.page).name}"' in text, f"{block.test} reads {block.page}"


@pytest.mark.parametrize("block", [block for block in BLOCKS if block.how == "begun"], ids=str)
@pytest.mark.usefixtures("folder")
def test_each_word_of_a_command_that_is_begun_is_one_that_it_takes(block: Block) -> None:
    """By the command's own parser; what a program looks at only when it works is not seen here."""
    Path("DIR").mkdir()
    for program, what, *arguments in commands(commands_and_output(block, block.text)[0]):
        if what == "demo":
            command = cli.get_command(click.Context(cli), what)
            assert command is not None
            command.make_context(program, arguments)
        elif what == "test":
            assert (program, arguments) == ("./dev", [])
        elif what in OTHERS:
            import_module(OTHERS[what][0]).command.make_context(program, arguments)
        else:
            assert program == "robomend-bench"
            bench.make_context(program, [what, *arguments])
