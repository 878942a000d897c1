"""docs/tutorial.md, gone through block by block: three nodes, an agent, a service, a fault and its repair."""

from __future__ import annotations

import os
import re
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from tempfile import TemporaryDirectory
from textwrap import indent

import pytest
from tests import forked_programs
from tests.api.test_process import served
from tests.blocks import BLOCKS, Block
from tests.ros1 import RosMaster, ros1
from tests.test_blocks import SERVICE
from tests.waiting import LOOK_S
from tests.waiting import until as wait_until

from robomend.repairs.states import RepairState
from robomend_client.rest import Client
from robomend_client.rest.errors import StateConflict

PAGE = [block for block in BLOCKS if block.page == "docs/tutorial.md"]
TUTORIAL = [block for block in PAGE if not block.how]
OVER_ROS = [block for block in PAGE if block.how == "run by"]

PATIENCE = {
    "robot.yaml": "observed_timeout_s: 300\n",
    "agent.yaml": "report: {heartbeat_s: 1, lifetime_s: 60}\n",
}
"""Added to the files of the page: a machine that is busy with other tests is no silence of the robot."""

UNTIL_S = 300.0
"""For what takes a few seconds; a safety net."""


ENVIRONMENT = "~/robomend/.venv"
"""Of a reader; ours is where this runs."""


def bash(block: Block, folder: Path) -> subprocess.CompletedProcess[str]:
    typed = block.text.replace(ENVIRONMENT, sys.prefix)
    return subprocess.run(
        ["bash", "-euo", "pipefail", "-c", typed], capture_output=True, text=True, timeout=60, cwd=folder
    )


def shell(text: str) -> Block:
    return Block("docs/tutorial.md", 0, "sh", text)


AGAIN_S = 2.0
"""After so long a reader says it again at the latest."""


def until(block: Block, folder: Path, client: Client) -> None:
    """Say it again until it is so, as a reader does: when something has happened."""
    deadline = time.monotonic() + UNTIL_S
    while True:
        before, again = there(client), time.monotonic() + AGAIN_S
        done = bash(block, folder)
        if done.returncode == 0:
            return
        assert time.monotonic() < deadline, f"{block}: {done.stdout}{done.stderr}\n{before}"
        while there(client) == before and time.monotonic() < again:
            time.sleep(LOOK_S)


def there(client: Client) -> tuple[str, list[str]]:
    """Return how the robot of the page is, and its repairs."""
    repairs = client.repairs("walker")["items"]
    return client.robot("walker").value["state"], [repair["state"] for repair in repairs]


@contextmanager
def background(block: Block, folder: Path) -> Iterator[None]:
    """Run it in a terminal of its own, and end it with Ctrl-C."""
    with (folder / "background.log").open("wb") as log:
        process = subprocess.Popen(
            ["bash", "-c", f"exec {block.text}"], cwd=folder, stdout=log, stderr=log, start_new_session=True
        )
        try:
            yield
            assert process.poll() is None, (folder / "background.log").read_text()
        finally:
            if process.poll() is None:
                process.send_signal(signal.SIGINT)
                process.wait(60)


@pytest.mark.timeout(1500)
def test_the_tutorial_leads_from_nothing_to_a_repaired_robot(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    [serve] = [block for block in TUTORIAL if block.use == "serve"]
    assert serve.text == "robomend serve --data data"
    seen = set()
    with ExitStack() as stack:
        # Short: the agent's bus is a socket in its folder, whose path may have about 100 bytes.
        home = Path(stack.enter_context(TemporaryDirectory(prefix="robomend-")))
        data, folder = home / "data", home / "walker"
        data.mkdir()
        _, url = stack.enter_context(served(data))
        client = stack.enter_context(Client(url))
        monkeypatch.setenv("ROBOMEND_URL", url)
        begun = forked_programs.write(home / "programs")
        monkeypatch.setenv("PATH", f"{begun}:{Path(sys.executable).parent}:{os.environ['PATH']}")
        for block in TUTORIAL:
            text = block.text.replace(SERVICE, url)
            seen.add(block.use or block.kind)
            if named := re.match(r"# (\w+\.\w+)\n", text):
                (folder / named[1]).write_text(f"{text}\n{PATIENCE.get(named[1], '')}")
            elif block.use == "background":
                stack.enter_context(background(block, folder))
            elif block.use == "until":
                until(block, folder, client)
            elif block.use != "serve":
                done = bash(block, folder if folder.exists() else home)  # the first one makes the folder
                assert done.returncode == 0, f"{block}: {done.stdout}{done.stderr}"
    assert seen == {"python", "yaml", "sh", "serve", "background", "until"}


def write_files(blocks: list[Block], folder: Path, url: str) -> None:
    """Write the files of the page, each below its name."""
    for block in blocks:
        if named := re.match(r"# (\w+\.\w+)\n", block.text):
            text = block.text.replace(SERVICE, url)
            (folder / named[1]).write_text(f"{text}\n{PATIENCE.get(named[1], '')}")


def put_in(file: Path, where: str, line: str) -> None:
    """Put a line behind another one."""
    text = file.read_text()
    assert text.count(f"{where}\n") == 1, f"{file.name} has no line {where!r}"
    file.write_text(text.replace(f"{where}\n", f"{where}\n{line}\n"))


def halt(program: str, folder: Path) -> None:
    """Halt the process of a program that runs in a folder."""
    for process in Path("/proc").glob("[0-9]*"):
        try:
            command, there = (process / "cmdline").read_bytes().split(b"\0"), (process / "cwd").readlink()
        except OSError:
            continue  # it has ended meanwhile, or is another user's
        if program.encode() in command and there == folder:
            os.kill(int(process.name), signal.SIGSTOP)
            return
    raise AssertionError(f"{program} does not run")


@pytest.mark.timeout(1500)
def test_a_node_of_the_tutorial_is_heard_over_ros_and_restarted(monkeypatch: pytest.MonkeyPatch) -> None:
    ros1()
    _, node, observed, (keys, topic, process) = (block.text.splitlines() for block in OVER_ROS)
    with ExitStack() as stack:
        home = Path(stack.enter_context(TemporaryDirectory(prefix="robomend-"))).resolve()
        data, folder = home / "data", home / "walker"
        data.mkdir()
        folder.mkdir()
        master = RosMaster(home)
        stack.callback(master.stop)
        _, url = stack.enter_context(served(data))
        write_files(PAGE, folder, url)
        put_in(folder / "walker.yaml", "nodes:", indent(node[0], "  "))
        put_in(folder / "robot.yaml", "observed:", indent(observed[0], "  "))
        put_in(folder / "agent.yaml", "robot: walker", keys)
        put_in(folder / "agent.yaml", "topics:", topic)
        put_in(folder / "agent.yaml", "processes:", process)
        monkeypatch.setenv("ROBOMEND_URL", url)
        begun = forked_programs.write(home / "programs")
        monkeypatch.setenv("PATH", f"{begun}:{Path(sys.executable).parent}:{os.environ['PATH']}")
        for name in ("ROS_MASTER_URI", "ROS_IP", "ROS_HOME", "ROS_LOG_DIR"):
            monkeypatch.setenv(name, master.environment[name])
        put = bash(shell("robomend robot put walker robot.yaml --model walker.yaml"), folder)
        assert put.returncode == 0, put.stderr
        stack.enter_context(background(shell("robomend-agent agent.yaml"), folder))
        client = stack.enter_context(Client(url))

        def approve_what_waits() -> bool:
            """Say yes to whatever waits for it; return whether the battery's node was restarted."""
            found = client.repairs("walker")["items"]
            for one in found:
                if one["state"] == RepairState.AWAITING_APPROVAL:
                    with suppress(StateConflict):  # the diagnosis has changed meanwhile
                        client.approve(one["id"])
            return any(
                one["state"] == RepairState.REPAIRED
                and any(step["text"] == "start_node(battery)" for step in one["plan"])
                for one in found
            )

        def healthy() -> bool:
            return bool(client.robot("walker").value["state"] == "healthy")

        wait_until(healthy, "all three ways are heard", UNTIL_S)
        halt("battery.py", folder)
        wait_until(approve_what_waits, "the plan is approved, and carried out", UNTIL_S)
        wait_until(healthy, "the node is heard again", UNTIL_S)
