"""Completion in real shells: the line of docs/commands.md in the file that it names, and then Tab."""

from __future__ import annotations

import contextlib
import fcntl
import os
import pty
import re
import select
import shutil
import signal
import subprocess
import sys
import termios
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
from tests import packages

from robomend.resources import resource

PAGE = (Path(__file__).parents[2] / "docs" / "commands.md").read_text()

END_S = 120.0
"""A safety net: nothing is judged by it."""

KEY_S = 1.0
"""After which Return is pressed once more."""

PROMPT = "ready> "
PROMPTS = {
    "bash": (".bashrc", f"PS1='{PROMPT}'\nbind 'set enable-bracketed-paste off'\n"),
    "zsh": (".zshrc", f"PROMPT='{PROMPT}'\nunsetopt prompt_sp\nbindkey -e\n"),
    "fish": (".config/fish/config.fish", f"function fish_prompt; echo -n '{PROMPT}'; end\n"),
}
PACKAGES = {"zsh": packages.ZSH, "fish": packages.FISH}

TYPED = "robomend diag\tted\t--assume-healthy hokuyo_\t--engine cd\t"
COMPLETED = "robomend diagnose tedusar.yaml --assume-healthy hokuyo_node --engine cda_star"

SHOW = "\x01printf '<%s>' \r"
"""Ctrl-A, then what tells the words of the line that stands there."""


def of_the_page(shell: str) -> tuple[str, str]:
    """Return the file and the line that the page has for a shell."""
    cells = [re.split(r"(?<!\\)\|", row) for row in PAGE.splitlines() if row.startswith(f"| {shell}")]
    [[_, _, file, line, _]] = cells
    return file.strip(" `~").lstrip("/"), line.strip().strip("`").replace(r"\|", "|")


@contextmanager
def terminal(shell: str, home: Path) -> Iterator[int]:
    """Run a shell in a terminal of its own; yield our end of it."""
    ours, its = pty.openpty()
    environment = {
        "HOME": str(home),
        "LANG": "C.UTF-8",
        "PATH": f"{Path(sys.executable).parent}:{os.environ['PATH']}",
        "TERM": "vt100",
    }

    def take_terminal() -> None:
        fcntl.ioctl(0, termios.TIOCSCTTY, 0)

    process = subprocess.Popen(
        [shell, "-i"],
        stdin=its,
        stdout=its,
        stderr=its,
        cwd=home,
        env=environment,
        start_new_session=True,
        preexec_fn=take_terminal,
    )
    os.close(its)
    try:
        yield ours
    finally:
        with contextlib.suppress(ProcessLookupError):
            os.killpg(process.pid, signal.SIGKILL)
        process.wait(60)
        os.close(ours)


def read_until(ours: int, pattern: str) -> str:
    """Return what the terminal shows, once this is in it."""
    shown, deadline = "", time.monotonic() + END_S
    while re.search(pattern, shown) is None:
        ready, _, _ = select.select([ours], [], [], max(0.0, deadline - time.monotonic()))
        assert ready, f"{pattern} does not show: {shown!r}"
        shown += os.read(ours, 4096).decode(errors="replace")
    return shown


def takes_keys(ours: int) -> None:
    """Press Return until it answers: keys that come while a shell sets up its terminal may be lost."""
    read_until(ours, PROMPT)
    shown, deadline = "", time.monotonic() + END_S
    while PROMPT not in shown:
        assert time.monotonic() < deadline, shown
        os.write(ours, b"\r")
        while PROMPT not in shown and select.select([ours], [], [], KEY_S)[0]:
            shown += os.read(ours, 4096).decode(errors="replace")


@pytest.mark.parametrize(
    "shell",
    ["bash", pytest.param("zsh", marks=pytest.mark.long), pytest.param("fish", marks=pytest.mark.long)],
)
def test_tab_completes_commands_files_components_and_engines(shell: str, tmp_path: Path) -> None:
    if shutil.which(shell) is None:
        why = PACKAGES[shell].install() if shell in PACKAGES else "install bash"
        if why:
            pytest.skip(f"there is no {shell} here: {why}")
    shutil.copy(resource("examples", "tedusar.yaml"), tmp_path / "tedusar.yaml")
    for file, text in (PROMPTS[shell], of_the_page(shell)):
        (tmp_path / file).parent.mkdir(parents=True, exist_ok=True)
        with (tmp_path / file).open("a") as start_up:
            start_up.write(f"{text}\n")
    with terminal(shell, tmp_path) as ours:
        takes_keys(ours)
        os.write(ours, (TYPED + SHOW).encode())
        read_until(ours, "".join(f"<{word}>" for word in COMPLETED.split()))
