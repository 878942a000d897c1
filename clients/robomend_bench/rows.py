"""Rows of the same sensors, as a log has them: the library over conflicts beside an engine asked row by row.

What is seen follows from one to four broken components, then each sensor is silent for a while with some
chance, so that its state is unknown. Rows that are alike are asked of an engine once.
"""

from __future__ import annotations

import random
from collections import Counter
from importlib.util import find_spec

from robomend.diagnosis.engines import make_engine
from robomend.diagnosis.result import DiagnosisResult, Options
from robomend.errors import ContradictoryModel, OptionRefused
from robomend.model.cnf import HealthCnf
from robomend_bench.generator import Robot, observe
from robomend_bench.suite import Answer, Ask, Question, Wish
from robomend_client.literals import Atom, Literal

SENSORS = 20
MOST_FAULTS = 4

ROWS = 2_000
"""In one question."""

Rows = tuple[tuple[Literal, ...], ...]


def sensors_of(cnf: HealthCnf) -> tuple[Atom, ...]:
    """Return the first topics of a robot."""
    return tuple(atom for atom in cnf.atoms if atom.predicate == "ok")[:SENSORS]


def rows_of(robot: Robot, seed: str) -> Rows:
    """Return what these topics show when something is broken."""
    chance, sensors = random.Random(seed), frozenset(sensors_of(robot.cnf))
    return tuple(
        tuple(one for one in observe(robot, chance.randint(1, MOST_FAULTS), chance) if one.atom in sensors)
        for _ in range(ROWS)
    )


def prepare_rows(contender: str, cnf: HealthCnf, wish: Wish) -> Ask:
    """Return what answers all rows of a question: `library`, made anew for each, or an engine.

    Raises:
        OptionRefused: numpy is not there.
    """
    options = Options(conflicts=False, timeout_s=wish.timeout_s)
    if contender == "library":
        if find_spec("numpy") is None:
            raise OptionRefused("library needs numpy: pip install 'robomend[batch]'")
        return lambda question: _by_library(cnf, question, options)
    name, _, solver = contender.partition(":")
    engine = make_engine(name, cnf, solver=solver or None)

    def ask(question: Question) -> Answer:
        found = 0
        for row, times in Counter(question.payload).items():
            try:
                found += times * len(engine.diagnose(row, options).diagnoses)
            except ContradictoryModel:
                continue
        return Answer((found,), complete=True, calls=len(question.payload))

    return ask


def _by_library(cnf: HealthCnf, question: Question, options: Options) -> Answer:
    import numpy as np

    from robomend.diagnosis.library import Library

    rows: Rows = question.payload
    sensors = sensors_of(cnf)
    place = {atom: index for index, atom in enumerate(sensors)}
    seen = np.zeros((2, len(rows), len(sensors)), dtype=np.bool_)
    for index, row in enumerate(rows):
        for literal in row:
            seen[0 if literal.positive else 1, index, place[literal.atom]] = True
    library = Library(cnf, sensors, options)
    answers = library.diagnose(library.codes(seen[0], seen[1]))
    library.close()
    counts = np.array(
        [len(one.diagnoses) if isinstance(one, DiagnosisResult) else 0 for one in answers.distinct]
    )
    return Answer((int(counts[answers.index].sum()),), complete=True, calls=len(rows))
