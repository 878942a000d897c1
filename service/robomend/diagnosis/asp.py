"""Diagnosis by answer-set programming: clingo over encodings/diagnosis.lp.

One persistent Control for each way of asking; the model is grounded once, OBS comes as assumptions:

    minimum     #minimize, all optimal answer sets                    minimal = "cardinality"
    subset      domain heuristics: ab/1 false first, and the answer sets in a "record" of what is minimal

Domain heuristics give subset-minimal answer sets in no particular order. They are sorted before they are
handed on; so a limit is met with the smallest ones by enumerating all, or, when there are more than the
limit, by size: first those of at most one component, then of at most two, … Where the time runs out, what
was found so far is sorted and handed on, and there may be smaller ones.

Trap: with --dom-mod=5,16 minimality is over the shown atoms, so nothing but ab/1 may be shown.

Sources:
    M. Gebser, R. Kaminski, B. Kaufmann, T. Schaub. Multi-shot ASP solving with clingo. TPLP 19(1), 2019.
    M. Gebser et al. Domain-specific heuristics in answer set programming. AAAI 2013.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from time import perf_counter
from typing import Any

import clingo

from robomend.diagnosis.base import BaseEngine
from robomend.diagnosis.core_guided import MinimumTooLarge
from robomend.diagnosis.observed import SignedObs, Supposed
from robomend.diagnosis.oracle import OutOfTime
from robomend.diagnosis.result import Options
from robomend.diagnosis.search import Bad, NoDiagnosis, SearchState, by_size
from robomend.errors import OptionRefused
from robomend.model.cnf import Clause, HealthCnf
from robomend.resources import resource

SLICE_S = 0.05
"""How long to wait before looking whether someone called interrupt."""

ARGUMENTS = {
    "minimum": ["--opt-mode=optN", "--project=show", "0"],
    "subset": ["--heuristic=Domain", "--dom-mod=5,16", "--enum-mode=domRec", "--project=show", "0"],
}


class AspEngine(BaseEngine):
    """See the module. Conflicts are told by a SAT solver, as for every engine."""

    name = "asp"

    def __init__(self, cnf: HealthCnf, *, solver: str | None = None) -> None:
        if solver not in (None, "clingo"):
            raise OptionRefused(f"the asp engine works with clingo only, not with {solver!r}")
        super().__init__(cnf)
        self._controls: dict[str, _Grounded] = {}

    def _grounded(self, kind: str) -> _Grounded:
        if kind not in self._controls:
            self._controls[kind] = _Grounded(self.cnf, kind)
        return self._controls[kind]

    def _search(self, observed: SignedObs, what_if: Supposed, options: Options, answer: SearchState) -> None:
        self._clock.check()
        literals = [*observed.numbers, *what_if.numbers]
        if options.minimal == "cardinality":
            self._minimum(literals, options, answer)
        else:
            self._subset_minimal(literals, options, answer)

    def _minimum(self, literals: list[int], options: Options, answer: SearchState) -> None:
        any_at_all = False
        for bad, optimal in self._models("minimum", literals, answer):
            any_at_all = True
            if not optimal and self.cnf.components:  # without any, clingo has nothing to minimize
                continue  # a better one follows
            if options.max_size is not None and len(bad) > options.max_size:
                raise MinimumTooLarge
            answer.add(bad)
        if not any_at_all:
            raise NoDiagnosis

    def _subset_minimal(self, literals: list[int], options: Options, answer: SearchState) -> None:
        found: list[Bad] = []
        try:
            if options.max_size is not None:
                found = self._all_of(literals, options.max_size, None, answer)
            else:
                most = None if options.limit is None else options.limit + 1
                found = self._all_of(literals, None, most, answer)
        except _Partial as partial:
            for bad in sorted(partial.found, key=by_size):
                answer.add(bad)
            raise OutOfTime from None
        size = 0
        while options.max_size is None and options.limit is not None and len(found) > options.limit:
            # More than wanted, in no particular order: fetch the smallest ones.
            smallest = self._all_of(literals, size, None, answer)
            if len(smallest) >= options.limit:
                already = set(smallest)
                found = [*smallest, *(bad for bad in found if bad not in already)]
                break
            size += 1
        for bad in sorted(found, key=by_size):
            answer.add(bad)
        if not found and options.max_size is None:
            raise NoDiagnosis
        if options.max_size is not None:
            more = self._all_of(literals, None, len(found) + 1, answer)
            if not more:
                raise NoDiagnosis
            if len(more) > len(found):
                raise MinimumTooLarge

    def _all_of(
        self, literals: list[int], max_size: int | None, most: int | None, answer: SearchState
    ) -> list[Bad]:
        found: list[Bad] = []
        try:
            for bad, _ in self._models("subset", literals, answer, max_size):
                found.append(bad)
                if most is not None and len(found) >= most:
                    break
        except OutOfTime:
            raise _Partial(found) from None
        return found

    def _models(
        self, kind: str, literals: list[int], answer: SearchState, max_size: int | None = None
    ) -> Iterator[tuple[Bad, bool]]:
        """Yield (abnormal components, proven optimal) of each answer set.

        Raises:
            OutOfTime: the deadline passed, or someone called interrupt.
        """
        grounded, clock = self._grounded(kind), self._clock
        assumptions = grounded.assumptions(literals, max_size)
        with grounded.control.solve(assumptions=assumptions, yield_=True, async_=True) as handle:
            while True:
                handle.resume()
                while not handle.wait(self._patience()):
                    clock.check()
                clock.check()
                model = handle.model()
                if model is None:
                    break
                bad = tuple(sorted(symbol.arguments[0].number for symbol in model.symbols(shown=True)))
                if self.cnf.modes:
                    answer.modes[bad] = grounded.modes_of(bad, model)
                yield bad, model.optimality_proven

    def _patience(self) -> float:
        deadline = self._clock.deadline
        return SLICE_S if deadline is None else max(0.0, min(SLICE_S, deadline - perf_counter()))

    def close(self) -> None:
        """Free the solvers."""
        super().close()
        self._controls.clear()


class _Grounded:
    """A Control with the model in it."""

    def __init__(self, cnf: HealthCnf, kind: str) -> None:
        self._cnf = cnf
        self.control: Any = clingo.Control([*ARGUMENTS[kind]], logger=lambda code, message: None)
        self.control.load(str(resource("encodings", "diagnosis.lp")))
        self.control.add("base", [], facts_of(len(cnf.components), cnf.variables, cnf.clauses))
        parts: list[tuple[str, list[Any]]] = [("base", [])]
        if kind == "minimum":
            parts.append(("minimum", []))
        self.control.ground(parts)
        self._true: dict[int, int] = {}  # variable -> clingo's literal
        for atom in self.control.symbolic_atoms.by_signature("true", 1):
            self._true[atom.symbol.arguments[0].number] = atom.literal
        self._bounds: dict[int, int] = {}

    def assumptions(self, literals: list[int], max_size: int | None) -> list[int]:
        """Return OBS, and a bound on the size, as clingo's literals."""
        assumed = [self._true[literal] if literal > 0 else -self._true[-literal] for literal in literals]
        # A model that contradicts itself is grounded to nothing: there is no bound, and no answer set either.
        conflicting = self.control.is_conflicting
        if max_size is not None and max_size < len(self._cnf.components) and not conflicting:
            assumed.append(self._bound(max_size))
        return assumed

    def _bound(self, size: int) -> int:
        if size not in self._bounds:
            number = clingo.Number(size)
            self.control.ground([("bound", [number])])
            external = clingo.Function("at_most", [number])
            self.control.assign_external(external, None)  # free: it holds when it is assumed
            self._bounds[size] = self.control.symbolic_atoms[external].literal
        return self._bounds[size]

    def modes_of(self, bad: Bad, model: Any) -> dict[str, str]:
        """Return a fault mode for each abnormal component that has modes."""
        told: dict[str, str] = {}
        for variable in bad:
            component = self._cnf.components[variable - 1]
            for mode, number in self._cnf.modes.get(component, {}).items():
                if model.is_true(self._true[number]):
                    told[component] = mode
                    break
        return told


class _Partial(Exception):
    """Out of time in the middle of an unordered enumeration."""

    def __init__(self, found: list[Bad]) -> None:
        super().__init__(found)
        self.found = found


def facts_of(components: int, variables: int, clauses: Iterable[Clause]) -> str:
    """Return what encodings/diagnosis.lp wants to know of a model."""
    lines = [f"component(1..{components})."] if components else []
    if variables:
        lines.append(f"variable(1..{variables}).")
    for index, clause in enumerate(clauses):
        facts = [f"clause({index})."]
        facts += [
            f"positive({index},{literal})." if literal > 0 else f"negative({index},{-literal})."
            for literal in clause
        ]
        lines.append("".join(facts))
    return "\n".join(lines)
