"""The command `robomend-bench`: run a suite, or compare two runs.

Results go to stdout as Markdown; with --out DIR also as JSON, Markdown and SVG files. Progress goes to
stderr. Exit codes: 0 done, 1 two contenders disagree, 2 bad input, 3 a backend failed.
"""

from __future__ import annotations

import re
import shlex
import sys
from importlib import import_module
from pathlib import Path
from typing import Literal as OneOf

import click
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn

from robomend.diagnosis.engines import ENGINES
from robomend.errors import BackendError, InputError
from robomend_bench.baselines import BASELINES
from robomend_bench.charts import cactus, scaling
from robomend_bench.external import read_external
from robomend_bench.results import Run, as_json, load, save
from robomend_bench.running import run_suite
from robomend_bench.suite import DATA, Clock, External, Wish, find_suite, suite_names
from robomend_bench.tables import comparison, markdown

OTHERS = {
    "export": ("robomend_bench.export_command", "a suite's questions as files for other solvers"),
    "service": ("robomend_bench.service.command", "load on a running service"),
    "robots": ("robomend_bench.robots.command", "the robot's side: observers, and an agent under a service"),
    "batch": ("robomend_bench.batch.command", "logs to diagnoses: rows, messages, workers, memory"),
    "faults": ("robomend_bench.faults.command", "the score: faults planted into simulated robots"),
    "demo": ("robomend_bench.demo", "needless acts of the demo on a busy computer"),
    "mutated": (
        "robomend_bench.mutated",
        "snapshots of circuits with two broken gates, beside other solvers",
    ),
    "isolability": ("robomend_bench.isolability", "which faults can be told apart, on generated robots"),
}
"""Commands of their own: module and summary."""

RANGE = re.compile(r"(\d+)(?:-(\d+))?\Z")


def _range(context: click.Context, parameter: click.Parameter, value: str | None) -> tuple[int, int] | None:
    if value is None:
        return None
    match = RANGE.match(value)
    if match is None:
        raise click.BadParameter("give a number or a range, e.g. 5 or 1-10")
    low, high = int(match[1]), int(match[2] or match[1])
    if not 1 <= low <= high:
        raise click.BadParameter("give a range from 1 up, e.g. 1-10")
    return low, high


def _sizes(
    context: click.Context, parameter: click.Parameter, value: str | None
) -> tuple[int, int] | OneOf["any"] | None:
    return "any" if value == "any" else _range(context, parameter, value)


def _suite(context: click.Context, parameter: click.Parameter, value: str | None) -> str | None:
    if value is not None:
        find_suite(value)
    return value


def _mode(context: click.Context, parameter: click.Parameter, value: str | None) -> str | None:
    suite = context.params.get("suite")  # it is eager: read before
    if value is not None and suite is not None and value not in (modes := find_suite(suite).modes):
        raise click.BadParameter(f"suite {suite} has no mode {value!r}: choose from {', '.join(modes)}")
    return value


def _externals(
    context: click.Context, parameter: click.Parameter, value: tuple[str, ...]
) -> tuple[External, ...]:
    return tuple(map(read_external, value))


def _names(context: click.Context, parameter: click.Parameter, value: str) -> tuple[str, ...]:
    return tuple(dict.fromkeys(name.strip() for name in value.split(",") if name.strip()))


@click.command(context_settings={"help_option_names": ["-h", "--help"]})
@click.argument("suite", required=False, is_eager=True, callback=_suite)
@click.option("--list", "listing", is_flag=True, help="List suites with their modes, and engines.")
@click.option("--mode", callback=_mode, help="What is measured; the suite's first mode if not given.")
@click.option(
    "--engines", callback=_names, default="", help="Contenders, comma-separated: sat,sat:glucose4,rc2."
)
@click.option(
    "--external",
    "externals",
    multiple=True,
    callback=_externals,
    metavar="NAME=FORMAT:COMMAND",
    help="A solver of somebody else as one more contender; the format is wcnf, lp, pddl or strips.",
)
@click.option(
    "--only", callback=_names, default="", help="Groups, comma-separated: circuits, or sizes of robots."
)
@click.option("--instances", type=click.IntRange(1, 100_000), help="Questions a group.")
@click.option(
    "--repeats", type=click.IntRange(1, 1000), default=3, show_default=True, help="Of each question."
)
@click.option("--seed", type=int, default=1, show_default=True)
@click.option(
    "--faults",
    callback=_range,
    metavar="N or N-M",
    help="How many faults are injected.  [default: iscas85: 1-10, or as many as --size needs; robots: 1-4]",
)
@click.option(
    "--size",
    "sizes",
    callback=_sizes,
    metavar="K, K-L or any",
    help="Circuits: only questions of these minimum cardinalities, equally many of each; any: of all, as "
    "they come.  [default: 1-20 in modes for one diagnosis, 1-10 for itc99]",
)
@click.option("--max-size", type=click.IntRange(0, 100), default=2, show_default=True, help="In mode subset.")
@click.option(
    "--timeout",
    type=click.FloatRange(0, min_open=True),
    default=10.0,
    show_default=True,
    help="Seconds a question.",
)
@click.option("--clock", type=click.Choice(["wall", "cpu"]), default="wall", show_default=True)
@click.option(
    "--data",
    type=click.Path(exists=True, file_okay=False, path_type=Path),
    default=DATA,
    show_default="built in",
    help="Folder with iscas85/, observations/, itc99/, iscas89/ or multi_observation/.",
)
@click.option(
    "--out",
    type=click.Path(file_okay=False, path_type=Path),
    help="Write SUITE-MODE.json, .md and .svg here.",
)
@click.option(
    "--format", "output", type=click.Choice(["markdown", "json"]), default="markdown", show_default=True
)
@click.option(
    "--compare",
    nargs=2,
    type=click.Path(exists=True, dir_okay=False, path_type=Path),
    metavar="OLD.json NEW.json",
    help="Two results side by side.",
)
@click.version_option(package_name="robomend", prog_name="robomend-bench")
def command(
    suite: str | None,
    listing: bool,
    mode: str | None,
    engines: tuple[str, ...],
    externals: tuple[External, ...],
    only: tuple[str, ...],
    instances: int | None,
    repeats: int,
    seed: int,
    faults: tuple[int, int] | None,
    sizes: tuple[int, int] | OneOf["any"] | None,
    max_size: int,
    timeout: float,
    clock: Clock,
    data: Path,
    out: Path | None,
    output: str,
    compare: tuple[Path, Path] | None,
) -> None:
    """Measure diagnosis engines side by side on one SUITE.

    \b
    robomend-bench iscas85                  first diagnosis, against RC2
    robomend-bench iscas85 --mode factored --only c7552 --faults 5
    robomend-bench robots-v1 --engines sat,hs_dag --out report/
    robomend-bench iscas85 \\
        --external "rc2-cli=wcnf:python -m pysat.examples.rc2 -vv {file}"
    robomend-bench --compare old.json new.json
    robomend-bench export --help            questions as WCNF, ASP or PDDL
    robomend-bench service --help           load on a running service
    robomend-bench robots --help            observers and agents
    robomend-bench faults --help            the score: robots that break
    robomend-bench isolability --help       which faults can be told apart
    robomend-bench mutated --help           circuits with two broken gates
    """
    if listing:
        _list()
        return
    if compare is not None:
        click.echo(comparison(load(compare[0]), load(compare[1])), nl=False)
        return
    if suite is None:
        raise click.UsageError(f"name a suite: {', '.join(suite_names())}; or --list, or --compare")
    found = find_suite(suite)
    if mode is None:
        mode = next(iter(found.modes))
    wish = Wish(
        mode=mode,
        only=only,
        instances=instances,
        seed=seed,
        faults=faults,
        sizes=sizes,
        max_size=max_size,
        timeout_s=timeout,
        clock=clock,
        data=data,
        external=externals,
    )
    run = _with_progress(suite, wish, engines, repeats)
    if out is not None:
        _write(run, out)
    if output == "json":
        click.echo(as_json(run))
    else:
        click.echo(markdown(run), nl=False)
    if run.disagreements:
        sys.exit(1)


def _with_progress(suite: str, wish: Wish, engines: tuple[str, ...], repeats: int) -> Run:
    columns = (
        TextColumn("{task.description:<34}"),
        BarColumn(),
        MofNCompleteColumn(),
        TimeElapsedColumn(),
    )
    with Progress(*columns, console=Console(stderr=True), transient=True) as bar:
        task = bar.add_task(suite, total=None)
        return run_suite(
            find_suite(suite),
            wish,
            engines,
            repeats=repeats,
            command=shlex.join(["robomend-bench", *sys.argv[1:]]),
            progress=lambda what, done, total: bar.update(
                task, description=what, completed=done, total=total
            ),
        )


def _write(run: Run, out: Path) -> None:
    """Write the run's files; an older run of the same suite and mode is replaced."""
    out.mkdir(parents=True, exist_ok=True)
    stem = f"{run.suite}-{run.mode}"
    save(run, out / f"{stem}.json")
    (out / f"{stem}.md").write_text(markdown(run))
    (out / f"{stem}-cactus.svg").write_text(cactus(run))
    if len({sample.size for sample in run.samples}) > 1:
        (out / f"{stem}-scaling.svg").write_text(scaling(run))
    click.echo(f"written to {out}/{stem}.json, .md and .svg", err=True)


def _list() -> None:
    for name in suite_names():
        suite = find_suite(name)
        click.echo(f"{name}: {suite.summary} (version {suite.version})")
        for mode, meaning in suite.modes.items():
            click.echo(f"    {mode:<10} {meaning} [{','.join(suite.contenders(mode))}]")
    for name, (_, summary) in OTHERS.items():
        click.echo(f"{name}: {summary}; see robomend-bench {name} --help")
    click.echo(f"engines: {', '.join(ENGINES.names())}; each also as ENGINE:SOLVER")
    click.echo(f"baselines: {', '.join(BASELINES)}")


def main() -> None:
    """The console script."""
    try:
        if sys.argv[1:2] and sys.argv[1] in OTHERS:
            name = sys.argv[1]
            other: click.Command = import_module(OTHERS[name][0]).command
            other.main(sys.argv[2:], prog_name=f"robomend-bench {name}", standalone_mode=False)
            return
        command.main(standalone_mode=False)
    except click.exceptions.Abort:
        sys.exit(130)
    except click.ClickException as error:
        error.show()
        sys.exit(2)
    except InputError as error:
        click.echo(f"robomend-bench: {error}", err=True)
        sys.exit(2)
    except BackendError as error:
        click.echo(f"robomend-bench: {error}", err=True)
        sys.exit(3)


if __name__ == "__main__":
    main()
