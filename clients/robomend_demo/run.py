"""The demo from beginning to end: folder, processes, scenarios, report; and nothing left behind."""

from __future__ import annotations

import contextlib
import fcntl
import os
import shutil
import tempfile
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path

from robomend.cli.interrupts import Interrupted, Interrupts
from robomend.cli.stage import PartFailed, Stage, environment, show
from robomend.resources import resource
from robomend_client.rest.errors import ClientError
from robomend_demo.cast import ROBOT, Cast, DemoRobot, gather, tedusar, tedusar_with_spare
from robomend_demo.play import Play
from robomend_demo.report import Told
from robomend_demo.scenarios import POWER_UP, Scenario
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
