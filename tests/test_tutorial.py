"""docs/tutorial.md, gone through block by block: three nodes, an agent, a service, a fault and its repair."""

from __future__ import annotations

import os
import re
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory

import pytest
from tests.api.test_process import served
from tests.blocks import BLOCKS, Block
from tests.test_blocks import SERVICE

TUTORIAL = [block for block in BLOCKS if block.page == "docs/tutorial.md" and not block.how]

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


def until(block: Block, folder: Path) -> None:
    """Say it again until it is so, as a reader does."""
    deadline = time.monotonic() + UNTIL_S
    while (done := bash(block, folder)).returncode != 0:
        status = subprocess.run(["robomend", "status", "walker"], capture_output=True, text=True, timeout=60)
        assert time.monotonic() < deadline, f"{block}: {done.stdout}{done.stderr}\n{status.stdout}"


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
                process.wait(30)


TYPED_PER_S = 5
"""Characters: sixty words a minute."""

WAITING_S = 100
"""Installing takes about a minute, what is waited for less than half of one."""


def test_typing_all_of_it_leaves_time_to_install_and_to_wait_within_ten_minutes() -> None:
    typed = sum(len(block.text) for block in TUTORIAL)
    assert typed / TYPED_PER_S + WAITING_S <= 600


@pytest.mark.slow
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
        monkeypatch.setenv("ROBOMEND_URL", url)
        monkeypatch.setenv("PATH", f"{Path(sys.executable).parent}:{os.environ['PATH']}")
        for block in TUTORIAL:
            text = block.text.replace(SERVICE, url)
            seen.add(block.use or block.kind)
            if named := re.match(r"# (\w+\.\w+)\n", text):
                (folder / named[1]).write_text(f"{text}\n{PATIENCE.get(named[1], '')}")
            elif block.use == "background":
                stack.enter_context(background(block, folder))
            elif block.use == "until":
                until(block, folder)
            elif block.use != "serve":
                done = bash(block, folder if folder.exists() else home)  # the first one makes the folder
                assert done.returncode == 0, f"{block}: {done.stdout}{done.stderr}"
    assert seen == {"python", "yaml", "sh", "serve", "background", "until"}
