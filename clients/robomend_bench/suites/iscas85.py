"""ISCAS-85 circuits with 1-10 seeded faults, inputs and outputs observed: the field's standard benchmark."""

from __future__ import annotations

import random
from collections.abc import Callable, Iterator, Mapping

from robomend.diagnosis.engines import make_engine
from robomend.diagnosis.result import Options
from robomend.errors import InputError
from robomend.model.cnf import HealthCnf
from robomend.model.loading import load_text
from robomend_bench import contenders
from robomend_bench.circuit_faults import Circuit, observe_faulty, read_circuit
from robomend_bench.suite import Ask, Group, Question, Wish
from robomend_client.literals import Literal

CIRCUITS = ("c17", "c432", "c499", "c880", "c1355", "c1908", "c2670", "c3540", "c5315", "c6288", "c7552")
BY_DEFAULT = tuple(name for name in CIRCUITS if name != "c6288")
"""c6288, a multiplier, is hard for everyone: it is run by itself, with `--only c6288`."""


QUESTIONS = 20
"""A circuit: two of each number of faults."""


DRAWS = 2000
"""Observations that are thrown away at most until one has the --size that is wanted."""


class Iscas85:
    """See the module."""

    name = "iscas85"
    summary = "ISCAS-85 circuits, 1-10 seeded faults a question"
    modes: Mapping[str, str] = {
        mode: contenders.MODES[mode] for mode in ("first", "all", "factored", "subset")
    }

    def contenders(self, mode: str) -> tuple[str, ...]:
        """Return the engine and what it is held against in this mode."""
        return {
            "first": ("sat", "rc2-fresh"),
            "all": ("sat", "layered-full"),
            "factored": ("sat", "layered-full"),
            "subset": ("sat", "clingo-domain"),
        }[mode]

    def groups(self, wish: Wish) -> Iterator[Group]:
        """Yield a group a circuit. The questions of a circuit depend on the seed and its name only."""
        for name in wish.only or BY_DEFAULT:
            path = wish.data / "iscas85" / f"{name}.bench"
            if not path.is_file():
                raise InputError(f"no circuit {path}: choose from {', '.join(CIRCUITS)}, or give --data DIR")
            text = path.read_text()
            cnf = load_text(text, name=name, file=str(path), format="bench").cnf
            circuit = read_circuit(text)
            chance = random.Random(f"{wish.seed} {name}")
            low, high = wish.faults
            keep = _of_size(cnf, wish.size)
            questions = []
            for index in range(wish.instances or QUESTIONS):
                faults = low + index % (high - low + 1)
                seen = _draw(circuit, faults, chance, keep)
                questions.append(Question(f"{index:03d}-{faults}f", seen))
            yield Group(name, len(cnf.components), cnf, tuple(questions))

    def prepare(self, contender: str, group: Group, wish: Wish) -> Ask:
        """Return what answers the questions of one circuit."""
        return contenders.prepare(contender, group.model, group, wish)


Observed = tuple[Literal, ...]


def _of_size(cnf: HealthCnf, size: int | None) -> Callable[[Observed], bool]:
    """Return whether the diagnoses of what was seen have this minimum cardinality; None: any will do.

    Faults mask each other, so that five of them often look like one or two.
    """
    if size is None:
        return lambda seen: True
    engine = make_engine("sat", cnf)
    options = Options(minimal="cardinality", limit=1, max_size=size, conflicts=False)

    def keep(seen: Observed) -> bool:
        return [len(diagnosis.bad) for diagnosis in engine.diagnose(seen, options).diagnoses] == [size]

    return keep


def _draw(circuit: Circuit, faults: int, chance: random.Random, keep: Callable[[Observed], bool]) -> Observed:
    for _ in range(DRAWS):
        seen = observe_faulty(circuit, faults, chance)
        if keep(seen):
            return seen
    raise InputError(
        f"{faults} faults hardly ever look like that many: give more --faults, or a lower --size"
    )


SUITE = Iscas85()
