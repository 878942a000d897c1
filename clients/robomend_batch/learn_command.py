"""`robomend-batch learn`: logs of a healthy robot in, a first model and its observers out."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click

from robomend.cli.files import ExistingFile
from robomend.errors import InputError
from robomend_batch.found import find_logs
from robomend_client.counts import counted

if TYPE_CHECKING:
    from robomend_batch.learn.learning import LearnedDraft
    from robomend_client.ros_graph import RosGraph

MODEL, OBSERVERS = "model.yaml", "observers.yaml"

BAD_INPUT = 2


@click.command("learn")
@click.argument("logs", nargs=-1, required=True, metavar="GOOD...")
@click.option(
    "--out",
    "-o",
    type=click.Path(file_okay=False, path_type=Path),
    help=f"Folder for {MODEL} and {OBSERVERS}.",
)
@click.option("--update", type=ExistingFile(), help="An agent's file: print a diff of what to change.")
@click.option("--name", default="robot", show_default=True, help="The model's name.")
@click.option(
    "--false-alarms-per-hour",
    "per_hour",
    type=click.FloatRange(1e-6, 1000),
    default=0.1,
    show_default=True,
    help="Of all observers together, aimed at.",
)
@click.option("--ros1", metavar="URI", help="Master of the running robot: who publishes and who listens.")
@click.option(
    "--ros2",
    metavar="DOMAIN",
    type=click.IntRange(0, 232),
    help="The same of a robot with ROS 2, whose recordings do not name publishers.",
)
@click.option("--overwrite", is_flag=True, help="Replace a draft that is there.")
@click.option("--quiet", "-q", is_flag=True, help="Say nothing on stderr but what is wrong.")
def command(
    logs: tuple[str, ...],
    out: Path | None,
    update: Path | None,
    name: str,
    per_hour: float,
    ros1: str | None,
    ros2: int | None,
    overwrite: bool,
    quiet: bool,
) -> int:
    """Learn a first model and observers from GOOD: recordings (.bag, .mcap, .db3) of a healthy robot.

    One part of the logs is held back, and the observers are run over it: the false alarms there are told, and
    stand in the draft beside what each number rests on. What no log says (which device a node drives) is a
    question in a comment. Exit code 2 says that a log was bad; the others are learned from nevertheless.

    \b
    robomend-batch learn good/*.bag -o draft
    robomend-batch learn good/*.mcap -o draft --ros2 0
    robomend-batch run night/ -o out \\
        -m draft/model.yaml --observers draft/observers.yaml
    robomend-batch learn good/*.bag --update agent.yaml | patch agent.yaml
    """
    from robomend_batch.learn.learning import learn

    if (out is None) == (update is None):
        raise click.UsageError("give one of --out and --update")
    if ros1 is not None and ros2 is not None:
        raise click.UsageError("give one of --ros1 and --ros2")
    if out is not None:
        _check_free(out, overwrite)
    names, problems = find_logs(logs)
    for place, reason in problems:
        click.echo(f"bad: {place}: {reason}", err=True)
    learned = learn(
        names,
        robot=name,
        per_hour=per_hour,
        live=_live(ros1, ros2),
        update=update,
        on_log=lambda log: None if quiet else click.echo(f"read: {log}", err=True),
    )
    if out is not None:
        _write(out, learned)
    else:
        from robomend_batch.learn.update import proposed

        assert update is not None
        click.echo(proposed(update, learned.entries), nl=False)
    _tell(learned, out, quiet)
    return BAD_INPUT if problems or any(p["bad"] for p in learned.problems) else 0


def _live(ros1: str | None, ros2: int | None) -> RosGraph:
    """Return who publishes and listens on the running robot; nobody, if it is not to be asked."""
    from robomend.cli.model_from_ros import graph_of
    from robomend_client.ros_graph import RosGraph

    return RosGraph() if ros1 is None and ros2 is None else graph_of(ros1, ros2, None)[0]


def _check_free(out: Path, overwrite: bool) -> None:
    there = [file for file in (MODEL, OBSERVERS) if (out / file).exists()]
    if there and not overwrite:
        raise InputError(f"{out} has a {there[0]} already: --overwrite replaces it")


def _write(out: Path, learned: LearnedDraft) -> None:
    out.mkdir(parents=True, exist_ok=True)
    for file, text in ((MODEL, learned.model), (OBSERVERS, learned.observers)):
        beside = out / f"{file}.tmp"
        beside.write_text(text, encoding="utf-8")
        beside.replace(out / file)


def _tell(learned: LearnedDraft, out: Path | None, quiet: bool) -> None:
    for problem in learned.problems:
        if problem["bad"] or not quiet:
            place = f"{problem['place']}: " if problem["place"] else ""
            click.echo(f"{'bad' if problem['bad'] else 'note'}: {place}{problem['reason']}", err=True)
    for name, (_, _, why) in learned.entries.doubtful.items():
        click.echo(f"doubtful: {name}: {why}: it is left as a comment", err=True)
    for name, count in learned.contradicted.items():
        click.echo(
            f"contradicted: {name}: {counted(count, 'false alarm')} in logs of a healthy robot", err=True
        )
    if not learned.entries.names:
        click.echo("note: nothing in the logs can be watched: give longer ones", err=True)
    if quiet:
        return
    where = "" if out is None else f"; draft in {out}"
    alarms = counted(learned.false_alarms, "false alarm")
    click.echo(
        f"{counted(len(learned.entries.names), 'observer')} from {learned.learned_h:.3g} h; "
        f"{alarms} in {learned.held_back_h:.3g} h that were held back{where}",
        err=True,
    )
