"""What does not belong: samples that are left out, observers that fail. Each is told once, and counted."""

from __future__ import annotations

import logging
import traceback
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass

from robomend_client.observers.base import SECOND, Observer, WrongKind

log = logging.getLogger(__name__)

MOST_TOLD = 1000


@dataclass(frozen=True, slots=True)
class ObserverProblem:
    """Something that does not belong: told once for each source or place."""

    what: str  # "observer", "kind", "ahead", "behind", "jump", "number"
    where: str
    message: str


class ObserverProblems:
    """The problems of one driver."""

    def __init__(self, on_problem: Callable[[ObserverProblem], None] | None = None) -> None:
        """`on_problem` is told once of each kind of problem; by default it goes to the log."""
        self.counts: Counter[tuple[str, str]] = Counter()
        self._on_problem = on_problem or _to_the_log

    def left_out(self, what: str, source: str, by_ns: int) -> None:
        """A sample was so far ahead of the time before it, or behind, that it is not taken in."""
        way = "ahead of" if by_ns > 0 else "behind"
        than = "the samples before and after it" if what == "jump" else "this computer's clock"
        self._tell(
            what, source, f"a sample of {source} is {abs(by_ns) / SECOND:.3g} s {way} {than}: left out"
        )

    def no_number(self, source: str) -> None:
        """A sample that is to be a number is none."""
        self._tell("number", source, f"a sample of {source} is no number (NaN, or infinite): left out")

    def wrong_kind(self, source: str, error: WrongKind) -> None:
        """The samples of a source are something else than an observer reads."""
        self._tell("kind", source, f"what {source} says cannot be read: {error}")

    def failed(self, observer: Observer, error: Exception) -> None:
        """An observer raised."""
        frames = traceback.extract_tb(error.__traceback__)
        place = f"{frames[-1].filename}:{frames[-1].lineno}" if frames else "?"
        name = f"{type(observer).__name__} of {', '.join(map(str, observer.atoms[:3]))}"
        self._tell("observer", place, f"the {name} failed: {type(error).__name__}: {error} ({place})")

    def _tell(self, what: str, where: str, message: str) -> None:
        self.counts[what, where] += 1
        if self.counts[what, where] == 1 and len(self.counts) <= MOST_TOLD:
            self._on_problem(ObserverProblem(what, where, message))


def _to_the_log(problem: ObserverProblem) -> None:
    log.warning("%s", problem.message)
