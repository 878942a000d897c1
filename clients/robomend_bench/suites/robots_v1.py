"""Generated robots of 20-3000 components; `--only` gives their sizes, robomend_bench.generator makes them."""

from __future__ import annotations

import random
from collections import Counter
from collections.abc import Iterator, Mapping
from dataclasses import replace
from importlib.util import find_spec

from robomend.diagnosis.engines import make_engine
from robomend.diagnosis.result import DiagnosisResult, Options
from robomend.errors import ContradictoryModel, InputError, OptionRefused
from robomend.model.cnf import HealthCnf
from robomend_bench import contenders
from robomend_bench.exporting import DiagnosisProblem, Exported
from robomend_bench.generator import Robot, make_robot, observe
from robomend_bench.suite import Answer, Ask, Group, Question, Wish
from robomend_client.literals import Atom, Literal

SIZES = ("20", "100", "300", "1000")
GROWTH = ("100", "300", "1000", "3000")
MOST_FAULTS = 4

PRIORS = (0.001, 0.002, 0.005, 0.01, 0.02, 0.05)
"""In mode "probable" each component has one of these."""


class RobotsV1:
    """See the module."""

    name = "robots-v1"
    version = "1"
    summary = "generated robot models of 20-3000 components, 1-4 broken at once"
    modes: Mapping[str, str] = contenders.ROBOT_MODES

    def contenders(self, mode: str) -> tuple[str, ...]:
        """Return the engine, and Reiter's algorithm beside it, or those that weigh."""
        others = {
            "check": ("sat",),
            "conflicts": ("sat", "marco", "optux"),
            "rows": ("library", "sat"),
            "probable": ("sat", "cda_star", "maxsat"),
        }
        return others.get(mode, ("sat", "hs_dag"))

    def groups(self, wish: Wish) -> Iterator[Group]:
        """Yield a group a size: one robot, many observations; mode first adds 3000 components for growth."""
        for size in wish.only or (GROWTH if wish.mode == "first" else SIZES):
            if not size.isdecimal() or not 3 <= int(size) <= 100_000:
                raise InputError(f"--only {size}: give numbers of components, 3 to 100000")
            robot = make_robot(int(size), wish.seed)
            if wish.mode == "rows":
                names = [f"{index:03d}" for index in range(wish.instances or 20)]
                rows = [Question(name, rows_of(robot, f"{wish.seed} {size} {name}")) for name in names]
                yield Group(size, int(size), robot.cnf, tuple(rows))
                continue
            chance = random.Random(f"{wish.seed} {size}")
            least, most = wish.faults or (1, MOST_FAULTS)
            low, high = least, min(most, MOST_FAULTS)
            questions = tuple(
                Question(f"{index:03d}", observe(robot, chance.randint(min(low, high), high), chance))
                for index in range(wish.instances or 20)
            )
            cnf = robot.cnf
            if wish.mode == "probable":
                drawn = random.Random(f"priors {wish.seed} {size}")
                priors = {component: drawn.choice(PRIORS) for component in cnf.components}
                cnf = replace(cnf, priors=priors)
            yield Group(size, int(size), cnf, questions)

    def prepare(self, contender: str, group: Group, wish: Wish) -> Ask:
        """Return what answers the questions of one robot."""
        if wish.mode == "rows":
            return prepare_rows(contender, group.model, wish)
        return contenders.prepare(contender, group.model, group, wish)

    def exported(self, question: Question, group: Group) -> Exported:
        """Return what was seen of the robot."""
        if question.payload and not isinstance(question.payload[0], Literal):
            raise OptionRefused("rows are no question for other solvers: export another mode")
        return DiagnosisProblem(group.model, [question.payload])


SUITE = RobotsV1()


# --- rows of the same sensors, as a log has them: the library over conflicts, or an engine asked row by row.
#
# What is seen follows from one to four broken components, then each sensor is silent for a while with some
# chance, so that its state is unknown. Rows that are alike are asked of an engine once.

SENSORS = 20

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
