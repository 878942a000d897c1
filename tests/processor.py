"""./dev processor REVISION: the processor time of robomend-bench's suites, this tree against another.

Both run in turns, in pairs, the first of a pair changing each time: what else the machine does falls on both.
Counted is user and system time of a run with all its processes, start included; on a busy machine that
stays what it is, as wall-clock time does not. Told is the geometric mean of this tree's over the other's.
Both are compiled before the first run, or the tree that was just unpacked would be charged for it.

    ./dev processor v0.1.0                 all suites, seven pairs
    ./dev processor HEAD~1 --pairs 10 --only plans,service
    ./dev processor HEAD~1 --keep pairs.ndjson     ended in the middle, the same command goes on
"""

from __future__ import annotations

import argparse
import json
import os
import resource
import subprocess
import sys
import tempfile
from collections.abc import Iterator, Sequence
from pathlib import Path
from statistics import geometric_mean

ROOT = Path(__file__).resolve().parents[1]
SOURCES = ("service", "clients", "board_emulator")

BENCH = ("-m", "robomend_bench.main")
SUITES = {
    "iscas85": (*BENCH, "iscas85", "--only", "c432,c880,c1908", "--instances", "10", "--repeats", "1"),
    "robots-v1": (*BENCH, "robots-v1", "--only", "100,1000,3000", "--instances", "25", "--repeats", "5"),
    "plans": (*BENCH, "plans", "--only", "tedusar,robot-100", "--instances", "3",
              "--engines", "pyperplan,asp"),
    "service": (*BENCH, "service", "--only", "single,fleet,ndjson", "--robots", "200", "--seconds", "6",
                "--changes", "200", "--observations", "50000"),
}  # fmt: skip
"""Suite -> the arguments of Python; each takes some seconds, and does the same work every time."""

OURS = ("--engines", "sat", "--clock", "cpu")
"""For the suites of engines: the contenders' time is not ours."""


def processor_s(tree: Path, arguments: Sequence[str]) -> float:
    """Run Python in a tree, with the code of that tree; return the processor time of all its processes.

    Raises:
        subprocess.CalledProcessError: it failed.
    """
    path = os.pathsep.join(str(tree / source) for source in SOURCES)
    environment = {**os.environ, "PYTHONPATH": path}
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    subprocess.run(
        [sys.executable, *arguments], cwd=tree, env=environment, check=True, stdout=subprocess.DEVNULL
    )
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return after.ru_utime - before.ru_utime + after.ru_stime - before.ru_stime


def compile_code(tree: Path) -> None:
    """Have Python's compiled files there, whatever the environment says of writing them."""
    command = [sys.executable, "-m", "compileall", "-q", *(str(tree / source) for source in SOURCES)]
    subprocess.run(command, check=True, stdout=subprocess.DEVNULL)


def ratios(ours: Path, other: Path, arguments: Sequence[str], pairs: range) -> Iterator[float]:
    """Yield our time over the other's, of each pair."""
    for tree in (ours, other):
        compile_code(tree)
    for pair in pairs:
        order = (ours, other) if pair % 2 else (other, ours)
        took = {tree: processor_s(tree, arguments) for tree in order}
        yield took[ours] / took[other]


class Kept:
    """The pairs that were run so far, in a file: a line for each."""

    def __init__(self, file: Path | None, revision: str) -> None:
        self._file = file
        self._revision = revision

    def of(self, suite: str) -> list[float]:
        """Return the ratios of a suite against this revision."""
        if self._file is None or not self._file.exists():
            return []
        lines = map(json.loads, self._file.read_text().splitlines())
        return [one["ratio"] for one in lines if (one["suite"], one["of"]) == (suite, self._revision)]

    def add(self, suite: str, ratio: float) -> None:
        """Write a pair down."""
        if self._file is not None:
            with self._file.open("a") as kept:
                kept.write(json.dumps({"suite": suite, "of": self._revision, "ratio": ratio}) + "\n")


def read_options(arguments: Sequence[str] | None) -> argparse.Namespace:
    """Return what was asked for."""
    parser = argparse.ArgumentParser(prog="./dev processor", description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("revision")
    parser.add_argument("--pairs", type=int, default=7)
    parser.add_argument("--keep", type=Path, help="a file of the pairs that were run, for the next time")
    parser.add_argument("--only", default=",".join(SUITES), help="suites, comma-separated")
    return parser.parse_args(arguments)


def main(arguments: Sequence[str] | None = None) -> int:
    """Compare this tree, as it lies there, with a revision."""
    asked = read_options(arguments)
    with tempfile.TemporaryDirectory() as folder:
        archive = subprocess.run(
            ["git", "archive", asked.revision], cwd=ROOT, check=True, stdout=subprocess.PIPE
        ).stdout
        subprocess.run(["tar", "x", "-C", folder], input=archive, check=True)
        for suite in asked.only.split(","):
            options = OURS if suite in {"iscas85", "robots-v1"} else ()
            kept = Kept(asked.keep, asked.revision)
            found = kept.of(suite)[: asked.pairs]
            left = range(len(found), asked.pairs)
            for ratio in ratios(ROOT, Path(folder), (*SUITES[suite], *options), left):
                kept.add(suite, ratio)
                found.append(ratio)
            each = " ".join(f"{ratio:.3f}" for ratio in found)
            print(f"{suite}: {geometric_mean(found):.3f} of {asked.revision} ({each})", flush=True)
    return 0


if __name__ == "__main__":
    try:
        sys.exit(main())
    except KeyboardInterrupt:
        sys.exit(130)
