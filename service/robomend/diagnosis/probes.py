"""What to look at next, when several diagnoses remain.

Each diagnosis Δ predicts values: an atom is true under Δ when SD ∪ OBS ∪ {¬AB(c) | c ∉ Δ} ∪ {AB(c) | c ∈ Δ}
entails it, false when it entails the negation, and open otherwise. A probe is worth the information that
its outcome is expected to give about which diagnosis is right, per second that it takes:

    gain(x) = H(outcome of x) - P(diagnoses that leave x open) · 1 bit

A diagnosis that leaves x open expects either value with probability ½.

The predictions come from one persistent solver: unit propagation settles nearly all of them, and for the
rest each model found clears all atoms that it shows with their other value.

Sources:
    J. de Kleer, B. Williams. Diagnosing multiple faults. AIJ 32(1), 1987 (one-step lookahead).
    J. Marques-Silva, M. Janota, I. Lynce. On computing backbones of propositional theories. ECAI 2010.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Sequence
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

MAX_DIAGNOSES = 32
MAX_POINTS = 2_000
"""That are considered; `complete` says whether there were more."""


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
    entropy_bits: float  # how uncertain we are now; no probe can tell more
    complete: bool  # every observable and every diagnosis found was considered
    reason: str | None = None  # why no probe can discriminate


def information(weights: Sequence[float], column: Sequence[Value]) -> float:
    """Return the information that a measurement is expected to give, in bits.

    Args:
        weights: P(diagnosis | OBS) of each diagnosis.
        column: what each diagnosis predicts there; one that predicts nothing counts half for each value.
    """
    true = fsum(weight for weight, value in zip(weights, column, strict=True) if value == 1)
    false = fsum(weight for weight, value in zip(weights, column, strict=True) if value == 0)
    is_open = max(0.0, 1 - true - false)
    return max(0.0, _entropy(true + is_open / 2) + _entropy(false + is_open / 2) - is_open)


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
        limit: int = 10,
        timeout_s: float | None = 2.0,
    ) -> ProbeResult:
        """Return the next observations to make.

        Args:
            observations: OBS, from which `result` was made.
            result: its leading diagnoses are told apart; without priors each counts the same.
            limit: how many to list.
            timeout_s: `complete` is False when it was felt.

        Raises:
            OptionRefused: a bound that means nothing, or a cost that is not positive.
        """
        if limit < 1:
            raise OptionRefused(f"limit is {limit}: give 1 or more")
        if timeout_s is not None and not timeout_s >= 0:
            raise OptionRefused(f"timeout_s is {timeout_s}: give 0 or more, or none")
        considered = tuple(diagnosis.bad for diagnosis in result.diagnoses[:MAX_DIAGNOSES])
        weights = _weights(result, len(considered))
        entropy = fsum(map(_entropy, weights))
        reason = _nothing_to_tell(result)
        if reason is not None:
            return ProbeResult(considered, (), entropy, result.complete, reason)
        observed = self._reader.read(observations)
        seen = {abs(number) for number in observed.numbers}
        variables = {
            variable: atom for atom, variable in self.cnf.atom_variable.items() if variable not in seen
        }
        whole = len(considered) == len(result.diagnoses) and len(variables) <= MAX_POINTS
        variables = dict(islice(variables.items(), MAX_POINTS))
        self._clock.start(timeout_s)
        rows: list[dict[int, Value]] = []
        try:
            for bad in considered:
                rows.append(self._predictions(observed.numbers, bad, variables))
        except OutOfTime:
            whole = False
            considered, weights = considered[: len(rows)], _normalised(weights[: len(rows)])
        found = []
        for variable, atom in variables.items():
            column = [row[variable] for row in rows]
            gain = information(weights, column)
            if gain > NEGLIGIBLE_BITS:
                found.append(_probe(atom, gain, self.cnf.costs.get(atom, 1.0), column))
        found.sort(key=lambda probe: -probe.gain_per_s)
        return ProbeResult(
            diagnoses=considered,
            probes=tuple(found[:limit]),
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


def _probe(atom: Atom, gain: float, cost: float, column: Sequence[Value]) -> Probe:
    return Probe(
        atom=atom,
        gain_bits=gain,
        cost_s=cost,
        if_true=tuple(index for index, value in enumerate(column) if value == 1),
        if_false=tuple(index for index, value in enumerate(column) if value == 0),
    )
