"""`robomend demo`: the paper's robot, diagnosed and repaired end to end on this computer."""

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
    from robomend_demo.report import demo_json, invitation, summary, usable, write
    from robomend_demo.run import Wanted, run

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
