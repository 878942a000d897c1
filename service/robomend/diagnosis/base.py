"""What all engines share: reading what is asked, bounds and deadlines, conflicts, and the answer in words.

An engine of ours is a subclass with one method, `_search`, that hands minimal diagnoses to a `SearchState` in
order of size and returns when there are no more of those asked for. Everything else that can happen is an
event, see robomend.diagnosis.search.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterable, Sequence
from contextlib import suppress
from functools import cached_property
from math import log, log1p
from time import perf_counter
from typing import TYPE_CHECKING

from robomend.diagnosis.conflicts import Conflicts, Reasons
from robomend.diagnosis.consistency import Consistency
from robomend.diagnosis.core_guided import MinimumTooLarge
from robomend.diagnosis.explanations import Cleared
from robomend.diagnosis.justification import Justification
from robomend.diagnosis.masks import mask_of
from robomend.diagnosis.observed import (
    NOTHING_SUPPOSED,
    ObservationReader,
    SignedObs,
    Supposed,
    check_options,
    supposed,
)
from robomend.diagnosis.oracle import Deadline, Oracle, OutOfTime, solver_name
from robomend.diagnosis.ranking import rank
from robomend.diagnosis.result import Conflict, Diagnosis, DiagnosisResult, Options, StoppedBy
from robomend.diagnosis.search import (
    MAX_DIAGNOSES,
    LimitReached,
    NoDiagnosis,
    SearchState,
    by_size,
    factors,
    listed_as_rows,
)
from robomend.errors import ContradictoryModel, OptionRefused, SolverError
from robomend.model.cnf import HealthCnf
from robomend_client.literals import Literal

if TYPE_CHECKING:
    from robomend.diagnosis.circuits.traces import Walk

DEFAULTS = Options()

WITNESS_EVERY = 32
"""Consistency checks that go to the solver for each one whose model is kept: taking it costs as much."""


class BaseEngine(ABC):
    """The engine without its search."""

    name = ""

    def __init__(
        self, cnf: HealthCnf, *, solver: str | None = None, default_solver: str = "minisat22"
    ) -> None:
        self.cnf = cnf
        self.solver = solver_name(solver, default_solver)
        self._clock = Deadline()
        self._reader = ObservationReader(cnf)
        self._reasons = Reasons(cnf, self._clock)
        self._conflicts = Conflicts(cnf, self._reasons, self._clock)
        self._consistency = Consistency(cnf, self._clock, self.solver)
        self._witness: frozenset[int] | None = None  # the literals of a model of SD with all healthy
        self._unwitnessed = 0
        self._checked_options: Options | None = None  # those of the last question mostly come again

    @cached_property
    def _checker(self) -> Oracle:
        """SD for consistency checks alone, kept apart from searches: their leftovers would slow it down.

        Its highest variable says that all components are healthy: one assumption instead of many.
        """
        checker = Oracle(self.cnf.clauses, self._clock, self.solver)
        selector = self.cnf.variables + 1
        for variable in self._consistency.health:
            checker.add([-selector, variable])
        return checker

    @abstractmethod
    def _search(self, observed: SignedObs, what_if: Supposed, options: Options, answer: SearchState) -> None:
        """Hand the minimal diagnoses to `answer`, in order of size; see the module for the events."""

    def _refuse(self, options: Options) -> None:
        """Raise OptionRefused for what this engine cannot honour."""
        if options.order == "probability":
            raise OptionRefused(
                f"the {self.name} engine lists diagnoses in order of size only: say order='size' and rank "
                "them, or take an engine that weighs (maxsat)"
            )

    def consistent(self, observations: Iterable[Literal]) -> bool:
        """Return whether SD ∪ observations ∪ {all healthy} is consistent.

        A model that an earlier check came upon is a witness for whatever it agrees with, so that the solver
        is asked only when something else is seen than then.

        Raises:
            ContradictoryModel: a literal and its opposite are both observed.
            SolverError: `interrupt` was called before there was an answer.
        """
        literals = tuple(observations)
        numbers: Sequence[int] = self._reader.numbers(literals)
        if self._witness is not None and self._witness.issuperset(numbers):
            return True
        if 0 in numbers:
            numbers = self._reader.read(literals).numbers
        self._clock.start(None)
        checker = self._checker
        try:
            consistent = checker.sat([self.cnf.variables + 1, *numbers])
        except OutOfTime:
            raise SolverError("interrupted before the consistency check had an answer") from None
        if not consistent:
            self._reader.read(literals)  # which refuses a clash, the other reason for a no
        else:
            if self._unwitnessed % WITNESS_EVERY == 0:
                self._witness = frozenset(checker.model() or ())
            self._unwitnessed += 1
        return consistent

    def diagnose(self, observations: Iterable[Literal], options: Options = DEFAULTS) -> DiagnosisResult:
        """Return the minimal diagnoses of SD ∪ observations; see robomend.diagnosis.result.Engine."""
        started = perf_counter()
        if options is not self._checked_options:
            check_options(options)
            if options.factored and options.minimal != "cardinality" and self.cnf.circuit:
                raise OptionRefused(
                    "the factored form of a circuit is for minimal cardinality: say minimal='cardinality'"
                )
            self._refuse(options)
            self._checked_options = options
        observations = tuple(observations)
        observed = self._reader.read(observations)
        what_if = supposed(self.cnf, options)
        self._clock.start(options.timeout_s)
        answer = SearchState(MAX_DIAGNOSES if options.limit is None else options.limit, self._clock)
        stopped: StoppedBy | None = None
        try:
            self._search(observed, what_if, options, answer)
        except OutOfTime:
            stopped = "time"
        except LimitReached:
            stopped = "limit"
        except MinimumTooLarge:
            stopped = "size"
        except NoDiagnosis:
            stopped = self._explain_contradiction(observed, what_if)
            if stopped is None:
                answer.known.clear()  # beside a supposition that cannot be, what else was met is needless
        result = self._answer(started, observed, what_if, options, answer, stopped)
        return rank(result, self.cnf, options, observations) if self.cnf.priors else result

    # --- the answer in words ----------------------------------------------------------------------

    def _answer(
        self,
        started: float,
        observed: SignedObs,
        what_if: Supposed,
        options: Options,
        answer: SearchState,
        stopped: StoppedBy | None,
    ) -> DiagnosisResult:
        names = self.cnf.components
        found, modes = answer.found, answer.modes
        at_least, at_most, proved = self._bounds(options, answer, stopped)
        if len(found) > 1 and not answer.rows and options.order == "size":
            found.sort(key=by_size)
        if self.cnf.modes:
            self._name_modes(answer, [*observed.numbers, *what_if.numbers])
        blamed = [tuple([names[variable - 1] for variable in bad]) for bad in found]
        conflicts: tuple[Conflict, ...] = ()
        whole, every = True, found == [()]
        hit: list[int] = []
        if options.conflicts and found != [()]:
            masks = [mask_of(bad) for bad in found]
            told = Justification(
                self._conflicts,
                self._consistency,
                observed,
                what_if,
                masks,
                everything=options.conflicts == "all",
                walk=lambda abnormal: self._walk(observed, what_if, abnormal),
            )
            known = told.of(answer)
            whole, every = told.complete, told.whole
            conflicts = tuple([self._conflicts.in_words(one) for one in known])
            hit = [one.mask for one in known]
        if hit:
            diagnoses = [
                Diagnosis(
                    bad,
                    None,
                    modes.get(numbers, {}) if modes else {},
                    tuple([index for index, conflict in enumerate(hit) if mask & conflict]),
                )
                for bad, numbers, mask in zip(blamed, found, masks, strict=True)
            ]
        else:
            diagnoses = [
                Diagnosis(bad, None, modes.get(numbers, {}) if modes else {})
                for bad, numbers in zip(blamed, found, strict=True)
            ]
        rows = answer.rows
        if options.factored and not rows:
            rows = listed_as_rows(found)
        return DiagnosisResult(
            components=names,
            diagnoses=tuple(diagnoses),
            complete=stopped is None,
            stopped_by=stopped,
            conflicts=conflicts,
            elapsed_s=perf_counter() - started,
            unused=observed.unused,
            factored=tuple([factors(row, names) for row in rows]) if rows else (),
            count=answer.count if answer.count is not None else len(blamed) if stopped is None else None,
            conflicts_complete=whole,
            conflicts_all=every,
            size_at_least=at_least,
            size_at_most=at_most,
            smallest_proved=proved,
            cleared=Cleared(blamed, conflicts) if conflicts else {},
        )

    def _walk(self, observed: SignedObs, what_if: Supposed, abnormal: Sequence[Iterable[int]]) -> Walk | None:
        """Simulate with these components abnormal, a lane each; None where that is not to be had at once."""
        return None

    def _bounds(
        self, options: Options, answer: SearchState, stopped: StoppedBy | None
    ) -> tuple[int | None, int | None, bool]:
        """Return bounds of the size of the smallest diagnosis, and whether it is found or there is none.

        Where time ended a search for minimum cardinality the smallest that it has is added to those found.
        """
        if answer.found:
            if options.order == "size":
                size = min(map(len, answer.found))
                return size, size, True
            return None, min(map(len, answer.found)), stopped is None
        if stopped is None:
            return None, None, True
        if stopped == "size":
            return (0 if options.max_size is None else options.max_size) + 1, None, False
        best = answer.best
        at_most = None if best is None else len(best)
        within = best is not None and (options.max_size is None or len(best) <= options.max_size)
        if best is not None and within and options.minimal == "cardinality" and not options.factored:
            answer.found.append(best)
            answer.modes.setdefault(best, {})
        return answer.at_least, at_most, at_most == answer.at_least

    def _name_modes(self, answer: SearchState, assumptions: Sequence[int]) -> None:
        """Tell the first fault modes that fit, whatever the search, as far as there is time.

        A search takes the modes of the model that it comes upon, and any mode will do for that.
        """
        with suppress(OutOfTime):
            for bad in answer.found:
                if told := answer.modes.get(bad):
                    answer.modes[bad] = self._consistency.named(bad, told, assumptions)

    def _explain_contradiction(self, observed: SignedObs, what_if: Supposed) -> StoppedBy | None:
        """Raise ContradictoryModel with a small core, unless it is the supposition alone that cannot be.

        When the time is up, what is known by then is told: the search has proved that nothing explains OBS.

        Returns:
            "time" if it was not settled which of the two cannot be.
        """
        core: Sequence[int] = observed.numbers
        oracle = self._consistency.oracle
        try:
            if oracle.sat([*observed.numbers]):
                return None
            core = [number for number in oracle.core() or () if number in observed.seen]
            core = self._conflicts.minimise(oracle, core, observed, NOTHING_SUPPOSED).observations
        except OutOfTime:
            if core is observed.numbers and what_if is not NOTHING_SUPPOSED:
                return "time"
        literals = tuple(map(self.cnf.word, core))
        rules = self._reasons.rules(core)
        raise ContradictoryModel(literals, tuple(self.cnf.rules[index].text for index in rules)) from None

    # --- life -------------------------------------------------------------------------------------

    def interrupt(self) -> None:
        """Make a running `diagnose` stop soon with what it has, stopped_by "time". From any thread."""
        self._clock.stop()

    def close(self) -> None:
        """Free the solvers."""
        self._consistency.close()
        if "_checker" in self.__dict__:
            self.__dict__.pop("_checker").close()
        self._reasons.close()


def refuse_order_of_probability(cnf: HealthCnf, options: Options) -> None:
    """Raise OptionRefused where an order of probability would mean nothing."""
    if options.minimal == "cardinality":
        raise OptionRefused("order 'probability' is of subset-minimal diagnoses: say minimal='subset'")
    if not cnf.priors:
        raise OptionRefused("order 'probability' needs priors, and the model has none")


def costs_of_blame(cnf: HealthCnf) -> list[float]:
    """Return ln((1 - p)/p) of each component: with these as costs, the cheapest set is the most probable.

    Raises:
        OptionRefused: a component has no prior, or is more likely abnormal than not.
    """
    costs = []
    for component in cnf.components:
        prior = cnf.priors.get(component)
        if prior is None:
            raise OptionRefused(
                f"order 'probability' needs a prior of every component; {component!r} has none"
            )
        if prior >= 0.5:
            raise OptionRefused(
                f"order 'probability' needs priors below 0.5; that of {component!r} is {prior}"
            )
        costs.append(log1p(-prior) - log(prior))
    return costs
