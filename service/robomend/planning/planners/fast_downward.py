"""Fast Downward through Unified Planning: cheapest plans (A* with the LM-cut heuristic).

An extra, `pip install 'robomend[fast-downward]'`: it is GPLv3 and 216 MB. It runs as a process of its own
for each part, so it is slow for many small ones. It honours its deadline; as the kernel bounds its CPU time
as well, it ends even if we were killed.

Source: M. Helmert. The Fast Downward planning system. JAIR 26, 2006.
"""

from __future__ import annotations

import resource
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from importlib.util import find_spec
from math import ceil
from typing import Any

from robomend.errors import OptionRefused, SolverError
from robomend.planning.decomposition import Part
from robomend.planning.planners import PartAnswer
from robomend.planning.planners.strips import answer, oneshot_planner, up_problem


class FastDownward:
    """The optimal configuration."""

    name = "fast-downward"
    max_actions: int | None = None

    def __init__(self) -> None:
        if find_spec("up_fast_downward") is None:
            raise OptionRefused(
                "Fast Downward is not installed: pip install 'robomend[fast-downward]'; asp is optimal too"
            )
        self._engine: Any = oneshot_planner("fast-downward-opt")

    def solve(self, part: Part, timeout_s: float | None) -> PartAnswer:
        """Return a cheapest plan."""
        with tempfile.TemporaryFile("w") as silence, children_end_after(timeout_s):
            try:
                result = self._engine.solve(
                    up_problem(part, costs=True), timeout=timeout_s, output_stream=silence
                )
            except (OSError, AssertionError, RuntimeError) as error:
                raise SolverError(f"Fast Downward failed: {error}") from error
        return answer(result, exhaustive=False)


SPARE_S = 2
"""CPU seconds beyond the deadline: whoever lives ends Fast Downward first."""


@contextmanager
def children_end_after(timeout_s: float | None) -> Iterator[None]:
    """Bound the CPU time of processes that are started within: they may outlive us if we are killed.

    The limit is inherited and counts each process's own time. It holds for us as well meanwhile, so what we
    have used comes on top.
    """
    before = soft, hard = resource.getrlimit(resource.RLIMIT_CPU)
    if timeout_s is not None:
        used = resource.getrusage(resource.RUSAGE_SELF)
        wanted = ceil(used.ru_utime + used.ru_stime + timeout_s) + SPARE_S
        bounds = [limit for limit in (soft, hard) if limit != resource.RLIM_INFINITY]
        resource.setrlimit(resource.RLIMIT_CPU, (min([wanted, *bounds]), hard))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_CPU, before)
