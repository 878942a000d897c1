"""The planners by name, and what a planner is.

    pyperplan       the default: pyperplan through Unified Planning
    asp             clingo over encodings/plan.lp: cheapest plans, any number of actions, cancellable
    fast-downward   Fast Downward through Unified Planning; the extra `robomend[fast-downward]`

To add one of your own, write a class with the attributes of `Planner`, constructed without arguments, and
name it in your distribution:

    [project.entry-points."robomend.planners"]
    mine = "my_package:MyPlanner"

Our own names cannot be taken over. Planners run in worker processes that are killed at the deadline
(robomend.workers.pool), so one that cannot be interrupted does no harm.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from importlib import import_module
from importlib.metadata import EntryPoint, entry_points
from typing import Any, Protocol, cast

from robomend.errors import OptionRefused, SolverError
from robomend.planning.decomposition import Part
from robomend.planning.plan import Outcome

GROUP = "robomend.planners"

BUILT_IN: dict[str, str] = {
    "pyperplan": "robomend.planning.planners.pyperplan:Pyperplan",
    "asp": "robomend.planning.planners.asp:AspPlanner",
    "fast-downward": "robomend.planning.planners.fast_downward:FastDownward",
}

DEFAULT = "pyperplan"
FALLBACK = "asp"


@dataclass(frozen=True, slots=True)
class PartAnswer:
    """What a planner says of one part. UNSOLVABLE is a proof; not knowing is GAVE_UP."""

    outcome: Outcome
    actions: tuple[int, ...] = ()  # indices into Part.actions, in an order in which they can be carried out
    cheapest: bool = False  # proved


class Planner(Protocol):
    """One planner. Kept and asked many times, one call at a time."""

    name: str
    max_actions: int | None
    """Parts with more actions go to the fallback; None: no limit."""

    def solve(self, part: Part, timeout_s: float | None) -> PartAnswer:
        """Return a plan for one part, the cheapest that the planner can promise.

        Raises:
            SolverError: the planner failed; the fallback is asked then.
        """
        ...


def planner_names() -> tuple[str, ...]:
    """Return the names that make_planner knows: ours first, then those of third parties."""
    others = {point.name for point in entry_points(group=GROUP)} - BUILT_IN.keys()
    return (*BUILT_IN, *sorted(others))


def check_planner(name: str) -> None:
    """Refuse a name that no planner has, before anything is started for it.

    Raises:
        OptionRefused: no planner has this name.
    """
    if name not in BUILT_IN and name not in (names := planner_names()):
        raise OptionRefused(f"no planner is named {name!r}: choose one of {', '.join(names)}")


@lru_cache(maxsize=16)
def make_planner(name: str) -> Planner:
    """Return the planner of this name, the same one each time.

    Raises:
        OptionRefused: no planner has this name, or it is not installed.
        SolverError: a third party's planner could not be loaded.
    """
    if name in BUILT_IN:
        module, _, attribute = BUILT_IN[name].partition(":")
        made: Any = getattr(import_module(module), attribute)()
        return cast(Planner, made)
    check_planner(name)
    points: tuple[EntryPoint, ...] = tuple(entry_points(group=GROUP, name=name))
    try:
        made = points[0].load()()
    except (ImportError, AttributeError, TypeError) as error:
        raise SolverError(f"planner {name!r} ({points[0].value}) could not be loaded: {error}") from error
    return cast(Planner, made)
