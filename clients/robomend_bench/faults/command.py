"""The command `robomend-bench faults`: what the service makes of robots that break."""

from __future__ import annotations

import asyncio
import json
import logging
import math
import random
import shlex
import sys
import time
from collections.abc import Callable, Coroutine, Iterator, Mapping, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import fields
from itertools import islice
from pathlib import Path
from typing import Any, TypeVar

import click
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn

from robomend_bench.faults.bench import LATE_S, run_trials
from robomend_bench.faults.exemplars import EXEMPLARS, play_exemplar
from robomend_bench.faults.field import BY_NAME, WORLDS
from robomend_bench.faults.observing import PRESETS, SLOWEST_HZ
from robomend_bench.faults.record import Record, Trial, parse_trial
from robomend_bench.faults.report import Report, beside_json, beside_table
from robomend_bench.faults.robot import find_robot, robot_names
from robomend_bench.faults.scoring import Score, score
from robomend_bench.faults.standins import IN_USE, STANDINS, play_with
from robomend_bench.faults.stretches import STRETCH_BY_NAME, STRETCHES
from robomend_bench.faults.trial import Terms, robot_of
from robomend_bench.service.process import NotReady

NAMES = frozenset(field.name for field in fields(Score))


class OtherTerms(ValueError):
    """The file has scores of another kind of run; the argument says in what they differ."""


class Kept:
    """The scores of a run in pieces: a file that each piece adds to, and that says what is done already.

    A line of JSON each: the first has the terms, which all pieces share, the others a score. What was left
    out or broke is not in it, so that the next piece plays it again.

    `scores` are those of earlier pieces and of this one, by trial.
    """

    def __init__(self, path: Path, terms: Mapping[str, Any]) -> None:
        """Read what is there.

        Raises:
            OtherTerms: the file is of other terms, or no such file at all.
        """
        self.scores: dict[str, Score] = {}
        self._path = path
        lines = path.read_text(encoding="utf-8").splitlines() if path.exists() else []
        if not lines:
            path.write_text(json.dumps({"terms": terms}) + "\n", encoding="utf-8")
            return
        try:
            theirs = json.loads(lines[0])["terms"]
            differ = [
                f"{n}: {theirs.get(n)!r} there, {terms.get(n)!r} now"
                for n in {**theirs, **terms}
                if theirs.get(n) != terms.get(n)
            ]
        except (ValueError, TypeError, KeyError, AttributeError):
            raise OtherTerms(f"{path} is no file of scores") from None
        if differ:
            raise OtherTerms(f"{path} is of another kind of run: {'; '.join(differ)}")
        for number, line in enumerate(lines[1:], start=2):
            try:
                found = json.loads(line)
                score = Score(**{name: value for name, value in found.items() if name in NAMES})
            except (ValueError, TypeError):
                if number == len(lines):  # cut off as it was written: it is played again
                    path.write_text("".join(f"{each}\n" for each in lines[:-1]), encoding="utf-8")
                    return
                raise OtherTerms(f"{path}, line {number}: no score") from None
            self.scores[score.trial] = score

    def add(self, score: Score) -> None:
        """Keep one more."""
        self.scores[score.trial] = score
        with self._path.open("a", encoding="utf-8") as file:
            file.write(json.dumps(score.as_json()) + "\n")


T = TypeVar("T")


def _robots(context: click.Context, parameter: click.Parameter, value: str) -> tuple[str, ...]:
    names = tuple(filter(None, value.split(","))) or robot_names(context.params["world"])
    for name in names:
        try:
            find_robot(name)
        except KeyError:
            known = ", ".join(robot_names("field"))
            raise click.BadParameter(f"there is no robot {name!r}: choose from {known}, made-N") from None
    return names


def _classes(context: click.Context, parameter: click.Parameter, value: str) -> tuple[str, ...]:
    known = (*BY_NAME, *STRETCH_BY_NAME)
    names = tuple(filter(None, value.split(","))) or names_in(context.params["world"])
    for name in names:
        if name not in known:
            raise click.BadParameter(f"there is no class {name!r}: choose from {', '.join(known)}")
    return names


def names_in(world: str) -> tuple[str, ...]:
    """Return the classes of faults and the stretches of a world."""
    faults = (each.name for each in WORLDS[world])
    return (*faults, *(each.name for each in STRETCHES if each.world == world))


def _list(context: click.Context, parameter: click.Parameter, value: bool) -> None:
    """Print what there is to choose from, as tables, and end."""
    if not value or context.resilient_parsing:
        return
    for world, classes in WORLDS.items():
        click.echo(f"\n| class of `--world {world}` | share | what is planted |\n| --- | ---: | --- |")
        for each in classes:
            click.echo(f"| `{each.name}` | {'+' if each.apart else ''}{each.share} | {each.does} |")
        click.echo(f"\n| stretch of `--world {world}` | lasts | what happens |\n| --- | ---: | --- |")
        for stretch in (each for each in STRETCHES if each.world == world):
            click.echo(f"| `{stretch.name}` | {stretch.seconds:g} s | {stretch.does} |")
    click.echo("\n| robot | devices + nodes | topics | |\n| --- | ---: | ---: | --- |")
    for name in robot_names("field"):
        robot = find_robot(name)
        sizes = f"{len(robot.anatomy.devices)} + {len(robot.anatomy.nodes)} | {len(robot.anatomy.topics)}"
        first, _, _ = robot.model.partition("\n")
        about = first[2:] if first.startswith("# ") else "generated: feeds, loops, unwatched topics"
        field_only = "" if name in robot_names() else " In `--world field` only."
        click.echo(f"| `{name}` | {sizes} | {about}{field_only} |")
    context.exit()


def _trial(context: click.Context, parameter: click.Parameter, value: str | None) -> Trial | None:
    if value is None:
        return None
    try:
        trial = parse_trial(value)
        find_robot(trial.robot)
    except (ValueError, KeyError):
        raise click.BadParameter(f"{value!r} is no trial, such as base/hung-node/1.17") from None
    if trial.cls not in (*BY_NAME, *STRETCH_BY_NAME):
        raise click.BadParameter(f"there is no class {trial.cls!r}")
    if trial.cls in BY_NAME and not BY_NAME[trial.cls].faults(find_robot(trial.robot).anatomy):
        raise click.BadParameter(f"{trial.robot} has nothing for {trial.cls}")
    return trial


@click.command("faults", context_settings={"help_option_names": ["-h", "--help"]})
@click.option(
    "--trials", type=click.IntRange(0, 100_000), default=110, show_default=True, help="With faults."
)
@click.option(
    "--stretches", type=click.IntRange(0, 10_000), default=4, show_default=True, help="Without, of each kind."
)
@click.option(
    "--list",
    is_flag=True,
    is_eager=True,
    expose_value=False,
    callback=_list,
    help="Print the classes of faults, the stretches and the robots, with what each is.",
)
@click.option(
    "--world",
    type=click.Choice(list(WORLDS)),
    default="usual",
    show_default=True,
    is_eager=True,
    help="Which classes of faults, stretches and robots: `field` has what people report of theirs.",
)
@click.option("--seed", type=click.IntRange(0), default=1, show_default=True)
@click.option(
    "--robots",
    callback=_robots,
    default="",
    help=f"Comma-separated: {','.join(robot_names('field'))}, made-N.",
)
@click.option(
    "--classes",
    callback=_classes,
    default="",
    help=f"Of faults and stretches, comma-separated: {','.join((*BY_NAME, *STRETCH_BY_NAME))}.",
)
@click.option(
    "--observers",
    type=click.Choice(list(PRESETS)),
    default="published",
    show_default=True,
    help="fast: checked at 10 Hz, silent after 0.5 s, settled after 5 intervals.",
)
@click.option(
    "--topics-hz",
    type=click.FloatRange(SLOWEST_HZ, 50),
    help="One rate for every topic of every robot, instead of each its own; all else stays the same.",
)
@click.option("--load", type=click.IntRange(0, 64), default=0, show_default=True, help="Busy loops beside.")
@click.option(
    "--jobs",
    type=click.IntRange(1, 64),
    show_default="8; 3 with --load",
    help="Robots side by side. More make the bench late.",
)
@click.option(
    "--agent",
    type=click.Choice(["service", *STANDINS, *IN_USE]),
    default="service",
    show_default=True,
    help="Who repairs: the service, or a scripted stand-in: what can be reached, what idling gets.",
)
@click.option(
    "--beside",
    is_flag=True,
    help="The same faults for what people use today as well, in one table: faults only.",
)
@click.option(
    "--boots",
    is_flag=True,
    help="The service sees each robot being switched on, some seconds before its fault.",
)
@click.option(
    "--exemplar",
    type=click.Choice(EXEMPLARS),
    help="Instead: an exemplar of others with its published scenarios; `sunset` beside its authors' rules.",
)
@click.option("--only-trial", callback=_trial, help="Play one trial and print all that happened in it.")
@click.option(
    "--verbose", is_flag=True, help="Print all that happened in each trial, with the service's accounts."
)
@click.option(
    "--out",
    type=click.Path(file_okay=False, path_type=Path),
    help="Write faults-OBSERVERS.json and .md here, and the record of each trial that went wrong.",
)
@click.option(
    "--keep",
    type=click.Path(dir_okay=False, path_type=Path),
    help="A run in pieces: add each score to this file, play only what is not in it, report all.",
)
@click.option("--minutes", type=click.FloatRange(0, min_open=True), help="Begin no trial after so long.")
@click.option("--format", "output", type=click.Choice(["markdown", "json"]), default="markdown")
def command(
    trials: int,
    stretches: int,
    world: str,
    seed: int,
    robots: tuple[str, ...],
    classes: tuple[str, ...],
    observers: str,
    topics_hz: float | None,
    load: int,
    jobs: int | None,
    agent: str,
    beside: bool,
    boots: bool,
    exemplar: str | None,
    only_trial: Trial | None,
    verbose: bool,
    out: Path | None,
    keep: Path | None,
    minutes: float | None,
    output: str,
) -> None:
    """Plant faults into simulated robots and score what `robomend serve` makes of them.

    \b
    robomend-bench faults                              110 faults and 20 stretches without, about 6 minutes
    robomend-bench faults --list                       classes of faults, stretches, robots
    robomend-bench faults --trials 330 --observers fast --out report/
    robomend-bench faults --classes mute-successor --trials 100
    robomend-bench faults --classes boot --stretches 20
    robomend-bench faults --observers fast --topics-hz 10
    robomend-bench faults --world field                what people report of their robots
    robomend-bench faults --beside                     beside what people use today
    robomend-bench faults --exemplar sunset            the exemplars of others, also suave
    robomend-bench faults --load 4                     on a busy computer
    robomend-bench faults --agent perfect              what can be reached
    robomend-bench faults --only-trial base/hung-node/1.17
    robomend-bench faults --trials 1100 --keep scores.jsonl --minutes 9     again until all are in

    What each figure means: docs/score.md.
    """
    if exemplar is not None:
        with _errors_alone("robomend_client"):
            told = play_exemplar(exemplar, scenarios=min(trials, 50), jobs=jobs or 2, verbose=verbose)
        click.echo(json.dumps(told.as_json(), indent=1) if output == "json" else told.markdown())
        return
    terms = Terms(observers, accounts=verbose or only_trial is not None, boots=boots, topics_hz=topics_hz)
    stretches = 0 if beside else stretches
    wanted = [only_trial] if only_trial else list(choose(trials, stretches, seed, robots, classes))
    everything = list(wanted)
    if not wanted:
        raise click.UsageError("none of these robots takes part in any of these classes")
    jobs = jobs or (3 if load else 8)
    setting = {"observers": observers, "agent": agent, "load": load, **({"boots": True} if boots else {})}
    setting |= {} if topics_hz is None else {"topics_hz": topics_hz}
    kept = None if keep is None else _kept(keep, setting)
    names = [str(trial) for trial in wanted]
    earlier = {} if kept is None else {name: kept.scores[name] for name in names if name in kept.scores}
    wanted = [trial for trial in wanted if str(trial) not in earlier]
    began = time.monotonic()
    report = Report(
        command=shlex.join(["robomend-bench", "faults", *sys.argv[2:]]),
        observers=observers,
        agent={"service": "the service"}.get(agent, f"stand-in {agent}"),
        load=load,
        jobs=jobs,
        scores=[*earlier.values()],
        late=[],
        errors=[],
        again=lambda trial: _again(trial, terms, agent),
        topics_hz=topics_hz,
    )

    def take_in(record: Record) -> None:
        counted = len(report.scores)
        judge([record], report, waits=beside)
        if kept is not None and len(report.scores) > counted:
            kept.add(report.scores[-1])

    until_s = math.inf if minutes is None else began + 60 * minutes
    try:
        with _errors_alone("robomend_client"):  # some stretches are about a service that is away for a moment
            records, report.ticks = _play(wanted, terms, agent, jobs, load, until_s, take_in)
    except NotReady as error:
        click.echo(f"robomend-bench: the service did not start: {error}", err=True)
        sys.exit(3)
    report.scores.sort(key=lambda score: names.index(score.trial))
    report.seconds = time.monotonic() - began
    report.not_begun = len(wanted) - len(records)
    if out is not None:
        _write(out, records, report)
    if verbose and only_trial is None:
        for record in records:
            click.echo("\n".join((str(record.trial), *record.lines(), "")), err=True)
    rows: dict[str, list[Score]] = {}
    if beside:
        rows = {"robomend" if agent == "service" else agent: report.group("faults")}
        counted = {score.trial for score in report.group("faults")}
        same = [trial for trial in everything if str(trial) in counted]
        rows |= {says: _scores_of(name, same, terms) for name, says in IN_USE.items()}
    if output == "json":
        click.echo(
            json.dumps({**report.as_json(), **({"beside": beside_json(rows)} if rows else {})}, indent=1)
        )
    elif rows:
        click.echo("\n".join(beside_table(rows)))
    elif only_trial is not None:
        for record in records:
            click.echo("\n".join(record.lines()))
        click.echo(json.dumps(report.as_json()["scores"] or report.as_json()["errors"], indent=1))
    else:
        click.echo(report.markdown(), nl=False)
    if report.errors:
        sys.exit(3)


def _scores_of(standin: str, trials: Sequence[Trial], terms: Terms) -> list[Score]:
    """Return what a stand-in makes of the faults among the trials; its clock is simulated."""
    found = Report("", terms.observers, standin, 0, 1, [], [], [])
    judge([play_with(standin, trial, terms) for trial in trials], found)
    return found.group("faults")


def choose(
    trials: int, stretches: int, seed: int, robots: Sequence[str], classes: Sequence[str]
) -> Iterator[Trial]:
    """Yield the trials of a run, stretches among the faults.

    Classes come from a shuffled deck that holds each as often as its share says, so that each 110 trials
    have exactly those shares; the robot is any that takes part, a stretch's each in turn.
    """
    chance = random.Random(f"trials {seed}")
    found = list(islice(_faults(seed, robots, classes, chance), trials))
    kinds = [stretch.name for stretch in STRETCHES if stretch.name in classes]
    offset = chance.randrange(len(robots))
    for kind in kinds:
        for number in range(stretches):
            found.append(Trial(robots[(offset + number) % len(robots)], kind, seed, number))
    chance.shuffle(found)
    yield from found


def _faults(
    seed: int, robots: Sequence[str], classes: Sequence[str], chance: random.Random
) -> Iterator[Trial]:
    able = {
        each.name: [name for name in robots if each.faults(find_robot(name).anatomy)]
        for each in BY_NAME.values()
        if each.name in classes
    }
    cards = [each.name for each in BY_NAME.values() for _ in range(each.share) if able.get(each.name)]
    number = 0
    while cards:
        deck = cards.copy()
        chance.shuffle(deck)
        for name in deck:
            yield Trial(chance.choice(able[name]), name, seed, number)
            number += 1


def judge(records: Sequence[Record], report: Report, *, waits: bool = False) -> None:
    """Score the records into the report; those that are no measurements are named, with the reason.

    Where the computer is kept busy on purpose, in the field, and where others have the same faults (`waits`),
    that the service has to wait is measured.
    """
    for record in records:
        if record.error:
            report.errors.append((str(record.trial), record.error))
            continue
        robot = robot_of(record.trial, report.topics_hz)
        may_wait = waits or report.load or robot.world == "field"
        if (late_s := max(record.late_s, 0.0 if may_wait else record.starved_s)) > LATE_S:
            report.late.append((str(record.trial), late_s))
        else:
            report.scores.append(score(record, robot))


def _kept(path: Path, terms: dict[str, Any]) -> Kept:
    try:
        return Kept(path, terms)
    except OtherTerms as error:
        raise click.UsageError(str(error)) from None


def _play(
    trials: Sequence[Trial],
    terms: Terms,
    agent: str,
    jobs: int,
    load: int,
    until_s: float,
    take_in: Callable[[Record], None],
) -> tuple[list[Record], list[float]]:
    """Play trials; `take_in` is called with each record, in a thread: it may take longer than a tick."""
    columns = (TextColumn("{task.description:<40}"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn())
    with (
        Progress(*columns, console=Console(stderr=True), transient=True) as bar,
        ThreadPoolExecutor(1) as thread,
    ):
        task = bar.add_task("faults", total=len(trials))
        taken: list[Future[None]] = []

        def done(record: Record) -> None:
            bar.update(task, advance=1, description=str(record.trial))
            taken.append(thread.submit(take_in, record))

        records: list[Record] = []
        ticks: list[float] = []
        if agent == "service":
            work = run_trials(trials, terms, jobs=jobs, load=load, done=done, until_s=until_s)
            records, ticks = _run(work)
        else:
            for trial in trials:
                if time.monotonic() < until_s:
                    records.append(play_with(agent, trial, terms))
                    done(records[-1])
        for each in taken:
            each.result()
        return records, ticks


@contextmanager
def _errors_alone(name: str) -> Iterator[None]:
    """Let a logger say nothing below an error, and afterwards what it said before."""
    logger = logging.getLogger(name)
    before = logger.level
    logger.setLevel(logging.ERROR)
    try:
        yield
    finally:
        logger.setLevel(before)


def _run(work: Coroutine[Any, Any, T]) -> T:
    try:
        import uvloop
    except ImportError:
        return asyncio.run(work)
    return uvloop.run(work)


def _again(trial: str, terms: Terms, agent: str) -> str:
    options = [] if terms.observers == "published" else ["--observers", terms.observers]
    options += [] if terms.topics_hz is None else ["--topics-hz", f"{terms.topics_hz:g}"]
    options += [] if agent == "service" else ["--agent", agent]
    options += ["--boots"] if terms.boots else []
    return shlex.join(["robomend-bench", "faults", "--only-trial", trial, *options])


def _write(out: Path, records: Sequence[Record], report: Report) -> None:
    """Write the report, and the record of each trial that did not end as it should."""
    out.mkdir(parents=True, exist_ok=True)
    stem = f"faults-{report.observers}"
    (out / f"{stem}.json").write_text(json.dumps(report.as_json(), indent=1))
    (out / f"{stem}.md").write_text(report.markdown())
    scores = [s for s in report.scores if not (s.credited or s.called_healthy or s.left_stopped)]
    well = {s.trial for s in scores if s.group != "healthy" and s.right and not s.wrong}
    well |= {s.trial for s in scores if s.group == "healthy" and not s.acts and not s.alarms}
    folder = out / f"{stem}-records"
    folder.mkdir(exist_ok=True)
    for old in folder.glob("*.txt"):
        old.unlink()
    for record in records:
        if str(record.trial) not in well:
            name = str(record.trial).replace("/", "-")
            text = "\n".join((str(record.trial), record.error, *record.lines())) + "\n"
            (folder / f"{name}.txt").write_text(text)
    click.echo(f"written to {out}/{stem}.json, .md and {folder.name}/", err=True)
