"""What all engines share: reading what is asked, bounds and deadlines, conflicts, and the answer in words.

An engine of ours is a subclass with one method, `_search`, that hands minimal diagnoses to an `Answer` in
order of size and returns when there are no more of those asked for. Everything else that can happen is an
event:

    LimitReached   raised by answer.add when enough were found           stopped_by "limit"
    MinimumTooLarge       raised by the search: larger ones exist               stopped_by "size"
    OutOfTime      raised by the oracle or the clock                     stopped_by "time"
    NoDiagnosis    raised by the search: nothing explains OBS            ContradictoryModel; in what-if, none

What a search found before the event stays true, because it was found in order of size.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from time import perf_counter

from robomend.diagnosis.conflicts import Conflicts, Known
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
from robomend.diagnosis.oll import MinimumTooLarge
from robomend.diagnosis.oracle import Deadline, Oracle, OutOfTime, solver_name
from robomend.diagnosis.ranking import rank
from robomend.diagnosis.reasons import Reasons
from robomend.diagnosis.result import Conflict, Diagnosis, DiagnosisResult, Factor, Options, StoppedBy
from robomend.errors import ContradictoryModel, OptionRefused, SolverError
from robomend.model.cnf import HealthCnf
from robomend_client.literals import Literal

DEFAULTS = Options()

Bad = tuple[int, ...]
"""A diagnosis in numbers: the health variables of the abnormal components, ascending."""

MAX_DIAGNOSES = 1_000_000
"""Where no limit is given, this one holds: some 300 MB of result. The factored form counts on without it."""

CONTRADICTION_S = 10.0
"""To explain why nothing explains OBS; when it is over, what is known by then is told."""

WITNESS_EVERY = 32
"""Consistency checks that go to the solver for each one whose model is kept: taking it costs as much."""

LEFTOVER_CLAUSES = 20_000
"""Retired clauses that are tolerated in the general solver before it is built anew."""


class LimitReached(Exception):
    """As many diagnoses as asked for were found."""


class NoDiagnosis(Exception):
    """SD ∪ OBS, with what is supposed, has no model however many components are abnormal."""


@dataclass(slots=True)
class SearchState:
    """What a search has found so far."""

    limit: int
    found: list[Bad] = field(default_factory=list)
    modes: dict[Bad, Mapping[str, str]] = field(default_factory=dict)
    # Conflicts met on the way; they need not be minimal under all of OBS.
    known: list[Known] = field(default_factory=list)
    # Factored: a row a top-level diagnosis, in it for each member what may stand in for it.
    rows: list[tuple[Sequence[int], ...]] = field(default_factory=list)
    count: int | None = None  # exact, where the search knows more than it lists

    def add(self, bad: Bad) -> None:
        """Take the next minimal diagnosis.

        One more than the limit is looked for, so that `complete` is known; not with a limit of 1, which asks
        for any one diagnosis as soon as possible.

        Raises:
            LimitReached: there is no room for it, or it is the one that was asked for.
        """
        if len(self.found) >= self.limit:
            raise LimitReached
        self.found.append(bad)
        if self.limit == 1 and bad:
            raise LimitReached


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
        self._reasons = Reasons(cnf)
        self._conflicts = Conflicts(cnf, self._reasons)
        self._health = list(range(1, len(cnf.components) + 1))
        self._guard = cnf.variables
        self._leftover = 0
        self._witness: frozenset[int] | None = None  # the literals of a model of SD with all healthy
        self._unwitnessed = 0

    @cached_property
    def _oracle(self) -> Oracle:
        """SD, to be asked under assumptions."""
        return Oracle(self.cnf.clauses, self._clock, self.solver)

    @cached_property
    def _checker(self) -> Oracle:
        """SD for consistency checks alone, kept apart from searches: their leftovers would slow it down.

        Its highest variable says that all components are healthy: one assumption instead of many.
        """
        checker = Oracle(self.cnf.clauses, self._clock, self.solver)
        selector = self.cnf.variables + 1
        for variable in self._health:
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
        if options is not DEFAULTS:
            check_options(options)
            if options.factored and options.minimal != "cardinality":
                raise OptionRefused("the factored form is for minimal cardinality: say minimal='cardinality'")
        self._refuse(options)
        observed = self._reader.read(observations)
        what_if = supposed(self.cnf, options)
        self._clock.start(options.timeout_s)
        answer = SearchState(MAX_DIAGNOSES if options.limit is None else options.limit)
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
        result = self._answer(started, observed, what_if, options, answer, stopped)
        return rank(result, self.cnf, options) if self.cnf.priors else result

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
        if len(answer.found) > 1 and not answer.rows and options.order == "size":
            answer.found.sort(key=by_size)
        masks: list[int] = []
        known: list[Known] = []
        conflicts: tuple[Conflict, ...] = ()
        if options.conflicts and answer.found != [()]:
            masks = [mask_of(bad) for bad in answer.found]
            known = Justification(self.cnf, self._oracle, self._conflicts, observed, what_if, masks).of(
                answer.known
            )
            conflicts = tuple([self._conflicts.in_words(one, observed) for one in known])
        blamed = [tuple([names[variable - 1] for variable in bad]) for bad in answer.found]
        if known:
            hit = [one.mask for one in known]
            diagnoses = [
                Diagnosis(
                    bad,
                    None,
                    answer.modes.get(numbers, {}),
                    tuple([index for index, mask_of_conflict in enumerate(hit) if mask & mask_of_conflict]),
                )
                for bad, numbers, mask in zip(blamed, answer.found, masks, strict=True)
            ]
        else:
            diagnoses = [
                Diagnosis(bad, None, answer.modes.get(numbers, {}))
                for bad, numbers in zip(blamed, answer.found, strict=True)
            ]
        factored: tuple[tuple[Factor, ...], ...] = ()
        if options.factored:
            rows = answer.rows[: len(answer.found)] or [
                tuple((variable,) for variable in bad) for bad in answer.found
            ]
            factored = tuple(
                tuple(Factor(names[row[0] - 1], tuple(names[v - 1] for v in row)) for row in factors)
                for factors in rows
            )
        count = answer.count if answer.count is not None else len(blamed)
        return DiagnosisResult(
            components=names,
            diagnoses=tuple(diagnoses),
            complete=stopped is None,
            stopped_by=stopped,
            conflicts=conflicts,
            elapsed_s=perf_counter() - started,
            unused=observed.unused,
            factored=factored,
            count=count if stopped is None else None,
            cleared=Cleared(blamed, conflicts) if conflicts else {},
        )

    def _any_more(self, assumptions: list[int], blocked: Sequence[Sequence[int]]) -> bool:
        """Return whether some diagnosis contains none of those found, whatever its size."""
        if self._leftover > LEFTOVER_CLAUSES:
            self.__dict__.pop("_oracle").close()
            self._leftover = 0
        oracle = self._oracle
        self._guard += 1
        for diagnosis in blocked:
            oracle.add([-self._guard, *diagnosis])
        try:
            return oracle.sat([*assumptions, self._guard])
        finally:
            oracle.add([-self._guard])
            self._leftover += len(blocked)

    def _modes_of(self, bad: Iterable[int], model: Sequence[int]) -> Mapping[str, str]:
        """Return a fault mode for each abnormal component that has modes; several may fit, one is told."""
        told: dict[str, str] = {}
        for variable in bad:
            component = self.cnf.components[variable - 1]
            for mode, number in self.cnf.modes.get(component, {}).items():
                if model[number - 1] > 0:
                    told[component] = mode
                    break
        return told

    def _explain_contradiction(self, observed: SignedObs, what_if: Supposed) -> StoppedBy | None:
        """Raise ContradictoryModel with a small core, unless it is the supposition alone that cannot be.

        Returns:
            "time" if it was not settled which of the two cannot be.
        """
        self._clock.start(CONTRADICTION_S)
        core: Sequence[int] = observed.numbers
        try:
            if self._oracle.sat([*observed.numbers]):
                return None
            core = self._oracle.core() or ()
            core = self._conflicts.minimise(self._oracle, core, observed, NOTHING_SUPPOSED).observations
        except OutOfTime:
            if core is observed.numbers and what_if is not NOTHING_SUPPOSED:
                return "time"  # else what is known is told: the search has proved that nothing explains OBS
        literals = tuple(str(observed.literal(number)) for number in core)
        rules = self._reasons.rules(core)
        raise ContradictoryModel(literals, tuple(self.cnf.rules[index].text for index in rules)) from None

    # --- life -------------------------------------------------------------------------------------

    def interrupt(self) -> None:
        """Make a running `diagnose` stop soon with what it has, stopped_by "time". From any thread."""
        self._clock.stop()

    def close(self) -> None:
        """Free the solvers."""
        for oracle in ("_oracle", "_checker"):
            if oracle in self.__dict__:
                self.__dict__.pop(oracle).close()
        self._reasons.close()


def refuse_order_of_probability(cnf: HealthCnf, options: Options) -> None:
    """Raise OptionRefused where an order of probability would mean nothing."""
    if options.minimal == "cardinality":
        raise OptionRefused("order 'probability' is of subset-minimal diagnoses: say minimal='subset'")
    if not cnf.priors:
        raise OptionRefused("order 'probability' needs priors, and the model has none")


def by_size(bad: Bad) -> tuple[int, Bad]:
    """Return what diagnoses are sorted by; those of one size by their components, as in COMPS."""
    return len(bad), bad
