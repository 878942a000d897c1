"""Diagnoses of many sets of observations of one model and the same sensors: for logs.

A set is a row of codes: two bits a sensor, so that true, false and unknown differ. What decides the diagnoses
of a row is which conflicts apply to it, and many rows share that:

    rows ──► distinct rows ──► which conflicts apply (numpy) ──► distinct sets of conflicts ──► diagnoses
                                                                  each put together of its parts

This needs all minimal conflicts of the sensors beforehand (all_conflicts): their minimal hitting sets
are the diagnoses (Reiter 1987), and no solver is asked. Where they cannot be listed (circuits, fault modes,
rules that are not Horn, too many) each distinct row is a question to the engine.

Sources:
    R. Reiter. A theory of diagnosis from first principles. AIJ 32(1), 1987.
    J. de Kleer. An assumption-based TMS. AIJ 28(2), 1986.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from time import perf_counter
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from robomend.diagnosis.by_conflicts import COUNTED
from robomend.diagnosis.conflicts import Reasons
from robomend.diagnosis.core_guided import MinimumTooLarge
from robomend.diagnosis.derivations import Derivations
from robomend.diagnosis.engines import DEFAULT, make_engine
from robomend.diagnosis.masks import bits, mask_of, minimal_masks
from robomend.diagnosis.observed import check_options
from robomend.diagnosis.oracle import Deadline, OutOfTime
from robomend.diagnosis.parts import MULTIPLIED_OUT, IndependentPart, independent, list_diagnoses, minimal
from robomend.diagnosis.ranking import rank, size_then_odds
from robomend.diagnosis.result import Diagnosis, DiagnosisResult, Engine, Factor, Options, StoppedBy
from robomend.diagnosis.search import (
    MAX_DIAGNOSES,
    LimitReached,
    SearchState,
    by_size,
    factors,
    listed_as_rows,
)
from robomend.errors import ContradictoryModel, OptionRefused
from robomend.model.cnf import HealthCnf
from robomend_client.literals import Atom, Literal

# --- all minimal conflicts that a fixed set of sensors can give rise to, whatever they show.
#
# A conflict rests on what was seen of some sensors, so it is kept as two masks: the components that cannot
# all be healthy, and the states of sensors that say so. A robot whose clauses are Horn, with health as a
# premise only, has all of them listed beforehand, by chaining the rules forward from what a sensor may
# show:
#
#     label of ok(scan)    {hokuyo, hokuyo_node}                 derived: while these are healthy
#                          {ok(scan) seen}                       or shown by its own sensor
#     label of ok(map)     {hector_mapping, hokuyo, hokuyo_node}
#                          {hector_mapping, ok(scan) seen}
#
#     not ok(map) seen     with each of them: a conflict
#
# Labels hold only minimal sets, and grow until no rule adds one. They may be exponentially many, so that
# there is a bound, and beyond it the conflicts are found one by one (library.py).
#
# Source: J. de Kleer. An assumption-based TMS. AIJ 28(2), 1986 (labels and environments).

MAX_ENVIRONMENTS = 20_000
"""Of all labels together, while they grow: a second or two."""

MAX_CONFLICTS = 10_000


class SensorConflict(NamedTuple):
    """Components that cannot all be healthy while the sensors are in these states."""

    components: int  # bit i: component i
    states: int  # bit 2s: sensor s shows true; bit 2s + 1: it shows false


class TooManyConflicts(Exception):
    """They cannot be listed beforehand."""


def all_conflicts(cnf: HealthCnf, sensors: Sequence[int]) -> list[SensorConflict]:
    """Return all minimal conflicts of these sensors.

    Args:
        sensors: the variable of each, 0 where no rule mentions it.

    Raises:
        TooManyConflicts: there are more than the bounds, or the clauses are not of the kind.
    """
    if not Derivations.suit(cnf):
        raise TooManyConflicts
    labels = _Labels(cnf, sensors)
    labels.grow()
    shift = len(cnf.components)
    healthy = (1 << shift) - 1
    found = labels.contradictions
    for sensor, variable in enumerate(sensors):
        holds, fails = 1 << (shift + 2 * sensor), 2 << (shift + 2 * sensor)
        found.append(holds | fails)
        found += [one | fails for one in labels.of.get(variable, ())]
    if len(found) > MAX_CONFLICTS:
        raise TooManyConflicts
    return [SensorConflict(one & healthy, one >> shift) for one in minimal_masks(found)]


def containment(masks: Sequence[int]) -> NDArray[np.float32]:
    """Return, shape (masks, masks), 1 where the one of the row is inside that of the column.

    Of equal ones the first is inside the others.
    """
    table = [
        [one & other == one and (one != other or row < column) for column, other in enumerate(masks)]
        for row, one in enumerate(masks)
    ]
    return np.array(table, dtype=np.float32).reshape(len(masks), len(masks))


class _Labels:
    """Variable -> the minimal sets, of components and states, that derive it; see the module."""

    def __init__(self, cnf: HealthCnf, sensors: Sequence[int]) -> None:
        n = len(cnf.components)
        self.of: dict[int, list[int]] = {}
        self.contradictions: list[int] = []
        self._size = 0
        self._rules: list[tuple[int, tuple[int, ...], int]] = []  # health, body, head; 0: none
        self._users: dict[int, list[int]] = {}  # variable -> the rules that have it in their body
        for clause in dict.fromkeys(cnf.clauses):
            head = next((literal for literal in clause if literal > 0), 0)
            body = tuple(-literal for literal in clause if literal < -n)
            for variable in body:
                self._users.setdefault(variable, []).append(len(self._rules))
            self._rules.append((mask_of(-literal for literal in clause if -n <= literal < 0), body, head))
        for sensor, variable in enumerate(sensors):
            if variable:
                self.of[variable] = [1 << (n + 2 * sensor)]

    def grow(self) -> None:
        """Apply the rules until none adds a set."""
        waiting = dict.fromkeys(range(len(self._rules)))
        while waiting:
            rule = next(iter(waiting))
            del waiting[rule]
            mask, body, head = self._rules[rule]
            derived = [mask]
            for variable in body:
                label = self.of.get(variable, ())
                if len(derived) * len(label) > MAX_ENVIRONMENTS:
                    raise TooManyConflicts
                derived = minimal_masks([one | other for one in derived for other in label])
            if head:
                if self._add(head, derived):
                    waiting.update(dict.fromkeys(self._users.get(head, ())))
            else:
                self.contradictions = minimal_masks([*self.contradictions, *derived])

    def _add(self, variable: int, derived: list[int]) -> bool:
        before = self.of.get(variable, [])
        after = minimal_masks([*before, *derived])
        if after == before or set(after) == set(before):
            return False
        self._size += len(after) - len(before)
        if self._size > MAX_ENVIRONMENTS:
            raise TooManyConflicts
        self.of[variable] = after
        return True


WIDTH = 12
"""Components whose names are looked up at once."""

MOST_COMPONENTS = 512
"""Of a model; beyond, a diagnosis holds few of very many."""


class _Names(dict[int, tuple[str, ...]]):
    """Bits of WIDTH components, the first one highest -> their names."""

    def __init__(self, names: Sequence[str]) -> None:
        super().__init__()
        self._names = names

    def __missing__(self, some: int) -> tuple[str, ...]:
        found = tuple([name for place, name in enumerate(self._names) if some >> (WIDTH - 1 - place) & 1])
        self[some] = found
        return found


class Products:
    """Few diagnoses, multiplied out of parts that share no component, in order and as names, many times over.

        alternatives of a part, as keys      {a}  {b, c}
        those of another one                 {d}  {e}         ──► sums, sorted ──► a d, a e, b c d, b c e

    A set of components is one integer whose order is the one that diagnoses are listed in, size before
    members, and the key of a union of disjoint sets is the sum of their keys:

        key = size · 2ⁿ − Σ 2^(n − 1 − c) over its components c         the first component weighs most

    So nothing is compared but integers, and the members are in the lower n bits, negated.
    """

    def __init__(self, components: Sequence[str], most: int) -> None:
        """`most`: diagnoses of an answer; what has more is not for here."""
        starts = range(0, len(components), WIDTH)
        self._most = most if len(components) <= MOST_COMPONENTS else 0
        self._width = WIDTH * len(starts)
        self._names = [
            (_Names(components[start : start + WIDTH]), self._width - WIDTH - start) for start in starts
        ]
        self._keys: dict[tuple[int, ...], list[int]] = {}  # of the alternatives of a part

    def of(
        self, parts: Iterable[Iterable[int]], known: Mapping[tuple[int, ...], IndependentPart]
    ) -> list[tuple[str, ...]] | None:
        """Return the diagnoses, in order; None: they are too many, or not all parts were searched to the end.

        Args:
            parts: the conflicts of each.
            known: parts by their conflicts, sorted.
        """
        count, keys_of = 1, []
        for group in parts:
            keys = self._keys.get(conflicts := tuple(sorted(group)))
            if keys is None:
                part = known.get(conflicts)
                if part is None or not part.done or part.count > self._most:
                    return None
                keys = self._keys[conflicts] = self._keyed(part.listed())
            count *= len(keys)
            if count > self._most:
                return None
            keys_of.append(keys)
        return self._listed(keys_of) if count <= self._most else None

    def forget(self) -> None:
        """Forget the alternatives of all parts: they are searched anew."""
        self._keys.clear()

    def _keyed(self, masks: Iterable[int]) -> list[int]:
        """Return the keys of sets of components, given as masks."""
        return [
            (mask.bit_count() << self._width) - sum(1 << (self._width - 1 - bit) for bit in bits(mask))
            for mask in masks
        ]

    def _listed(self, parts: Iterable[Sequence[int]]) -> list[tuple[str, ...]]:
        """Return the unions of one set of each part, given by their keys."""
        found = [0]
        for keys in parts:
            found = [union + key for union in found for key in keys]
        found.sort()
        all_, low = (1 << self._width) - 1, (1 << WIDTH) - 1
        told = []
        for key in found:
            members = -key & all_
            names: tuple[str, ...] = ()
            for table, shift in self._names:
                names += table[members >> shift & low]
            told.append(names)
        return told


SENSORS_A_WORD = 32

ROWS = 1 << 14
"""That are looked at together: the tables of a step stay small."""

COMPARED = 500
"""Conflicts up to which those that contain another one that applies are left out in numpy."""

REMEMBERED = 50_000
"""Sets of conflicts, parts of them, and rows of the engine, whose diagnoses are remembered; …"""

REMEMBERED_DIAGNOSES = 500_000
"""… and of how many together, as that is what they take in memory: some 100 MB."""

Codes = NDArray[np.uint64]
"""Shape (rows, words): see `Library.codes`."""

Names = tuple[tuple[str, ...], ...]
"""The components of each of several conflicts."""

Answer = DiagnosisResult | ContradictoryModel
"""What is told of a row; the latter where nothing explains it, whatever is abnormal."""


@dataclass(frozen=True, slots=True)
class RowAnswers:
    """Row i has the answer `distinct[index[i]]`; each says whether it is complete."""

    index: NDArray[np.intp]
    distinct: tuple[Answer, ...]
    conflicts: tuple[Names | None, ...]
    """Of each distinct answer: the components of its minimal conflicts; None where they are not known."""

    def __getitem__(self, row: int) -> Answer:
        """Return the answer of a row."""
        return self.distinct[int(self.index[row])]

    def __len__(self) -> int:
        return len(self.index)


class Library:
    """See the module. Not thread-safe; to be made anew in each process, as it holds a solver.

    Args:
        cnf: the model.
        sensors: the atoms that are observed, in the order of the codes; one that no rule mentions says
            nothing.
        options: of each row, as for an engine; `timeout_s` is for a distinct row.

    Raises:
        OptionRefused: what-if and order of probability are for single sets; conflicts are not told here.
    """

    def __init__(self, cnf: HealthCnf, sensors: Sequence[Atom], options: Options) -> None:
        check_options(options)
        if options.healthy or options.abnormal or options.order == "probability" or options.conflicts:
            raise OptionRefused("a library tells no conflicts, supposes nothing and lists by size")
        if len(set(sensors)) < len(sensors):
            raise OptionRefused("a sensor is named twice")
        self.cnf = cnf
        self.sensors = tuple(sensors)
        self.words = max(1, -(-len(self.sensors) // SENSORS_A_WORD))
        self.said = [Literal(atom, positive) for atom in self.sensors for positive in (True, False)]
        """By the bit of a code that says it."""
        self._options = options
        self._clock = Deadline()
        self._reasons = Reasons(cnf, self._clock)
        self._cost = size_then_odds(cnf) if cnf.priors else int.bit_count
        self._parts: dict[tuple[int, ...], IndependentPart] = {}
        self._of_sets: dict[bytes, tuple[Answer, Names]] = {}  # which conflicts apply, as bits -> answer
        self._of_rows: dict[tuple[int, ...], Answer] = {}
        self._diagnoses = 0  # of these answers
        self._engine: Engine | None = None
        self.conflicts: list[SensorConflict] = []
        """All minimal ones, if `whole`."""
        try:
            self.conflicts = all_conflicts(cnf, [cnf.atom_variable.get(atom, 0) for atom in self.sensors])
        except TooManyConflicts:
            self._engine = make_engine(DEFAULT, cnf)
        # Conflicts of the same components are one column; each contradiction is one of its own.
        of = [(one.components, 0 if one.components else one.states) for one in self.conflicts]
        self._columns = sorted(set(of))  # so that the masks of a set are in order
        columns = {column: place for place, column in enumerate(self._columns)}
        self._column = [columns[column] for column in of]
        self._names = {mask: tuple([cnf.components[bit] for bit in bits(mask)]) for mask, _ in columns}
        self._contained: NDArray[np.float32] | None = None
        if len(columns) <= COMPARED:
            self._contained = containment([components for components, _ in self._columns])
        few = MULTIPLIED_OUT if options.limit is None else min(MULTIPLIED_OUT, options.limit)
        short = not options.factored and options.max_size is None
        self._products = Products(cnf.components, few if short else 0)

    @property
    def whole(self) -> bool:
        """Whether all minimal conflicts are known, so that no solver is asked."""
        return self._engine is None

    # --- codes ------------------------------------------------------------------------------------

    def codes(self, true: NDArray[np.bool_], false: NDArray[np.bool_]) -> Codes:
        """Return rows of observations as codes.

        Bit 2s of a row is set where sensor s was seen true, bit 2s + 1 where it was seen false, 32 sensors in
        each word.

        Args:
            true: shape (rows, sensors): the atom was seen to hold.
            false: the same: it was seen to fail; neither: nothing is known of it.
        """
        rows = len(true)
        both = np.zeros((rows, self.words * SENSORS_A_WORD, 2), dtype=np.uint8)
        both[:, : len(self.sensors), 0] = true
        both[:, : len(self.sensors), 1] = false
        packed = np.packbits(both.reshape(rows, -1), axis=1, bitorder="little")
        return packed.view("<u8").astype(np.uint64)

    def code(self, observations: Iterable[Literal]) -> Codes:
        """Return one set of observations as a row; KeyError for what none of the sensors says."""
        position = {atom: sensor for sensor, atom in enumerate(self.sensors)}
        seen = np.zeros((2, 1, len(self.sensors)), dtype=np.bool_)
        for literal in observations:
            seen[0 if literal.positive else 1, 0, position[literal.atom]] = True
        return self.codes(seen[0], seen[1])

    def literals(self, code: Sequence[int]) -> list[Literal]:
        """Return what a row says."""
        row = sum(int(word) << (64 * place) for place, word in enumerate(code))
        return [self.said[bit] for bit in bits(row)]

    # --- diagnoses --------------------------------------------------------------------------------

    def diagnose(self, codes: Codes) -> RowAnswers:
        """Return the answer of each row.

        Args:
            codes: see there.
        """
        rows, row_of = distinct(codes.reshape(-1, self.words))
        if self._engine is not None:
            asked = tuple([self._asked(self._engine, tuple(row)) for row in rows.tolist()])
            return RowAnswers(row_of, asked, (None,) * len(asked))
        applying = [
            np.packbits(self._applying(rows[start : start + ROWS]), axis=1)
            for start in range(0, len(rows), ROWS)
        ]
        packed = np.concatenate(applying) if applying else np.packbits(self._applying(rows), axis=1)
        sets, set_of = np.unique(packed, axis=0, return_inverse=True)
        both = [self._of_set(key, places) for key, places in self._places(sets)]
        answers, told = tuple([answer for answer, _ in both]), tuple([names for _, names in both])
        if self.cnf.priors and self.cnf.puts_out:  # what works counts, too, so each row is weighed by itself
            of_rows = set_of.reshape(-1).tolist()
            weighed = [
                self._weighed(answers[of], row) for row, of in zip(rows.tolist(), of_rows, strict=True)
            ]
            return RowAnswers(row_of, tuple(weighed), tuple([told[of] for of in of_rows]))
        return RowAnswers(set_of.reshape(-1)[row_of], answers, told)

    def grounds(self, codes: Codes) -> Codes:
        """Return, as codes, what the minimal conflicts of each row rest on; all of it if they are not known.

        Args:
            codes: see there.
        """
        if self._engine is not None:
            return codes
        grounds = np.zeros_like(codes)
        for start in range(0, len(codes), ROWS):
            rows = codes[start : start + ROWS]
            minimal_ones = self._applying(rows)
            for conflict, column in zip(self.conflicts, self._column, strict=True):
                applies = self._applies(conflict, rows) & minimal_ones[:, column]
                if applies.any():
                    for word, wanted in enumerate(self._words(conflict.states)):
                        grounds[start : start + ROWS, word][applies] |= wanted
        return grounds

    def _weighed(self, answer: Answer, row: Sequence[int]) -> Answer:
        if isinstance(answer, ContradictoryModel):
            return answer
        return rank(answer, self.cnf, self._options, self.literals(row))

    def _applying(self, rows: Codes) -> NDArray[np.bool_]:
        """Return, shape (rows, columns), which columns are minimal conflicts of each row."""
        found = np.zeros((len(rows), len(self._columns)), dtype=np.bool_)
        for conflict, column in zip(self.conflicts, self._column, strict=True):
            found[:, column] |= self._applies(conflict, rows)
        if self._contained is not None:
            found &= (found.astype(np.float32) @ self._contained) == 0
        return found

    def _applies(self, conflict: SensorConflict, rows: Codes) -> NDArray[np.bool_]:
        applies = np.ones(len(rows), dtype=np.bool_)
        for word, wanted in enumerate(self._words(conflict.states)):
            if wanted:
                applies &= (rows[:, word] & wanted) == wanted
        return applies

    def _words(self, states: int) -> list[np.uint64]:
        return [np.uint64(states >> (64 * word) & (1 << 64) - 1) for word in range(self.words)]

    def _places(self, sets: NDArray[np.uint8]) -> Iterator[tuple[bytes, list[int]]]:
        """Yield sets of columns, packed as bits, as they are and as the places of the columns."""
        there = np.unpackbits(sets, axis=1, count=len(self._columns))
        places, ends = np.nonzero(there)[1].tolist(), np.cumsum(there.sum(axis=1, dtype=np.intp)).tolist()
        data, width = sets.tobytes(), sets.shape[1]
        for number, (start, end) in enumerate(zip([0, *ends], ends, strict=False)):
            yield data[number * width : (number + 1) * width], places[start:end]

    def _asked(self, engine: Engine, row: tuple[int, ...]) -> Answer:
        answer = self._of_rows.get(row)
        if answer is None:
            try:
                answer = engine.diagnose(self.literals(row), self._options)
            except ContradictoryModel as contradiction:
                answer = contradiction
            self._make_room(answer)
            self._of_rows[row] = answer
        return answer

    def _of_set(self, key: bytes, places: list[int]) -> tuple[Answer, Names]:
        """Return what a set of columns comes to; and the minimal conflicts, in names."""
        known = self._of_sets.get(key)
        if known is None:
            masks = [self._columns[place][0] for place in places]
            if self._contained is None:
                masks = sorted(minimal_masks(masks))
            answer: Answer | None
            if masks and not masks[0]:
                answer = self._contradiction(self._columns[places[0]][1])
            else:
                answer = self._product(masks) or self._searched(masks)
            self._make_room(answer)
            known = self._of_sets[key] = answer, tuple([self._names[mask] for mask in masks])
        return known

    def _make_room(self, answer: Answer) -> None:
        """Forget what is remembered, if it would be too much with this answer."""
        count = 0 if isinstance(answer, ContradictoryModel) else len(answer.diagnoses)
        self._diagnoses += count
        many = len(self._of_sets) + len(self._of_rows) >= REMEMBERED
        if many or self._diagnoses > REMEMBERED_DIAGNOSES:
            self._of_sets.clear()
            self._of_rows.clear()
            self._diagnoses = count

    def _product(self, masks: list[int]) -> Answer | None:
        """Return what `_searched` finds, if it is few diagnoses of parts that were all searched before."""
        started = perf_counter()
        found = self._products.of(independent(masks), self._parts)
        if found is None:
            return None
        diagnoses = tuple([Diagnosis(names) for names in found])
        return self._told(diagnoses, perf_counter() - started, count=len(found))

    def _searched(self, masks: list[int]) -> Answer:
        started = perf_counter()
        self._clock.start(self._options.timeout_s)
        options = self._options
        answer = SearchState(MAX_DIAGNOSES if options.limit is None else options.limit, self._clock)
        stopped: StoppedBy | None = None
        try:
            parts = [self._part(tuple(sorted(minimal(group)))) for group in independent(minimal(masks))]
            list_diagnoses(parts, 0, options, answer, COUNTED, self._cost)
        except OutOfTime:
            stopped = "time"
            self._parts.clear()  # their searches were left half way
            self._products.forget()
        except LimitReached:
            stopped = "limit"
        except MinimumTooLarge:
            stopped = "size"
        found = answer.found
        if len(found) > 1 and not answer.rows:
            found.sort(key=by_size)
        rows = listed_as_rows(found) if options.factored and not answer.rows else answer.rows
        names = self.cnf.components
        return self._told(
            tuple([Diagnosis(tuple([names[v - 1] for v in bad])) for bad in found]),
            perf_counter() - started,
            stopped,
            tuple([factors(row, names) for row in rows]),
            answer.count if answer.count is not None else len(found) if stopped is None else None,
        )

    def _part(self, conflicts: tuple[int, ...]) -> IndependentPart:
        """Return the hitting sets of conflicts that share components, as far as they were found before."""
        if self._options.max_size is not None:  # how far they were looked for then depends on the other parts
            return IndependentPart.of(conflicts, self._clock)
        part = self._parts.get(conflicts)
        if part is None:
            if len(self._parts) >= REMEMBERED:
                self._parts.clear()
                self._products.forget()
            part = self._parts[conflicts] = IndependentPart.of(conflicts, self._clock)
        return part

    def _told(
        self,
        diagnoses: tuple[Diagnosis, ...],
        elapsed_s: float,
        stopped: StoppedBy | None = None,
        factored: tuple[tuple[Factor, ...], ...] = (),
        count: int | None = None,
    ) -> DiagnosisResult:
        at_most = min((len(one.bad) for one in diagnoses), default=None)
        in_order = self._options.order == "size"  # so that the first one is the smallest
        at_least = at_most if in_order or stopped is None else None
        if at_most is None and stopped is not None:
            size = self._options.max_size
            at_least = size + 1 if stopped == "size" and size is not None else 0
        result = DiagnosisResult(
            components=self.cnf.components,
            size_at_least=at_least,
            size_at_most=at_most,
            smallest_proved=stopped is None or (at_most is not None and in_order),
            diagnoses=diagnoses,
            complete=stopped is None,
            stopped_by=stopped,
            conflicts=(),
            elapsed_s=elapsed_s,
            factored=factored,
            count=count,
        )
        return rank(result, self.cnf, self._options) if self.cnf.priors else result

    def _contradiction(self, states: int) -> ContradictoryModel:
        """Say that these states of the sensors cannot be, whatever is abnormal."""
        words = [states >> (64 * word) & (1 << 64) - 1 for word in range(self.words)]
        literals = self.literals(words)
        core = [number for literal in literals if (number := self.cnf.literal(literal)) is not None]
        self._clock.start(self._options.timeout_s)
        rules = self._reasons.rules(core)
        return ContradictoryModel(
            tuple(map(str, literals)), tuple(self.cnf.rules[index].text for index in rules)
        )

    def close(self) -> None:
        """Free the solvers."""
        self._reasons.close()
        if self._engine is not None:
            self._engine.close()


def distinct(rows: Codes) -> tuple[Codes, NDArray[np.intp]]:
    """Return the different rows in the order of their bits, and which of them each row is."""
    if rows.shape[1] == 1:  # many times as fast as rows of one word
        found, of = np.unique(rows[:, 0], return_inverse=True)
        return found.reshape(-1, 1), of.reshape(-1)
    found, of = np.unique(rows, axis=0, return_inverse=True)
    return found, of.reshape(-1)
