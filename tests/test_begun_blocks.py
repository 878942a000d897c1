"""What takes minutes is typed into a terminal, works until it has shown that it does, and ends with Ctrl-C.

As it stands in the page, until it has a first result, or has worked for a while; then, by Ctrl-C, it ends at
once, says no more than that, and leaves no process and no file behind. Without --long that is done with the
lines of CHEAP only. That each bench comes to a result has its tests in tests/robomend_bench/.
"""

from __future__ import annotations

import os
import re
import shlex
import shutil
import subprocess
import sys
import time
from dataclasses import dataclass
from pathlib import Path

import pytest
from tests.blocks import BLOCKS, ROOT, Block, commands
from tests.packages import KILTED, ROS1
from tests.ros2 import ros2
from tests.terminal import AFTER_CTRL_C, Terminal

from robomend_bench.suite import DATA

END_S = 600.0
"""For one line; a safety net."""

END_AFTER_CTRL_C_S = 60.0

AT_WORK_S = 4.0
"""Of processor time, without a complaint: a sign of work where no result comes before the end."""

RESULT = re.compile(
    r" [1-9]\d*/[1-9]\d* \d+:\d\d:\d\d"  # a bar that has moved
    r"|measuring: .*\n(?s:.*)measuring: "  # a part is measured, and the next one is on
    r"|^\d+ \S+ +\d+(\.\d+)?%|\[ *\d+%\]"  # tests that have passed
    r"|http://127\.0\.0\.1:\d+/",  # a page to look at
    re.MULTILINE,
)
"""What shows that a line does what it is for."""

INTERRUPTED = (*AFTER_CTRL_C, 0)
"""Exit codes after Ctrl-C: or it had just ended; pytest has 2."""

COMPLAINT = re.compile(r"^Traceback|^Error\b|\bFAILED\b|^E  ", re.MULTILINE)

CHEAP = ("robomend-bench robots-v1 --mode check", "robomend-bench robots-v1 --mode first")
"""Lines that are begun by every run of the tests, by their first words."""


@dataclass(frozen=True)
class Line:
    """One command of a block."""

    block: Block
    typed: str

    def __str__(self) -> str:
        return f"{self.block}: {self.typed}"


LINES = [
    Line(block, shlex.join(words))
    for block in BLOCKS
    if block.how == "begun"
    for words in commands("\n".join(line.removeprefix("$ ") for line in block.text.splitlines()))
]


CIRCUITS = {"b14": "c432", "b15": "c880", "b17": "c1908"}
"""In place of those of ITC-99, which are not ours to give: circuits of the package, under their names."""

HSD = f"""#!{sys.executable}
import sys
from pysat.examples.lbx import LBX
from pysat.formula import WCNF

with LBX(wcnf := WCNF(from_file=sys.argv[-1])) as lister:
    for found in lister.enumerate():
        print("c D:", *(abs(wcnf.soft[number - 1][0]) for number in found), 0, flush=True)
        lister.block(found)
"""
"""In place of HSD, which is on no index: a lister of minimal correction sets."""


@pytest.fixture(scope="session")
def fast_downward(tmp_path_factory: pytest.TempPathFactory) -> str:
    """The planner, from the wheel that `robomend[fast-downward]` has."""
    folder = tmp_path_factory.mktemp("fast-downward")
    pip = [sys.executable, "-m", "pip", "install", "--quiet", "--no-deps", "--target", str(folder)]
    done = subprocess.run([*pip, "up-fast-downward"], capture_output=True, text=True, timeout=600)
    if done.returncode:
        pytest.skip(f"Fast Downward cannot be installed: {done.stderr.strip()[-300:]}")
    driver = folder / "up_fast_downward" / "downward" / "fast-downward.py"
    return f'#!/bin/sh\nexec {shlex.join([sys.executable, str(driver)])} "$@"\n'


@pytest.fixture
def home(tmp_path: Path) -> Path:
    """A folder with what the lines name: circuits, and another solver."""
    circuits = tmp_path / "DIR" / "itc99"
    circuits.mkdir(parents=True)
    for name, ours in CIRCUITS.items():
        shutil.copy(DATA / "iscas85" / f"{ours}.bench", circuits / f"{name}.bench")
    program(tmp_path, "hsd", HSD)
    return tmp_path


def program(home: Path, name: str, text: str) -> None:
    (home / "programs").mkdir(exist_ok=True)
    (home / "programs" / name).write_text(text)
    (home / "programs" / name).chmod(0o755)


@pytest.fixture
def wanted(line: Line, home: Path, request: pytest.FixtureRequest) -> None:
    """What a line wants besides; the test is skipped where that cannot be had."""
    long = request.config.getoption("--long")
    if not (long or line.typed.startswith(CHEAP)):
        pytest.skip("it works for a while: --long")
    if "ros1" in line.typed and (why := ROS1.install()):
        pytest.skip(why)
    if "ros2" in line.typed:
        ros2(KILTED)
    if "fast-downward" in line.typed:
        program(home, "fast-downward", request.getfixturevalue("fast_downward"))


def terminal(typed: str, home: Path) -> Terminal:
    """Type a line as a reader does: in a checkout, or where robomend is installed."""
    programs = f"{home / 'programs'}:{Path(sys.executable).parent}"
    environment = {
        "PATH": f"{programs}:{os.environ['PATH']}",
        "ROBOMEND_VENV": sys.prefix,
        "ROBOMEND_TEST_JOBS": "2",
        "ROBOMEND_RCLPY_PYTHON": str(KILTED.python),
        "BROWSER": "true",  # whoever looks is not here
    }
    return Terminal(typed, ROOT if typed.startswith("./dev") else home, environment)


def until_it_works(begun: Terminal) -> None:
    """Listen until it has shown that it works, or has ended."""
    deadline = time.monotonic() + END_S
    while begun.process.poll() is None:
        begun.listen(0.5)
        if RESULT.search(begun.shown) or begun.processor_s() > AT_WORK_S:
            return
        assert time.monotonic() < deadline, f"{begun.typed}\nshows nothing\n{begun.shown[-2000:]}"


def until_its_end(begun: Terminal, seconds: float) -> int:
    deadline = time.monotonic() + seconds
    while (code := begun.process.poll()) is None:
        begun.listen(0.5)
        assert time.monotonic() < deadline, f"{begun.typed}\ndoes not end\n{begun.shown[-2000:]}"
    begun.listen(0.1)
    return code


@pytest.mark.timeout(1500)
@pytest.mark.usefixtures("wanted")
@pytest.mark.parametrize("line", LINES, ids=str)
def test_a_line_that_takes_minutes_works_and_ends_with_ctrl_c(line: Line, home: Path) -> None:
    typed = line.typed.replace("REVISION", "HEAD")
    ends: tuple[int, ...]
    with terminal(typed, home) as begun:
        until_it_works(begun)
        if begun.process.poll() is None:
            begun.ctrl_c()
            code = until_its_end(begun, END_AFTER_CTRL_C_S)
            ends = (*INTERRUPTED, 2) if "./dev test" in typed else INTERRUPTED
        else:
            code, ends = until_its_end(begun, 0), (0,)
        assert code in ends, f"{typed}\n{begun.shown[-3000:]}"
        assert not COMPLAINT.search(begun.shown), f"{typed}\n{begun.shown[-3000:]}"
        begun.leaves_nothing()
