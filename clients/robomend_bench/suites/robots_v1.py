"""Generated robots of 20-3000 components; `--only` gives their sizes, robomend_bench.generator makes them."""

from __future__ import annotations

import random
from collections.abc import Iterator, Mapping
from dataclasses import replace

from robomend.errors import InputError, OptionRefused
from robomend_bench import contenders
from robomend_bench.exporting import DiagnosisProblem, Exported
from robomend_bench.generator import make_robot, observe
from robomend_bench.rows import prepare_rows, rows_of
from robomend_bench.suite import Ask, Group, Question, Wish
from robomend_client.literals import Literal

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
