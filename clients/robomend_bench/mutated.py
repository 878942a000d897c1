"""The command `robomend-bench mutated`: several observations of circuits in which two gates are broken.

Where few gates explain all that was seen, the published instances are soon done. With two gates broken there
are hundreds of pairs and triples, and more than can be listed of four gates and up. So it is counted how many
diagnoses of each size, up to a bound, are listed in the same processor time: by the snapshot engine, and by a
solver of somebody else that reads the published form (robomend.diagnosis.wcnf) and prints `c D: 7 16 0` for a
diagnosis as soon as it has it. Reading the file counts for both.

An instance is drawn by the seed, its circuit and its number.
"""

from __future__ import annotations

import json
import random
import re
import resource
import shlex
import signal
import subprocess
import time
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from threading import Event, Thread

import click

from robomend.diagnosis.result import Options
from robomend.diagnosis.snapshots import SnapshotEngine
from robomend.diagnosis.wcnf import read_wcnf
from robomend.errors import InputError
from robomend.model.cnf import HealthCnf
from robomend.model.loading import load_text
from robomend_bench.generator import observe_mutated, read_circuit
from robomend_bench.suite import DATA
from robomend_client.counts import counted
from robomend_client.literals import Literal

CIRCUITS = ("c432", "c499", "c880", "c1908", "c2670", "c3540", "c5315", "c7552")

OBSERVATIONS = 100
"""As the published instances have."""

FAULTS = 2

DIAGNOSIS = re.compile(r"c D: ((?:\d+ )+)0\s*$")

GRACE_S = 60
"""Wall-clock time beyond the processor time, by this and as a factor of it, after which a solver is ended."""
GRACE = 20

Sizes = dict[int, int]
"""Size -> how many diagnoses of it were listed."""


@dataclass(frozen=True, slots=True)
class Compared:
    """One instance: what each listed, and whether ours was all there is up to the bound."""

    instance: str
    ours: Sizes
    complete: bool
    seconds: float
    theirs: Sizes | None

    @property
    def behind(self) -> bool:
        """Whether the other listed more of some size."""
        return self.theirs is not None and any(
            count > self.ours.get(size, 0) for size, count in self.theirs.items()
        )


@click.command("mutated")
@click.option(
    "--only",
    multiple=True,
    type=click.Choice(("c17", *CIRCUITS)),
    help="Circuits; repeatable.  [default: all but c17]",
)
@click.option("--instances", default=5, show_default=True, type=click.IntRange(1, 1000), help="A circuit.")
@click.option("--seed", default=1, show_default=True)
@click.option("--max-size", default=3, show_default=True, type=click.IntRange(1, 20))
@click.option(
    "--timeout",
    default=10,
    show_default=True,
    type=click.IntRange(1, 3600),
    help="Processor seconds of each.",
)
@click.option(
    "--against", metavar="COMMAND", help="A solver of somebody else, {file} where the instance goes."
)
@click.option(
    "--out", type=click.Path(file_okay=False, path_type=Path), help="Keep the instances here, as WCNF."
)
@click.option("--format", "output", type=click.Choice(["markdown", "json"]), default="markdown")
def command(
    only: tuple[str, ...],
    instances: int,
    seed: int,
    max_size: int,
    timeout: int,
    against: str | None,
    out: Path | None,
    output: str,
) -> None:
    """Count the diagnoses of each size that are listed in the same processor time.

    Exit code 1: the other solver listed more of a size although ours says that it has all.
    """
    if against is not None and "{file}" not in against:
        raise click.BadParameter("say {file} where the instance goes", param_hint="--against")
    told = []
    with TemporaryDirectory() as scratch:
        folder = out or Path(scratch)
        folder.mkdir(parents=True, exist_ok=True)
        if output == "markdown":
            click.echo("| instance | ours, of size 1, 2, … | complete | processor s | the other | behind |")
            click.echo("| --- | --- | --- | ---: | --- | --- |")
        for path in _instances(only or CIRCUITS, instances, seed, folder):
            ours, complete, seconds = _ours(path, max_size, timeout)
            theirs = None if against is None else _theirs(against, path, max_size, timeout)
            row = Compared(path.stem, ours, complete, round(seconds, 2), theirs)
            told.append(row)
            if output == "markdown":
                click.echo(_line(row, max_size))
    if output == "json":
        click.echo(json.dumps([{**asdict(row), "behind": row.behind} for row in told]))
    elif against is not None:
        level = sum(not row.behind for row in told)
        of = counted(len(told), "instance")
        click.echo(f"\nAt least as many of each size up to {max_size} on {level} of {of}.")
    if any(row.behind and row.complete for row in told):
        raise SystemExit(1)


def _instances(circuits: Sequence[str], count: int, seed: int, folder: Path) -> Iterator[Path]:
    for name in circuits:
        source = DATA / "iscas85" / f"{name}.bench"
        if not source.is_file():
            raise InputError(f"no circuit {name}: choose from {', '.join(CIRCUITS)}")
        text = source.read_text()
        circuit, cnf = read_circuit(text), load_text(text, name=name, format="bench").cnf
        for number in range(count):
            chance = random.Random(f"mutated {seed} {name} {number}")
            path = folder / f"{name}-{number}.wcnf"
            path.write_text(as_wcnf(cnf, observe_mutated(circuit, FAULTS, OBSERVATIONS, chance)))
            yield path


def as_wcnf(cnf: HealthCnf, snapshots: Sequence[Sequence[Literal]]) -> str:
    """Return a system and what was seen of it in the form of the published instances."""
    n = len(cnf.components)
    top = n + 1
    lines = [f"c {cnf.name}, {FAULTS} gates broken"]
    for snapshot in snapshots:  # a net that no gate reads or drives is in no clause
        numbers = [number for literal in snapshot if (number := cnf.literal(literal)) is not None]
        lines.append(f"o {' '.join(map(str, numbers))} 0")
    lines.append(f"p wcnf {cnf.variables} {n + len(cnf.clauses)} {top}")
    lines += [f"1 {variable} 0" for variable in range(1, top)]
    lines += [f"{top} {' '.join(map(str, clause))} 0" for clause in cnf.clauses]
    return "\n".join(lines) + "\n"


def _ours(path: Path, max_size: int, timeout_s: int) -> tuple[Sizes, bool, float]:
    began = time.process_time()
    read = read_wcnf(path)
    engine = SnapshotEngine(read.cnf)
    done = Event()
    watching = Thread(target=_interrupt, args=(engine, began + timeout_s, done), daemon=True)
    watching.start()
    try:
        options = Options(limit=None, max_size=max_size, timeout_s=None, conflicts=False)
        result = engine.diagnose(read.snapshots, options)
    finally:
        done.set()
        watching.join()
        engine.close()
    sizes = Counter(len(diagnosis.bad) for diagnosis in result.diagnoses)
    return dict(sorted(sizes.items())), result.stopped_by in (None, "size"), time.process_time() - began


def _interrupt(engine: SnapshotEngine, deadline: float, done: Event) -> None:
    """Stop the engine when this process has used so much processor time."""
    while (left := deadline - time.process_time()) > 0:
        if done.wait(max(0.01, left)):
            return
    engine.interrupt()


def _theirs(against: str, path: Path, max_size: int, timeout_s: int) -> Sizes:
    def bounded() -> None:
        resource.setrlimit(resource.RLIMIT_CPU, (timeout_s, timeout_s + 1))
        signal.signal(signal.SIGXCPU, signal.SIG_DFL)

    line = [part.replace("{file}", str(path)) for part in shlex.split(against)]
    try:
        printed = subprocess.run(
            line,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            preexec_fn=bounded,
            timeout=GRACE * timeout_s + GRACE_S,
        ).stdout
    except OSError as error:
        raise InputError(f"{line[0]}: {error.strerror}") from error
    except subprocess.TimeoutExpired as late:
        printed = late.stdout or b""
    listed = {
        frozenset(found[1].split())
        for text in printed.decode(errors="replace").splitlines()
        if (found := DIAGNOSIS.match(text))
    }
    sizes = Counter(map(len, listed))
    return {size: count for size, count in sorted(sizes.items()) if size <= max_size}


def _line(row: Compared, max_size: int) -> str:
    def counts(sizes: Sizes | None) -> str:
        return "-" if sizes is None else ", ".join(str(sizes.get(size, 0)) for size in range(1, max_size + 1))

    complete, behind = ("yes" if value else "no" for value in (row.complete, row.behind))
    cells = (row.instance, counts(row.ours), complete, str(row.seconds), counts(row.theirs), behind)
    return f"| {' | '.join(cells)} |"
