"""clingo over encodings/plan.lp: the heir of the paper's GraphPlan, with costs.

    horizon ──► a cheapest answer: steps, then a relaxed suffix ──► no suffix?  yes ──► a cheapest plan
       ▲                                                              │ no
       └─────────────────────────── one step more ◄───────────────────┘

The first horizon is the number of layers of the relaxed planning graph: fewer cannot do. Two kinds of part
would make the horizon grow for ever: one that the relaxed world solves and the real one does not, and one
with free actions, which keep every further step busy at no cost. So after a few steps the states are
enumerated (dijkstra.py), up to a limit; beyond it a plan without the proof that it is cheapest will do.
"""

from __future__ import annotations

from functools import lru_cache

import clingo

from robomend.errors import SolverError
from robomend.planning.decomposition import Part
from robomend.planning.plan import Outcome
from robomend.planning.planners import PartAnswer, processor_s
from robomend.planning.planners.dijkstra import dijkstra
from robomend.planning.planners.relaxed import plan_cost, relaxed_layers, without_redundant
from robomend.resources import resource

MAX_WEIGHT = 2**30
"""clasp's weights are 32-bit integers."""

DOUBT_AFTER = 6
"""Steps beyond the lower bound after which the states are enumerated."""

MAX_HORIZON = 400

SHORTEST_S = 0.001
"""Between two looks at the processor time that a search has taken."""


class AspPlanner:
    """Cheapest plans for parts of any size; anytime: at the deadline the best plan so far is the answer."""

    name = "asp"
    max_actions: int | None = None

    def solve(self, part: Part, timeout_s: float | None) -> PartAnswer:
        """Return a cheapest plan, or at the deadline the best one found, or GAVE_UP."""
        deadline = None if timeout_s is None else processor_s() + timeout_s
        first = relaxed_layers(part)
        if first is None:
            return PartAnswer(Outcome.UNSOLVABLE)
        best: tuple[int, ...] | None = None
        for horizon in range(first, MAX_HORIZON):
            attempt = _Attempt(part, horizon)
            finished = attempt.run(deadline)
            if attempt.plan is not None and (
                best is None or plan_cost(part, attempt.plan) < plan_cost(part, best)
            ):
                best = attempt.plan
            if not finished:
                break
            if attempt.proved:
                return PartAnswer(Outcome.SOLVED, without_redundant(part, best or ()))
            if horizon == first + DOUBT_AFTER:
                answer = dijkstra(part, deadline=deadline)
                if answer.outcome is not Outcome.GAVE_UP:
                    return answer
            if best is None and horizon >= first + DOUBT_AFTER:
                real = _Attempt(part, horizon, suffix=False)
                real.run(deadline)
                best = real.plan
            if best is not None and horizon >= first + DOUBT_AFTER:
                break  # the bound is not getting there
        if best is None:
            return PartAnswer(Outcome.GAVE_UP)
        return PartAnswer(Outcome.SOLVED, without_redundant(part, best))


class _Attempt:
    """One run of clingo with a fixed horizon."""

    def __init__(self, part: Part, horizon: int, *, suffix: bool = True) -> None:
        self.plan: tuple[int, ...] | None = None  # the cheapest found that needs no relaxed step
        self.proved = False  # … and nothing is cheaper
        self._relaxed = True  # the last model found needs relaxed steps
        self._control = clingo.Control(
            ["-c", f"horizon={horizon}", "--opt-strategy=usc"], logger=lambda _code, _message: None
        )
        try:
            self._control.add("base", [], _encoding())
            self._control.add("base", [], _instance(part))
            if not suffix:
                self._control.add("base", [], ":- extra(A).")
            self._control.ground([("base", [])])
        except (RuntimeError, MemoryError) as error:
            raise SolverError(f"clingo could not ground the planning problem: {error}") from error

    def run(self, deadline: float | None) -> bool:
        """Return whether the search came to its end before this much processor time was spent."""
        if deadline is not None and processor_s() >= deadline:
            return False
        with self._control.solve(on_model=self._take, async_=True) as handle:
            finished = handle.wait(None if deadline is None else max(SHORTEST_S, deadline - processor_s()))
            while not finished and deadline is not None and processor_s() < deadline:
                finished = handle.wait(max(SHORTEST_S, deadline - processor_s()))
            if not finished:
                handle.cancel()
            result = handle.get()
        if finished and result.satisfiable:
            self.proved = not self._relaxed
        return bool(finished)

    def _take(self, model: clingo.Model) -> None:
        done: list[tuple[int, int]] = []
        self._relaxed = False
        for symbol in model.symbols(shown=True):
            if symbol.name == "extra":
                self._relaxed = True
            else:
                done.append((symbol.arguments[1].number, symbol.arguments[0].number))
        if not self._relaxed:
            self.plan = tuple(action for _, action in sorted(done))


@lru_cache(maxsize=1)
def _encoding() -> str:
    return resource("encodings", "plan.lp").read_text(encoding="utf-8")


def _instance(part: Part) -> str:
    """Return the facts that encodings/plan.lp lists as its input."""
    dearest = max((action.cost for action in part.actions), default=0.0)
    scale = min(1000.0, MAX_WEIGHT / dearest) if dearest else 1.0
    lines = [f"init({fact})." for fact in sorted(part.initial)]
    lines += [f"goal({fact})." for fact in sorted(part.goal)]
    for index, action in enumerate(part.actions):
        lines.append(f"action({index}). cost({index},{round(action.cost * scale)}).")
        lines += [f"needs({index},{fact})." for fact in sorted(action.needs)]
        lines += [f"adds({index},{fact})." for fact in sorted(action.adds)]
        lines += [f"deletes({index},{fact})." for fact in sorted(action.deletes - action.adds)]
    return "\n".join(lines)
