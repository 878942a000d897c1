"""`robomend demo`: the paper's robot, diagnosed and repaired end to end on this computer."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import TYPE_CHECKING

import click

if TYPE_CHECKING:
    from collections.abc import Sequence

    from robomend_demo.cast import Cast
    from robomend_demo.report import Told
    from robomend_demo.screen import Screen

SCENARIOS = {"power-up": ("power-up",), "shut-down": ("shut-down",), "all": ("power-up", "shut-down")}


@click.command("demo")
@click.option(
    "--scenario",
    type=click.Choice([*SCENARIOS]),
    help="All is off; or the base loses its power.  [default: all; with --domain paper: shut-down]",
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
def command(scenario: str | None, domain: str, hold: bool, page: bool, report: Path, format_: str) -> int:
    """Watch a robot being diagnosed and repaired: the paper's two scenarios, with real processes.

    Starts the service, an emulated power board, and a robot of nine node processes, all on free ports of this
    computer; everything is gone at the end. Exit codes: 0 repaired and verified, 3 not, 130
    interrupted.
    """
    from rich.console import Console

    from robomend_demo.interrupts import Interrupted, Interrupts
    from robomend_demo.report import demo_json, invitation, summary, usable, write
    from robomend_demo.run import Wanted, run

    folder = usable(report)
    hold = hold or page
    names = SCENARIOS[scenario or ("shut-down" if domain == "paper" else "all")]

    def done(told: Sequence[Told], cast: Cast) -> None:
        write(folder, told, cast.model.components)
        if format_ == "json":
            click.echo(json.dumps(demo_json(told), ensure_ascii=False))
        else:
            summary(Console(highlight=False), folder, told)
        if hold:
            click.echo(invitation(cast, board_command()), err=format_ == "json")

    with Interrupts() as interrupts:
        try:
            with make_screen(format_) as screen:
                run(Wanted(names, domain == "paper", hold, page), screen, interrupts, done)
        except Interrupted as interrupted:
            click.echo("interrupted: everything that was started is gone", err=True)
            return 128 + interrupted.number
    return 0


def make_screen(format_: str) -> Screen:
    """Return a live picture where there is a terminal to draw on, else lines."""
    from rich.console import Console

    from robomend_demo.cast import tedusar
    from robomend_demo.screen import Lines, Picture

    console = Console()
    if format_ == "json" or not console.is_terminal or console.is_dumb_terminal:
        return Lines()
    model, _ = tedusar()
    return Picture(console, model.components)


def board_command() -> list[str]:
    """Return the command that reaches the emulator's control port: the script beside this interpreter."""
    script = Path(sys.executable).parent / "robomend-board"
    return [str(script)] if script.is_file() else [sys.executable, "-m", "robomend_board.main"]
