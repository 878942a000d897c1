"""One fault set that explains many snapshots of the same system.

A snapshot is one set of observations; the wires may carry other values in each, but what is broken is
broken in all of them. A diagnosis of the snapshots is a minimal Δ such that SD ∪ OBS_i ∪ {¬AB(c) | c ∉ Δ}
is consistent for *every* i. A conflict of any one snapshot is a conflict of all, so implicit hitting sets
work unchanged:

    hitting set of the conflicts ──► consistent with snapshot 1, 2, … m?  all ──► diagnosis; block it
              ▲                                │ one is not
              └──────── new conflict ◄─────────┘

One solver holds SD once and takes each snapshot as assumptions, instead of m copies of SD. The snapshot
that refuted the last candidate is asked first: it refutes most of the next ones too.

The search ends when nothing else hits the conflicts. Mostly it is known sooner: where the diagnoses found are
all that one snapshot has by itself, there are no others.

Source: A. Ignatiev, A. Morgado, G. Weissenbacher, J. Marques-Silva. Model-based diagnosis with multiple
observations. IJCAI 2019.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Sequence
from contextlib import suppress
from dataclasses import replace
from functools import cached_property
from time import perf_counter, thread_time

from robomend.diagnosis.conflicts import Conflicts, Known, Reasons
from robomend.diagnosis.explanations import Cleared
from robomend.diagnosis.guided import AnyHittingSets, CheapestHittingSets
from robomend.diagnosis.justification import JUSTIFIED, MAX_CONFLICTS
from robomend.diagnosis.masks import bits, mask_of, members, outside
from robomend.diagnosis.observed import ObservationReader, SignedObs, Supposed, check_options, supposed
from robomend.diagnosis.oracle import Deadline, Oracle, OutOfTime, solver_name
from robomend.diagnosis.result import Diagnosis, DiagnosisResult, Options, StoppedBy
from robomend.diagnosis.search import MAX_DIAGNOSES
from robomend.errors import ContradictoryModel, OptionRefused
from robomend.model.cnf import Clause, HealthCnf
from robomend_client.literals import Literal

# --- which part of a candidate explains a snapshot: what is not asked again of the candidates that share it.
#
#     snapshot 1 is explained by {a}        {a, b} and {a, c} explain it, too: no question to the solver
#     snapshot 2 is explained by {b}        of {a, c} it is asked
#
# Whether OBS is consistent with the health of all others does not depend on who else is said to be
# abnormal, so that whatever contains such a part explains the snapshot. A model tells the part: those of
# the candidate whose clauses it breaks if they are healthy.

OFTEN = 8
"""Diagnoses of several components after which parts are noted: of few it is not worth it."""

MOST_MEMBERS = 4
MOST_PARTS = 1_000
"""Of a candidate whose parts are looked up, and of parts that are kept of a snapshot."""


class ExplainedParts:
    """The parts of candidates over one model; `forced` components are abnormal whatever is asked."""

    def __init__(self, cnf: HealthCnf, forced: Collection[int]) -> None:
        self.explaining = 0  # diagnoses of several components so far
        self._cnf = cnf
        self._forced = mask_of(forced)

    def of(self, abnormal: int) -> frozenset[int]:
        """Return the parts of a candidate, as masks; none where it is too large, or a single component."""
        if self.explaining < OFTEN or not 1 < abnormal.bit_count() <= MOST_MEMBERS:
            return frozenset()
        parts = [self._forced]
        for bit in bits(abnormal & ~self._forced):
            parts += [part | 1 << bit for part in parts]
        return frozenset(parts)

    def note(self, explained: set[int], abnormal: int, oracle: Oracle) -> None:
        """Add the part of a candidate that the last model needs to be abnormal."""
        if len(explained) >= MOST_PARTS:
            return
        model = oracle.model()
        needed = abnormal
        for bit in bits(abnormal & ~self._forced):
            model[bit] = bit + 1
            if all(any(model[abs(lit) - 1] == lit for lit in clause) for clause in self._clauses[bit + 1]):
                needed ^= 1 << bit
            else:
                model[bit] = -(bit + 1)
        explained.add(needed)

    @cached_property
    def _clauses(self) -> dict[int, list[Clause]]:
        """Component -> the clauses that say something where it is healthy."""
        found: dict[int, list[Clause]] = {variable: [] for variable in self._cnf.health.values()}
        for clause in self._cnf.clauses:
            for literal in clause:
                if -literal in found:
                    found[-literal].append(clause)
        return found


DEFAULTS = Options()

HEAD_START_S = 0.5
"""Processor time for the search in any order, which mostly finds all diagnoses by then."""

MAX_CIRCUIT_CONFLICTS = 8
"""Told of several snapshots: each has hundreds of gates, and takes long to be made minimal."""

FEW = 3
"""Snapshots that refute most of the candidates that any does: those that refuted the last ones come first."""

ASKED_AGAIN = 4
"""Times as many diagnoses as when it was last asked whether there are others."""

ASKED_FIRST = 10
"""Snapshots that are asked: where one tells, most do, those that refuted the last candidates above all."""

ROUGH_CALLS = 20
"""Of the solver, to make a conflict smaller where the search is by size. That nothing else is as small takes
hundreds of conflicts, of circuits with hundreds of gates each, and to make one minimal takes longer than to
do with a larger one."""

EASY_CONFLICTS = 10
EASY_PROPAGATIONS = 0.5
"""Of such a question, the latter for each variable of the model."""


class SnapshotEngine:
    """Diagnoses of many snapshots over one model, kept warm. One call at a time, as every engine."""

    def __init__(self, cnf: HealthCnf, *, solver: str | None = None) -> None:
        self.cnf = cnf
        self._clock = Deadline()
        self._oracle = Oracle(cnf.clauses, self._clock, solver_name(solver))
        self._reader = ObservationReader(cnf)
        self._reasons = Reasons(cnf, self._clock)
        self._conflicts = Conflicts(cnf, self._reasons, self._clock)

    def diagnose(
        self, snapshots: Iterable[Iterable[Literal]], options: Options = DEFAULTS
    ) -> DiagnosisResult:
        """Return the minimal fault sets that explain every snapshot.

        The smallest are listed where there are more than the limit. Stopped by time, there may be smaller
        ones than those found, unless `minimal="cardinality"` or `max_size` is asked for, which are searched
        in order of size. Without a limit a million ends the search, as everywhere. No snapshot at all is
        explained by the empty diagnosis.

        Raises:
            ContradictoryModel: one snapshot contradicts SD, whatever is abnormal.
            OptionRefused: order "probability", the factored form and all conflicts: of single observations.
        """
        started = perf_counter()
        check_options(options)
        if options.order == "probability" or options.factored:
            refused = "order 'probability'" if options.order == "probability" else "the factored form"
            raise OptionRefused(f"{refused} is not available for several snapshots")
        if options.conflicts == "all":
            raise OptionRefused("all minimal conflicts can be listed of single observations only")
        what_if = supposed(self.cnf, options)
        distinct: dict[frozenset[int], SignedObs] = {}
        for observed in map(self._reader.read, snapshots):
            distinct.setdefault(observed.seen, observed)
        self._clock.start(options.timeout_s)
        options = replace(options, limit=MAX_DIAGNOSES if options.limit is None else options.limit)
        search = _SnapshotSearch(self._oracle, self._conflicts, list(distinct.values()), what_if, self.cnf)
        found: list[int] = []
        stopped = search.run(found, options, self._clock)
        if search.contradiction is not None and not what_if.healthy and not what_if.abnormal:
            known, observed = search.contradiction
            raise self._contradiction(self._resting_on_less(known, observed, what_if))
        masks = sorted(found, key=lambda mask: (mask.bit_count(), bits(mask)))[: options.limit]
        blamed = [tuple(self.cnf.components[bit] for bit in bits(mask)) for mask in masks]
        # What contradicts by itself makes whatever else was met no conflict: it would be needless there.
        met = search.known if search.contradiction is None else [search.contradiction]
        told = self._justifying(masks, met) if options.conflicts else []
        smaller = {one.mask: one for one in [self._resting_on_less(*pair, what_if) for pair in told]}
        conflicts = tuple(map(self._conflicts.in_words, smaller.values()))
        by_size = options.minimal == "cardinality" or options.max_size is not None
        proved = stopped in (None, "limit") or (bool(blamed) and (stopped == "size" or by_size))
        unused = dict.fromkeys(literal for observed in distinct.values() for literal in observed.unused)
        return DiagnosisResult(
            components=self.cnf.components,
            diagnoses=tuple(
                Diagnosis(bad, resolves=tuple(i for i, conflict in enumerate(smaller) if mask & conflict))
                for bad, mask in zip(blamed, masks, strict=True)
            ),
            complete=stopped is None,
            stopped_by=stopped,
            conflicts=conflicts,
            elapsed_s=perf_counter() - started,
            unused=tuple(unused),
            count=len(masks) if stopped is None else None,
            cleared=Cleared(blamed, conflicts) if conflicts else {},
            size_at_least=min(map(len, blamed)) if blamed and proved else None,
            size_at_most=min(map(len, blamed), default=None),
            smallest_proved=proved,
        )

    def _justifying(
        self, masks: list[int], known: list[tuple[Known, SignedObs]]
    ) -> list[tuple[Known, SignedObs]]:
        """Return the conflicts to report: for each member of the first diagnoses one that needs it.

        Each diagnosis is a minimal hitting set of all conflicts met, so that there always is one.
        """
        most = MAX_CIRCUIT_CONFLICTS if self.cnf.circuit else MAX_CONFLICTS
        if len(known) <= most:
            return known
        told: dict[int, tuple[Known, SignedObs]] = {}
        for mask in masks[:JUSTIFIED]:
            for bit in bits(mask):
                if len(told) < most and not any(conflict & mask == 1 << bit for conflict in told):
                    needs = next((pair for pair in known if pair[0].mask & mask == 1 << bit), None)
                    if needs is not None:  # None: it is supposed abnormal
                        told[needs[0].mask] = needs
        return list(told.values()) or known[:most]

    def _resting_on_less(self, known: Known, observed: SignedObs, what_if: Supposed) -> Known:
        """Return a conflict of the search with no more in it than it needs, if there is time."""
        literals = [*known.components, *known.observations]
        needed = known.components if known.minimal else ()
        with suppress(OutOfTime):
            return self._conflicts.minimise(self._oracle, literals, observed, what_if, needed=needed)
        return known

    def _contradiction(self, known: Known) -> ContradictoryModel:
        literals = tuple(map(self.cnf.word, known.observations))
        rules = self._reasons.rules(known.observations)
        return ContradictoryModel(literals, tuple(self.cnf.rules[index].text for index in rules))

    def interrupt(self) -> None:
        """Make a running `diagnose` stop soon with what it has."""
        self._clock.stop()

    def close(self) -> None:
        """Free the solver."""
        self._oracle.close()
        self._reasons.close()


class _SnapshotSearch:
    """One call: the snapshots, and the conflicts that they gave so far."""

    def __init__(
        self,
        oracle: Oracle,
        conflicts: Conflicts,
        snapshots: list[SignedObs],
        what_if: Supposed,
        cnf: HealthCnf,
    ) -> None:
        self.known: list[tuple[Known, SignedObs]] = []
        self.contradiction: tuple[Known, SignedObs] | None = None
        self._oracle = oracle
        self._conflicts = conflicts
        # The one that refuted last comes first; with each, parts of candidates that explain it.
        self._snapshots = [(observed, set[int]()) for observed in snapshots]
        self._parts = ExplainedParts(cnf, what_if.abnormal)
        self._what_if = what_if
        self._health = list(range(1, len(cnf.components) + 1))
        self._forced = mask_of(what_if.abnormal)
        self._variables = cnf.variables
        self._calls: int | None = None  # to make a conflict smaller

    def find_conflict(self, abnormal: int) -> int | None:
        """Return a small conflict that these components do not hit; None: they explain each snapshot."""
        healthy = outside(self._health, abnormal)
        healthy += [-variable for variable in self._what_if.abnormal]
        position = self._refuting(healthy, abnormal)
        if position is None:
            self._parts.explaining += abnormal.bit_count() > 1
            return None
        self._snapshots.insert(0, self._snapshots.pop(position))
        observed, _ = self._snapshots[0]
        core = self._oracle.core() or ()
        known = self._conflicts.minimise(
            self._oracle, core, observed, self._what_if, components_only=True, calls=self._calls
        )
        if not known.mask:
            self.contradiction = (known, observed)
            raise _Contradiction
        self.known.append((known, observed))
        return known.mask

    def _refuting(self, healthy: list[int], abnormal: int) -> int | None:
        """Return the position of a snapshot that clashes with this; the oracle then knows a core of it.

        What the first ones do not refute, mostly none does: then one literal says all of it for the others,
        and a call takes two thirds of the time. Where a part of a candidate is known to explain a snapshot,
        so does the candidate, and the solver is not asked.
        """
        oracle, selector = self._oracle, 0
        parts = self._parts.of(abnormal)
        asked = 0
        try:
            for position, (observed, explained) in enumerate(self._snapshots):
                if not parts.isdisjoint(explained):
                    continue
                if asked == FEW:
                    selector = self._unused()
                    for literal in healthy:
                        oracle.add([-selector, literal])
                asked += 1
                if (selector and oracle.sat([selector, *observed.numbers])) or oracle.sat(
                    [*observed.numbers, *healthy]
                ):
                    if parts:
                        self._parts.note(explained, abnormal, oracle)
                    continue
                return position
            return None
        finally:
            if selector:
                oracle.add([-selector])

    def was_last(self, found: Sequence[int]) -> bool:
        """Return whether it is easily seen that each other diagnosis contains one of those found.

        It is seen at a single snapshot, some of which are asked. Hitting sets would tell it too, after many
        more conflicts.
        """
        oracle = self._oracle
        guard = self._unused()
        for diagnosis in found:
            oracle.add([-guard, *members(diagnosis)])
        assumed = [*self._what_if.numbers, guard]
        propagations = int(EASY_PROPAGATIONS * self._variables)
        try:
            return any(
                oracle.quickly([*observed.numbers, *assumed], EASY_CONFLICTS, propagations) is False
                for observed, _ in self._snapshots[:ASKED_FIRST]
            )
        finally:
            oracle.add([-guard])

    def _unused(self) -> int:
        """Return a variable that the solver has not met."""
        met: int = self._oracle.variables()
        return max(self._variables, met) + 1

    def run(self, found: list[int], options: Options, clock: Deadline) -> StoppedBy | None:
        """Put the diagnoses into `found`; return why the search ended before all were found."""
        bounded = options.minimal == "cardinality" or options.max_size is not None
        self._calls = ROUGH_CALLS if bounded else None
        by_size = CheapestHittingSets([1] * len(self._health), clock)
        any_ = AnyHittingSets(clock)
        try:
            return (
                self._in_order(found, options, by_size)
                if bounded
                else self._both(found, options, by_size, any_)
            )
        except OutOfTime:
            return "time"
        except _Contradiction:
            return None
        finally:
            by_size.close()
            any_.close()

    def _in_order(self, found: list[int], options: Options, sets: CheapestHittingSets) -> StoppedBy | None:
        """Search in order of size only, up to the size that is wanted."""
        forced = self._forced
        while (candidate := sets.next()) is not None:
            size = (candidate | forced).bit_count()
            if options.minimal == "cardinality" and found and size > found[0].bit_count():
                return None
            too_large = options.max_size is not None and size > options.max_size
            conflict = self.find_conflict(candidate | forced)
            if conflict is not None:
                sets.hit(conflict)
                continue
            if too_large:
                return "size"
            if options.limit is not None and len(found) >= options.limit:
                return "limit"
            found.append(candidate | forced)
            sets.block(candidate)
        return None

    def _both(
        self, found: list[int], options: Options, by_size: CheapestHittingSets, any_: AnyHittingSets
    ) -> StoppedBy | None:
        """Search in two ways by turns that share what they find.

        Any minimal hitting set will do to find all diagnoses, and is found faster. But where there are too
        many, the smallest are wanted, and by size alone the search may not come far. The first of the two
        that is done ends it.
        """
        forced, most = self._forced, options.limit or MAX_DIAGNOSES
        met: list[tuple[int, bool]] = []  # conflicts, and diagnoses (True), in the order in which they came
        told = {True: 0, False: 0}  # how many of them `any_` and `by_size` know
        spent = {True: -HEAD_START_S, False: 0.0}
        asked_at = 1  # so many diagnoses, and it is asked whether there are others
        while True:
            began = thread_time()  # which search goes on does not depend on what else the computer does
            anyhow = spent[True] <= spent[False] and len(found) <= most
            sets: AnyHittingSets | CheapestHittingSets = any_ if anyhow else by_size
            for mask, explains in met[told[anyhow] :]:
                if explains:
                    sets.block(mask)
                else:
                    sets.hit(mask)
            told[anyhow] = len(met)
            candidate = sets.next()
            if len(found) >= asked_at and candidate is not None and candidate.bit_count() > 1:
                asked_at = ASKED_AGAIN * len(found)
                if self.was_last(found):
                    candidate = None
            if candidate is None:
                return "limit" if len(found) > most else None
            conflict = self.find_conflict(candidate | forced)
            if conflict is None:
                found.append(candidate | forced)
                met.append((candidate, True))
            else:
                met.append((conflict, False))
            spent[anyhow] += thread_time() - began
            if len(found) > most:
                largest = sorted(map(int.bit_count, found))[most - 1]
                if largest <= by_size.cost + forced.bit_count():  # none that is still to come is smaller
                    return "limit"


class _Contradiction(Exception):
    """A conflict without components: nothing can explain it."""


def diagnose_snapshots(
    cnf: HealthCnf, snapshots: Sequence[Iterable[Literal]], options: Options = DEFAULTS
) -> DiagnosisResult:
    """Return the minimal fault sets that explain every snapshot; see SnapshotEngine.diagnose."""
    engine = SnapshotEngine(cnf)
    try:
        return engine.diagnose(snapshots, options)
    finally:
        engine.close()
