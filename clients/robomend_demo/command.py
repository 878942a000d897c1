"""`robomend demo`: the paper's robot, diagnosed and repaired end to end on this computer.

From beginning to end: folder, processes, scenarios, report; and nothing left behind.
"""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import TYPE_CHECKING

import click

from robomend_demo.scenarios import OF_THE_PAPER, SCENARIOS, SHUT_DOWN, Scenario

if TYPE_CHECKING:
    from collections.abc import Sequence

    from robomend_demo.cast import Cast, DemoRobot
    from robomend_demo.report import Told
    from robomend_demo.screen import Screen
import contextlib
import fcntl
import os
import shutil
import tempfile
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace

from robomend.cli.interrupts import Interrupted, Interrupts
from robomend.cli.stage import PartFailed, Stage, environment, show
from robomend.resources import resource
from robomend_client.rest.errors import ClientError
from robomend_demo.cast import ROBOT, Cast, DemoRobot, gather, tedusar, tedusar_with_spare
from robomend_demo.play import Play
from robomend_demo.report import Told
from robomend_demo.scenarios import POWER_UP
from robomend_demo.screen import Screen

PREFIX = "robomend-demo-"
LOCK = "lock"

PAPER_HOLD_S = 1.0
"""The paper's loop looked once a second; its domain needs to see what power alone did not bring back."""

DEATH_SHOWS_S = 0.5
"""A process that dies drops its connections first; so long after that its end is seen."""


@dataclass(frozen=True, slots=True)
class Wanted:
    """What to play."""

    scenarios: tuple[Scenario, ...]
    paper_domain: bool = False
    hold: bool = False
    page: bool = False

    @property
    def robot(self) -> DemoRobot:
        """The robot that can play all of it."""
        if any(scenario.needs_spare for scenario in self.scenarios):
            return tedusar_with_spare()
        if self.paper_domain:
            domain = resource("pddl", "paper-repair.pddl").read_text(encoding="utf-8")
            return replace(tedusar(), domain=domain, hold_s=PAPER_HOLD_S)
        return tedusar()


def run(
    wanted: Wanted, screen: Screen, interrupts: Interrupts, done: Callable[[Sequence[Told], Cast], None]
) -> None:
    """Play the scenarios, hand their figures to `done`, and hold if that is wanted.

    Raises:
        PartFailed: a part did not start, or a scenario did not come to its end.
        Interrupted: a signal came before `done`. One that ends the holding is no error.
    """
    all_on = POWER_UP not in wanted.scenarios
    with scratch_folder() as folder:
        play: Play | None = None
        try:
            with Stage(folder, environment(), interrupts) as stage:
                screen.say("starting the service, the power board, the devices and the robot's agent …")
                cast = gather(stage, folder, wanted.robot, all_on=all_on)
                play = Play(stage, cast, interrupts, screen)
                with blaming_the_dead(stage):
                    play.prepare(folder, all_on=all_on)
                    if wanted.page:  # not before the robot is there to be seen
                        screen.say(f"the page: {page_of(cast)}")
                        show(page_of(cast))
                    told = [Told.of(play.play(scenario)) for scenario in wanted.scenarios]
                screen.rest()
                done(told, cast)
                if wanted.hold:
                    with contextlib.suppress(Interrupted):
                        play.hold()
        finally:
            if play is not None:
                play.close()


def page_of(cast: Cast) -> str:
    """Return where the robot is seen in a browser."""
    return f"{cast.url}/ui/robots/{ROBOT}"


@contextmanager
def blaming_the_dead(stage: Stage) -> Iterator[None]:
    """Name a part that ended rather than what followed from its end, which is often noticed first.

    Raises:
        PartFailed: a part ended, or what had failed inside.
    """
    try:
        yield
    except (PartFailed, ClientError) as error:
        stage.check(within_s=DEATH_SHOWS_S)
        if isinstance(error, ClientError):
            raise PartFailed(f"the service did not do as asked: {error}") from error
        raise


@contextmanager
def scratch_folder() -> Iterator[Path]:
    """A temporary folder that is gone afterwards; one that a killed demo left is swept up by the next.

    Whose folder it is shows by a lock, which the kernel drops with the process.
    """
    _sweep(Path(tempfile.gettempdir()))
    folder = Path(tempfile.mkdtemp(prefix=PREFIX))
    try:
        with (folder / LOCK).open("w") as lock:
            fcntl.flock(lock, fcntl.LOCK_EX)
            yield folder
    finally:
        shutil.rmtree(folder, ignore_errors=True)


def _sweep(where: Path) -> None:
    for left in where.glob(f"{PREFIX}*"):
        try:
            if left.is_symlink() or left.stat().st_uid != os.getuid():
                continue
            with (left / LOCK).open("r+") as lock:
                fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
                shutil.rmtree(left, ignore_errors=True)
        except OSError:
            continue  # in use, or being made


ALL = "all"


@click.command("demo", short_help="Watch a robot being diagnosed and repaired.")
@click.option(
    "--scenario",
    "wanted",
    type=click.Choice([*SCENARIOS, ALL]),
    multiple=True,
    help="May be repeated.  [default: power-up and shut-down; with --domain paper: shut-down]",
)
@click.option(
    "--domain",
    type=click.Choice(["repair", "paper"]),
    default="repair",
    show_default=True,
    help="Repair actions: the service's, or the four of the paper.",
)
@click.option(
    "--hold/--once", default=False, help="Keep it running to play with, until Ctrl-C; or end (the default)."
)
@click.option(
    "--page", is_flag=True, help="Show the page: opened where there is a desktop. It implies --hold."
)
@click.option(
    "--report",
    type=click.Path(file_okay=False, path_type=Path),
    default=Path("report"),
    show_default=True,
    help="Folder for the timelines and demo.json.",
)
@click.option(
    "--format",
    "format_",
    type=click.Choice(["text", "json"]),
    default="text",
    show_default=True,
    help="json: demo.json on stdout, and nothing else.",
)
def command(wanted: tuple[str, ...], domain: str, hold: bool, page: bool, report: Path, format_: str) -> int:
    """Watch a robot being diagnosed and repaired, with real processes.

    The paper's two scenarios: power-up (everything is off) and shut-down (the base loses its power). And two
    more: hung-device (a power cycle helps) and dead-lidar (nothing does, but the robot has a spare).

    Starts the service, an emulated power board, and a robot of nine node processes, all on free ports of this
    computer; everything is gone at the end. Exit codes: 0 repaired and verified, 3 not, 130
    interrupted.
    """
    from rich.console import Console

    from robomend.cli.interrupts import Interrupted, Interrupts
    from robomend_demo.command import Wanted, run
    from robomend_demo.report import demo_json, invitation, summary, usable, write

    folder = usable(report)
    hold = hold or page
    paper = domain == "paper"
    asked = Wanted(chosen(wanted, paper=paper), paper, hold, page)

    def done(told: Sequence[Told], cast: Cast) -> None:
        write(folder, told, cast.robot.model.components)
        if format_ == "json":
            click.echo(json.dumps(demo_json(told), ensure_ascii=False))
        else:
            summary(Console(highlight=False), folder, told)
        if hold:
            click.echo(invitation(cast, board_command()), err=format_ == "json")

    with Interrupts() as interrupts:
        try:
            with make_screen(format_, asked.robot) as screen:
                run(asked, screen, interrupts, done)
        except Interrupted as interrupted:
            click.echo("interrupted: everything that was started is gone", err=True)
            return 128 + interrupted.number
    return 0


def chosen(names: tuple[str, ...], *, paper: bool) -> tuple[Scenario, ...]:
    """Return what to play for the options that were given, in the order in which it can be played."""
    if not names:
        return (SHUT_DOWN,) if paper else OF_THE_PAPER
    found = tuple(one for name, one in SCENARIOS.items() if name in names or ALL in names)
    if paper and (others := [one.name for one in found if one not in OF_THE_PAPER]):
        raise click.UsageError(f"the paper's domain cannot repair {' and '.join(others)}: leave out --domain")
    return found


def make_screen(format_: str, robot: DemoRobot) -> Screen:
    """Return a live picture where there is a terminal to draw on, else lines."""
    from rich.console import Console

    from robomend_demo.screen import Lines, Picture

    console = Console()
    if format_ == "json" or not console.is_terminal or console.is_dumb_terminal:
        return Lines()
    return Picture(console, robot.model.components)


def board_command() -> list[str]:
    """Return the command that reaches the emulator's control port: the script beside this interpreter."""
    script = Path(sys.executable).parent / "robomend-board"
    return [str(script)] if script.is_file() else [sys.executable, "-m", "robomend_board.main"]
