"""What to look at next, when several diagnoses remain.

Each diagnosis Δ predicts values: an atom is true under Δ when SD ∪ OBS ∪ {¬AB(c) | c ∉ Δ} ∪ {AB(c) | c ∈ Δ}
entails it, false when it entails the negation, and open otherwise. A probe is worth the information that
its outcome is expected to give about which diagnosis is right, per second that it takes:

    gain(x) = H(outcome of x) - P(diagnoses that leave x open) · 1 bit

A diagnosis that leaves x open expects either value with probability ½. For a batch of probes the outcomes
split the diagnoses into cells, and the next probe is the one that tells most within the cells (greedy; the
information is submodular, so that the batch has at least 1 - 1/e of the best one's).

The predictions come from one persistent solver: unit propagation settles nearly all of them, and for the
rest each model found clears all atoms that it shows with their other value.

Sources:
    J. de Kleer, B. Williams. Diagnosing multiple faults. AIJ 32(1), 1987 (one-step lookahead).
    A. Krause, C. Guestrin. Near-optimal nonmyopic value of information. UAI 2005 (greedy batches).
    J. Marques-Silva, M. Janota, I. Lynce. On computing backbones of propositional theories. ECAI 2010.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import islice
from math import fsum, log2
from typing import Literal as OneOf

from robomend.diagnosis.observed import ObservationReader
from robomend.diagnosis.oracle import Deadline, Oracle, OutOfTime
from robomend.diagnosis.result import DiagnosisResult
from robomend.errors import OptionRefused
from robomend.model.cnf import HealthCnf
from robomend_client.literals import Atom, Literal

Value = OneOf[-1, 0, 1]
"""What a diagnosis predicts at a point: true, false, or -1, nothing."""

NEGLIGIBLE_BITS = 1e-9
"""Below this a gain is rounding, not information."""

MAX_BATCH = 8
"""Of probes at once: the outcomes of a batch may double with each."""

BATCH_POINTS = 64
"""A batch is chosen among so many of the best single probes."""


@dataclass(frozen=True, slots=True)
class Probe:
    """One observation that could be made, and what it would tell, by index into the diagnoses considered."""

    atom: Atom
    gain_bits: float
    cost_s: float
    if_true: tuple[int, ...]  # the diagnoses that predict true …
    if_false: tuple[int, ...]  # … and false; the others allow both

    @property
    def gain_per_s(self) -> float:
        """By this they are ordered."""
        return self.gain_bits / self.cost_s


@dataclass(frozen=True, slots=True)
class ProbeResult:
    """The probes that discriminate, best first; without any, why there is none."""

    diagnoses: tuple[tuple[str, ...], ...]  # those considered, the leading ones
    probes: tuple[Probe, ...]
    batch: tuple[Probe, ...]  # to be made together; gain_bits is what each adds to those before it
    batch_gain_bits: float
    entropy_bits: float  # how uncertain we are now; no probe can tell more
    complete: bool  # every observable and every diagnosis found was considered
    reason: str | None = None  # why no probe can discriminate


def information(weights: Sequence[float], column: Sequence[Value]) -> float:
    """Return the information that a measurement is expected to give, in bits, times the sum of the weights.

    Args:
        weights: P(diagnosis | OBS) of each diagnosis, or of its share of a cell.
        column: what each diagnosis predicts there; one that predicts nothing counts half for each value.
    """
    true = fsum(weight for weight, value in zip(weights, column, strict=True) if value == 1)
    false = fsum(weight for weight, value in zip(weights, column, strict=True) if value == 0)
    total = fsum(weights)
    is_open = total - true - false
    if not total:
        return 0.0
    outcome = _entropy((true + is_open / 2) / total) + _entropy((false + is_open / 2) / total)
    return max(0.0, total * outcome - is_open)


def _entropy(share: float) -> float:
    return -share * log2(share) if share > 0 else 0.0


class Prober:
    """Finds probes for one model; keeps a warm solver. One call at a time."""

    def __init__(self, cnf: HealthCnf) -> None:
        self.cnf = cnf
        self._clock = Deadline()
        self._oracle = Oracle(cnf.clauses, self._clock)
        self._reader = ObservationReader(cnf)

    def probes(
        self,
        observations: Iterable[Literal],
        result: DiagnosisResult,
        *,
        points: Collection[Atom] | None = None,
        costs: Mapping[Atom, float] | None = None,
        batch: int = 1,
        limit: int = 10,
        max_diagnoses: int = 32,
        max_points: int = 2000,
        timeout_s: float | None = 2.0,
    ) -> ProbeResult:
        """Return the next observations to make.

        Args:
            observations: OBS, from which `result` was made.
            result: its leading diagnoses are told apart; without priors each counts the same.
            points: the atoms that can be observed, those in OBS left out; every atom of the model if None.
            costs: seconds a measurement takes; those of the model if None, and 1 where nothing is said.
            batch: how many to choose to be made together, at most MAX_BATCH.
            limit: how many single probes to list.
            max_diagnoses, max_points, timeout_s: bounds; `complete` is False when one of them was felt.

        Raises:
            OptionRefused: a bound that means nothing, or a cost that is not positive.
        """
        _check_bounds(batch, limit, max_diagnoses, max_points, timeout_s)
        considered = tuple(diagnosis.bad for diagnosis in result.diagnoses[:max_diagnoses])
        weights = _weights(result, len(considered))
        entropy = fsum(map(_entropy, weights))
        reason = _nothing_to_tell(result)
        if reason is not None:
            return ProbeResult(considered, (), (), 0.0, entropy, result.complete, reason)
        observed = self._reader.read(observations)
        seen = {abs(number) for number in observed.numbers}
        variables = {
            variable: atom
            for atom, variable in self.cnf.atom_variable.items()
            if variable not in seen and (points is None or atom in points)
        }
        whole = len(considered) == len(result.diagnoses) and len(variables) <= max_points
        variables = dict(islice(variables.items(), max_points))
        self._clock.start(timeout_s)
        rows: list[dict[int, Value]] = []
        try:
            for bad in considered:
                rows.append(self._predictions(observed.numbers, bad, variables))
        except OutOfTime:
            whole = False
            considered, weights = considered[: len(rows)], _normalised(weights[: len(rows)])
        cost_of = self.cnf.costs if costs is None else costs
        found = []
        for variable, atom in variables.items():
            column = [row[variable] for row in rows]
            gain = information(weights, column)
            if gain > NEGLIGIBLE_BITS:
                found.append((_probe(atom, gain, _cost(atom, cost_of), column), column))
        found.sort(key=lambda pair: -pair[0].gain_per_s)
        together = _greedy_batch(found[:BATCH_POINTS], weights, batch)
        return ProbeResult(
            diagnoses=considered,
            probes=tuple(probe for probe, _ in found[:limit]),
            batch=together,
            batch_gain_bits=fsum(probe.gain_bits for probe in together),
            entropy_bits=entropy,
            complete=whole and result.complete,
            reason=None if found else _none_discriminates(len(considered), bool(variables), whole),
        )

    def _predictions(
        self, observed: Sequence[int], bad: Collection[str], variables: Collection[int]
    ) -> dict[int, Value]:
        """Return what a diagnosis predicts of each variable: the backbone of SD ∪ OBS ∪ Δ."""
        oracle = self._oracle
        blamed = set(bad)
        assumptions = [
            -variable if component in blamed else variable for component, variable in self.cnf.health.items()
        ]
        assumptions += observed
        self._clock.check()
        predicted: dict[int, Value] = dict.fromkeys(variables, -1)
        consistent, implied = oracle.propagate(assumptions)
        if not consistent:
            return predicted  # OBS is not that of the result: nothing can be said
        for literal in implied:
            if abs(literal) in predicted:
                predicted[abs(literal)] = 1 if literal > 0 else 0
        undecided = [variable for variable, value in predicted.items() if value == -1]
        if not undecided or not oracle.sat(assumptions):
            return predicted
        model = oracle.model()
        known = len(model)  # a variable that no clause mentions has no place in the model, and is open
        candidates = {variable: model[variable - 1] > 0 for variable in undecided if variable <= known}
        while candidates:
            variable, value = next(iter(candidates.items()))
            if oracle.sat([*assumptions, -variable if value else variable]):
                model = oracle.model()
                candidates = {v: sign for v, sign in candidates.items() if (model[v - 1] > 0) == sign}
            else:
                predicted[variable] = 1 if value else 0
                del candidates[variable]
        return predicted

    def interrupt(self) -> None:
        """Make a running call stop soon with what it has; from any thread."""
        self._clock.stop()

    def close(self) -> None:
        """Free the solver."""
        self._oracle.close()


def _check_bounds(batch: int, limit: int, diagnoses: int, points: int, timeout_s: float | None) -> None:
    if not 1 <= batch <= MAX_BATCH:
        raise OptionRefused(f"a batch of {batch} probes: choose 1 to {MAX_BATCH}")
    for name, value in (("limit", limit), ("max_diagnoses", diagnoses), ("max_points", points)):
        if value < 1:
            raise OptionRefused(f"{name} is {value}: give 1 or more")
    if timeout_s is not None and not timeout_s >= 0:
        raise OptionRefused(f"timeout_s is {timeout_s}: give 0 or more, or none")


def _weights(result: DiagnosisResult, count: int) -> list[float]:
    shares = [diagnosis.probability for diagnosis in result.diagnoses[:count]]
    known = [share for share in shares if share is not None]
    return _normalised(known if len(known) == count and fsum(known) > 0 else [1.0] * count)


def _normalised(weights: Sequence[float]) -> list[float]:
    total = fsum(weights)
    return [weight / total for weight in weights] if total else []


def _nothing_to_tell(result: DiagnosisResult) -> str | None:
    if result.healthy:
        return "nothing is wrong, so there is nothing to tell apart"
    if len(result.diagnoses) > 1:
        return None
    if result.stopped_by is not None:
        count = "one diagnosis" if result.diagnoses else "no diagnosis"
        return f"only {count} was found before the search was stopped by {result.stopped_by}: let it go on"
    return (
        "there is one diagnosis, and nothing to tell it from" if result.diagnoses else "there is no diagnosis"
    )


def _none_discriminates(diagnoses: int, points: bool, whole: bool) -> str:
    if not points:
        return "everything that can be observed is observed already"
    if not whole:
        return "none was found within the bounds: give more time, or more points and diagnoses"
    return f"the {diagnoses} diagnoses predict the same for everything that can still be observed"


def _cost(atom: Atom, costs: Mapping[Atom, float]) -> float:
    cost = costs.get(atom, 1.0)
    if not cost > 0:
        raise OptionRefused(f"observing {atom} costs {cost} s: give a cost above 0")
    return cost


def _probe(atom: Atom, gain: float, cost: float, column: Sequence[Value]) -> Probe:
    return Probe(
        atom=atom,
        gain_bits=gain,
        cost_s=cost,
        if_true=tuple(index for index, value in enumerate(column) if value == 1),
        if_false=tuple(index for index, value in enumerate(column) if value == 0),
    )


def _greedy_batch(
    found: Sequence[tuple[Probe, Sequence[Value]]], weights: Sequence[float], size: int
) -> tuple[Probe, ...]:
    """Choose probes one by one; each by what it tells within the cells that those before it leave."""
    cells = [list(weights)]  # of outcomes so far: how likely each diagnosis is *and* this outcome
    chosen: list[Probe] = []
    left = list(found)
    while left and len(chosen) < size:
        gains = [fsum(information(cell, column) for cell in cells) for _, column in left]
        best = max(range(len(left)), key=lambda index: gains[index] / left[index][0].cost_s)
        if gains[best] <= NEGLIGIBLE_BITS:
            break
        probe, column = left.pop(best)
        chosen.append(Probe(probe.atom, gains[best], probe.cost_s, probe.if_true, probe.if_false))
        cells = [
            half
            for cell in cells
            for value in (0, 1)
            if fsum(half := [_share(w, predicted, value) for w, predicted in zip(cell, column, strict=True)])
            > NEGLIGIBLE_BITS
        ]
    return tuple(chosen)


def _share(weight: float, predicted: Value, outcome: int) -> float:
    """Return how much of a diagnosis's weight goes with this outcome."""
    if predicted == -1:
        return weight / 2
    return weight if predicted == outcome else 0.0
