"""Observations of faulty circuits: any, or equally many of each minimum cardinality.

Injected faults mask each other: of ten random ones mostly one or two are to be seen. So observations are
drawn with few and with many faults and sorted by their minimum cardinality. That is what the engine says;
when all contenders have answered, their answers are compared.
"""

from __future__ import annotations

import random
from collections.abc import Iterator
from itertools import cycle, islice

from robomend.diagnosis.engines import make_engine
from robomend.diagnosis.result import Engine, Options
from robomend.errors import InputError
from robomend.model.cnf import HealthCnf
from robomend_bench.circuit_faults import observe_faulty, read_circuit
from robomend_bench.suite import Question, Wish
from robomend_client.literals import Literal

QUESTIONS = 20
"""A circuit, where any observation will do: two of each number of faults."""

EACH = 2
"""Questions of each minimum cardinality."""

FAULTS = (1, 10)

FAULTS_A_SIZE = 5
"""So many are injected for each gate of the largest minimum cardinality, at most."""

DRAWS = 4_000

IN_VAIN = 400
"""Observations that are drawn one after the other without one that is wanted: a circuit with seven outputs
has none of minimum cardinality eight."""

KNOWN_WITHIN_S = 20.0
"""An observation whose minimum cardinality the engine does not know by then is left out."""

Observed = tuple[Literal, ...]


def questions_about(
    text: str, cnf: HealthCnf, seed: str, sizes: tuple[int, int] | None, wish: Wish
) -> tuple[Question, ...]:
    """Return the questions of one circuit, the same for the same seed.

    Args:
        text: the circuit in .bench form.
        cnf: its clauses.
        sizes: the least and the largest minimum cardinality; None: any.

    Raises:
        InputError: no observation has such a minimum cardinality.
    """
    circuit, chance = read_circuit(text), random.Random(seed)

    def drawn(low: int, high: int) -> Iterator[tuple[int, Observed]]:
        for faults in cycle(range(low, high + 1)):
            yield faults, observe_faulty(circuit, faults, chance)

    if sizes is None:
        some = islice(drawn(*(wish.faults or FAULTS)), wish.instances or QUESTIONS)
        return tuple(Question(f"{index:03d}-{faults}f", seen) for index, (faults, seen) in enumerate(some))
    least, largest = sizes
    each = EACH if wish.instances is None else max(1, wish.instances // (largest - least + 1))
    found: dict[int, list[Observed]] = {size: [] for size in range(least, largest + 1)}
    in_vain = 0
    engine = make_engine("sat", cnf)
    for _, seen in islice(drawn(*(wish.faults or (least, FAULTS_A_SIZE * largest))), DRAWS):
        same = found.get(_minimum_cardinality(engine, seen, largest))
        if same is not None and len(same) < each:
            same.append(seen)
            in_vain = 0
        else:
            in_vain += 1
        if in_vain > IN_VAIN or all(len(some) == each for some in found.values()):
            break
    engine.close()
    questions = tuple(
        Question(f"{size:02d}-{index}", seen)
        for size, some_seen in found.items()
        for index, seen in enumerate(some_seen)
    )
    if not questions:
        raise InputError("faults hardly ever look like that many: give more --faults, or a lower --size")
    return questions


def _minimum_cardinality(engine: Engine, seen: Observed, largest: int) -> int:
    """Return it, or -1 where it is larger than the largest, or not known in time."""
    asked = Options(
        minimal="cardinality", limit=1, max_size=largest, timeout_s=KNOWN_WITHIN_S, conflicts=False
    )
    result = engine.diagnose(seen, asked)
    return len(result.diagnoses[0].bad) if result.diagnoses and result.smallest_proved else -1
