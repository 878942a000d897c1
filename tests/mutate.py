"""./dev mutate ROOM: which slips of the pen would no test of a room notice?

A mutant is the code with one small change (mutants.py). A copy of the tree runs the room's own tests against
one after the other, the test that mirrors the module first; what they pass is a survivor: a rule that no test
states, or a change that changes nothing. The latter are listed in equivalent_mutants.toml, with the reason.

    ./dev mutate planning --count 20 --seed 1
    ./dev mutate planning --file choice.py --count 0      all of one file
    ./dev mutate planning --since v0.1.0                  only of lines that were written since a revision

Killed is what fails a test, breaks the import, or takes three times as long as the code itself (and 60 s).
"""

from __future__ import annotations

import argparse
import contextlib
import os
import random
import re
import shutil
import signal
import subprocess
import sys
import tempfile
import time
import tomllib
from collections.abc import Sequence
from itertools import count
from pathlib import Path

from tests.mutants import Mutant, mutants

ROOT = Path(__file__).resolve().parents[1]
SOURCES = ("service", "clients", "board_emulator")
COPIED = (*SOURCES, "tests", "encodings", "pddl", "examples", "docs", "pyproject.toml", "dev")
EQUIVALENT = Path(__file__).with_name("equivalent_mutants.toml")

ROOMS = {
    "model": (("service/robomend/model",), ("tests/model",)),
    "observations": (("service/robomend/observations",), ("tests/observations",)),
    "diagnosis": (("service/robomend/diagnosis",), ("tests/diagnosis",)),
    "planning": (("service/robomend/planning",), ("tests/planning",)),
    "execution": (
        ("service/robomend/cycle.py", "service/robomend/repairs/execution.py",
         "service/robomend/repairs/execution_values.py", "service/robomend/repairs/looking.py"),
        ("tests/test_cycle.py", "tests/repairs/test_execution.py", "tests/repairs/test_execution_answers.py",
         "tests/repairs/test_execution_effects.py", "tests/repairs/test_looking.py"),
    ),
    "board": (("service/robomend/board",), ("tests/board",)),
}  # fmt: skip
"""A room -> the code that is changed, and the tests that should notice."""


def equivalent() -> dict[tuple[str, str, str, str], str]:
    """Return the keys of mutants -> why no test can tell them from the code."""
    listed = tomllib.loads(EQUIVALENT.read_text(encoding="utf-8")).get("mutant", [])
    return {(one["file"], one["line"], one["was"], one["becomes"]): one["reason"] for one in listed}


HUNK = re.compile(r"^@@ -\S+ \+(\d+)(?:,(\d+))? @@")


def written_since(revision: str, root: Path = ROOT) -> dict[str, set[int]]:
    """Return the lines of each file that are not as they were at a revision: committed, staged or not.

    Raises:
        subprocess.CalledProcessError: there is no such revision.
    """
    command = ["git", "diff", "--unified=0", "--no-color", "--no-ext-diff", "--no-prefix", revision, "--"]
    changed: dict[str, set[int]] = {}
    for line in subprocess.run(command, cwd=root, check=True, capture_output=True, text=True).stdout.split(
        "\n"
    ):
        if line.startswith("+++ "):
            lines = changed.setdefault(line[4:], set())
        elif found := HUNK.match(line):
            begin, many = int(found[1]), int(found[2] or 1)
            lines.update(range(begin, begin + many))
    return changed


def of_room(room: str, only: str | None = None) -> list[Mutant]:
    """Return the mutants of a room, or of those of its files whose path ends with `only`."""
    files: list[Path] = []
    for place in ROOMS[room][0]:
        path = ROOT / place
        files += sorted(path.rglob("*.py")) if path.is_dir() else [path]
    named = [(file, str(file.relative_to(ROOT))) for file in files]
    return [
        mutant
        for file, name in named
        if only is None or name.endswith(only)
        for mutant in mutants(file.read_text(encoding="utf-8"), name)
    ]


class Copy:
    """A copy of the tree, in which one file at a time is changed."""

    def __init__(
        self, root: Path, copied: Sequence[str] = COPIED, stages: Sequence[Sequence[str]] = (["--quick"], [])
    ) -> None:
        self.root = root
        self.stages = stages  # pytest's options, from the quick to the thorough
        self._times = count(1_000_000_000, 10)  # each change is seen, whatever the clock's resolution
        for name in copied:
            source, target = ROOT / name, root / name
            if source.is_dir():  # with what is compiled, which stays good for files that are not changed
                shutil.copytree(source, target, ignore=shutil.ignore_patterns("*.pyc.*"))  # in the making
            else:
                shutil.copy2(source, target)

    def passes(self, tests: Sequence[str], timeout_s: float | None, *options: str) -> bool:
        """Return whether the tests pass in time, against the code as it is in the copy."""
        path = os.pathsep.join(str(self.root / source) for source in SOURCES)
        line = [sys.executable, "-m", "pytest", "-q", "-x", "-n0", "-p", "no:cacheprovider", *options, *tests]
        run = subprocess.Popen(
            line, cwd=self.root, env={**os.environ, "PYTHONPATH": path}, start_new_session=True,
            stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
        )  # fmt: skip
        try:
            return run.wait(timeout_s) == 0
        except subprocess.TimeoutExpired:
            return False
        finally:
            with contextlib.suppress(ProcessLookupError):
                os.killpg(run.pid, signal.SIGKILL)  # whatever the tests started
            run.wait()

    def survives(self, mutant: Mutant, tests: Sequence[str], timeout_s: float) -> bool:
        """Return whether the tests pass against a mutant: first those that are quick, then all."""
        file = self.root / mutant.file
        before = file.read_bytes()
        try:
            self._write(file, before[: mutant.start] + mutant.becomes.encode() + before[mutant.end :])
            return all(self.passes(tests, timeout_s, *options) for options in self.stages)
        finally:
            self._write(file, before)

    def _write(self, file: Path, text: bytes) -> None:
        file.write_bytes(text)
        os.utime(file, (now := next(self._times), now))


def ordered(file: str, tests: Sequence[str]) -> list[str]:
    """Return the tests of a room, those that mirror the module first."""
    mirrors = [
        str(found.relative_to(ROOT))
        for place in tests
        if (ROOT / place).is_dir()
        for found in sorted((ROOT / place).rglob(f"test_{Path(file).stem}*.py"))
    ]
    return [*mirrors, *tests]


def main(arguments: Sequence[str] | None = None) -> int:
    """Run a sample of a room's mutants; return 1 if one survives that is not known to be equivalent."""
    parser = argparse.ArgumentParser(prog="./dev mutate", description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("room", choices=ROOMS)
    parser.add_argument("--count", type=int, default=10, help="how many; 0: all (default 10)")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--file", help="only of the file whose path ends so")
    parser.add_argument("--since", metavar="REVISION", help="only of lines written since a revision of Git")
    asked = parser.parse_args(arguments)
    known = equivalent()
    every = of_room(asked.room, asked.file)
    if asked.since is not None:
        lines = written_since(asked.since)
        every = [one for one in every if one.line in lines.get(one.file, ())]
    drawn = random.Random(asked.seed).sample(every, min(asked.count or len(every), len(every)))
    some = [one for one in drawn if one.key not in known]  # afterwards: a name more, and the sample stays
    tests = ROOMS[asked.room][1]
    survivors = 0
    with tempfile.TemporaryDirectory() as folder:
        copy = Copy(Path(folder))
        began = time.monotonic()
        if not copy.passes(tests, None):
            print("the tests fail without any change")
            return 2
        timeout_s = 60 + 3 * (time.monotonic() - began)
        for mutant in some:
            survived = copy.survives(mutant, ordered(mutant.file, tests), timeout_s)
            survivors += survived
            print(f"{'SURVIVED' if survived else 'killed  '} {mutant}", flush=True)
    print(
        f"{len(some) - survivors} killed, {survivors} alive, {len(drawn) - len(some)} named as equivalent "
        f"of {len(drawn)}; {len(every)} mutants in all, seed {asked.seed}"
    )
    return 1 if survivors else 0


if __name__ == "__main__":
    sys.exit(main())
