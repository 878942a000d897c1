"""The planners by name, and what a planner is.

    dijkstra        our own, for small parts: what the service asks first, in its own process
    pyperplan       the default: pyperplan through Unified Planning
    asp             clingo over encodings/plan.lp: cheapest plans, any number of actions, cancellable
    fast-downward   Fast Downward through Unified Planning; the extra `robomend[fast-downward]`

To add a planner: 1. a class with the attributes of `Planner`, constructed without arguments, in a module
here; 2. its line in PLANNERS; 3. its row in docs/planning.md. A planner of your own needs no change here:
its class, and in your distribution

    [project.entry-points."robomend.planners"]
    mine = "my_package:MyPlanner"

Planners run in worker processes that are killed at the deadline (robomend.workers.pool), so one that cannot
be interrupted does no harm.
"""

from __future__ import annotations

import resource
import time
from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from typing import Protocol

from robomend.errors import OptionRefused, SolverError
from robomend.planning.decomposition import Part
from robomend.planning.plan import Outcome
from robomend_client.registry import Registry

DEFAULT = "pyperplan"
FALLBACK = "asp"


def processor_s() -> float:
    """Return the processor time of this process, and of those that it started and that have ended.

    Planners' limits are in this: what others take of the processor is no problem's fault.
    """
    children = resource.getrusage(resource.RUSAGE_CHILDREN)
    return time.process_time() + children.ru_utime + children.ru_stime


@dataclass(frozen=True, slots=True)
class PartAnswer:
    """What a planner says of one part. UNSOLVABLE is a proof; not knowing is GAVE_UP."""

    outcome: Outcome
    actions: tuple[int, ...] = ()  # indices into Part.actions, in an order in which they can be carried out


class Planner(Protocol):
    """One planner. Kept and asked many times, one call at a time."""

    name: str
    max_actions: int | None
    """Parts with more actions go to the fallback; None: no limit."""

    def solve(self, part: Part, timeout_s: float | None) -> PartAnswer:
        """Return a plan for one part, the cheapest that the planner can promise.

        Args:
            timeout_s: seconds of processor time; see `processor_s`.

        Raises:
            SolverError: the planner failed; the fallback is asked then.
        """
        ...


PLANNERS = Registry[Callable[[], Planner]](
    "planner",
    "robomend.planners",
    {
        "dijkstra": "robomend.planning.planners.dijkstra:Dijkstra",
        "pyperplan": "robomend.planning.planners.pyperplan:Pyperplan",
        "asp": "robomend.planning.planners.asp:AspPlanner",
        "fast-downward": "robomend.planning.planners.fast_downward:FastDownward",
    },
    unknown=OptionRefused,
    broken=SolverError,
)


@lru_cache(maxsize=16)
def make_planner(name: str) -> Planner:
    """Return the planner of this name, the same one each time.

    The default one needs Unified Planning, which an installation may leave out (docs/deploy/README.md): then
    it is the fallback, and a plan says that it is the fallback's.

    Raises:
        OptionRefused: no planner has this name, or it is not installed.
        SolverError: a third party's planner could not be loaded.
    """
    planner = PLANNERS.load(name)
    try:
        return planner()
    except SolverError as error:
        if name != DEFAULT or not isinstance(error.__cause__, ModuleNotFoundError):
            raise
        return make_planner(FALLBACK)
    except TypeError as error:
        raise SolverError(f"planner {name!r} could not be made: {error}") from error
