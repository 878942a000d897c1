"""ISCAS-85 circuits with seeded faults, inputs and outputs observed: the field's standard benchmark."""

from __future__ import annotations

import random
from collections.abc import Iterator, Mapping
from dataclasses import replace
from itertools import cycle, islice
from pathlib import Path

from robomend.diagnosis.engines import make_engine
from robomend.diagnosis.result import Engine, Options
from robomend.errors import InputError
from robomend.model.cnf import HealthCnf
from robomend.model.loading import load_text
from robomend_bench import contenders
from robomend_bench.baselines import RC2_OPTIONS
from robomend_bench.exporting import DiagnosisProblem, Exported
from robomend_bench.generator import observe_faulty, read_circuit
from robomend_bench.suite import ONE, Ask, Group, Question, Wish
from robomend_client.literals import Literal

# --- observations of faulty circuits: any, or equally many of each minimum cardinality.
#
# Injected faults mask each other: of ten random ones mostly one or two are to be seen. So observations are
# drawn with few and with many faults and sorted by their minimum cardinality. That is what the engine says;
# when all contenders have answered, their answers are compared.

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


CIRCUITS = ("c17", "c432", "c499", "c880", "c1355", "c1908", "c2670", "c3540", "c5315", "c6288", "c7552")
BY_DEFAULT = tuple(name for name in CIRCUITS if name != "c6288")
"""c6288, a multiplier, is hard for everyone: it is run by itself, with `--only c6288`."""

SIZES = (1, 20)
"""Minimum cardinalities of questions for one diagnosis, equally many of each: injected faults mask each
other, so that most observations of random faults need one or two gates only."""


COLD = ("cold", "cold-why")


class Circuits:
    """Circuits in .bench form, from a folder of `--data` that has the suite's name, or otherwise (`text`)."""

    version = "1"
    modes: Mapping[str, str] = contenders.CIRCUIT_MODES

    def __init__(
        self,
        name: str,
        summary: str,
        circuits: tuple[str, ...],
        by_default: tuple[str, ...],
        sizes: tuple[int, int] | None,
        source: str = "",
    ) -> None:
        """Make a suite.

        Args:
            by_default: the circuits that run when none is named.
            sizes: minimum cardinalities of questions for one diagnosis, equally many of each; None: any.
            source: where circuits that do not come with the package can be had.
        """
        self.name, self.summary = name, summary
        self._circuits, self._by_default, self._sizes = circuits, by_default, sizes
        self._source = source

    def contenders(self, mode: str) -> tuple[str, ...]:
        """Return the engine and what it is held against in this mode."""
        if mode == "structure":
            return ("sat",)
        if mode in ONE:
            return ("sat", *RC2_OPTIONS)
        return ("sat", "clingo-domain" if mode == "subset" else "layered-full")

    def groups(self, wish: Wish) -> Iterator[Group]:
        """Yield a group a circuit. The questions of a circuit depend on the seed and its name only."""
        for name in wish.only or self._by_default:
            text = self.text(name, wish)
            cnf = compiled(text, name)
            sizes = wish.sizes or (self._sizes if wish.mode in ONE else None)
            wanted = None if sizes == "any" else sizes
            questions = questions_about(text, cnf, f"{wish.seed} {name}", wanted, wish)
            yield Group(name, len(cnf.components), text if wish.mode in COLD else cnf, questions)

    def text(self, name: str, wish: Wish) -> str:
        """Return a circuit in .bench form.

        Raises:
            InputError: there is none of this name.
        """
        path = self.circuit_file(name, wish)
        if not path.is_file():
            known = f"choose from {', '.join(self._circuits)}, or give --data DIR"
            raise InputError(f"no circuit {path}: {known}{self._source}")
        return path.read_text()

    def circuit_file(self, name: str, wish: Wish) -> Path:
        """Return where a circuit is."""
        return wish.data / self.name / f"{name}.bench"

    def prepare(self, contender: str, group: Group, wish: Wish) -> Ask:
        """Return what answers the questions of one circuit."""
        if wish.mode in COLD:
            return contenders.prepare_cold(contender, lambda: compiled(group.model, group.name), wish)
        if wish.mode in ("once", "structure"):
            return contenders.prepare_cold(contender, lambda: _uncached(group.model), wish)
        return contenders.prepare(contender, group.model, group, wish)

    def exported(self, question: Question, group: Group) -> Exported:
        """Return the observation of the circuit."""
        cold = isinstance(group.model, str)
        cnf = compiled(group.model, group.name) if cold else group.model
        return DiagnosisProblem(cnf, [question.payload])


def compiled(text: str, name: str) -> HealthCnf:
    """Return the clauses of a circuit."""
    return load_text(text, name=name, file=f"{name}.bench", format="bench").cnf


def _uncached(cnf: HealthCnf) -> HealthCnf:
    """Return the model without what an earlier question left in it."""
    return replace(cnf)


SUITE = Circuits("iscas85", "ISCAS-85 circuits, seeded faults", CIRCUITS, BY_DEFAULT, SIZES)
