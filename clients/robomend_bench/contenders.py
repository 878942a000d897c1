"""Contenders for questions about one observation of one model: engines by name, and baselines.

sat, asp, maxsat, hs_dag, …  robomend's engines
NAME                         an engine of somebody else, from the entry points "robomend.engines"
NAME:SOLVER                  either with another solver inside, e.g. sat:glucose4
rc2, layered-full, …         see baselines.py
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from itertools import combinations, cycle, islice
from math import fsum
from time import perf_counter
from typing import Any

from robomend.diagnosis.engines import make_engine
from robomend.diagnosis.ranking import log_odds
from robomend.diagnosis.result import DiagnosisResult, Options
from robomend.diagnosis.sat import SatEngine
from robomend.errors import OptionRefused
from robomend.model.cnf import HealthCnf
from robomend_bench.baselines import BASELINES, RC2_OPTIONS
from robomend_bench.suite import EXPLAINED, ONE, Answer, Ask, Group, Question, Wish
from robomend_client.literals import Literal

MODES = {
    "first": "first minimum-cardinality diagnosis, without conflicts, from literals to answer",
    "why": "the same with the conflicts that it rests on, as by default",
    "few": "as why, of an engine that was not prepared: structures are built when they pay",
    "once": "as first, from a model: each question is asked of a new engine, whose set-up counts",
    "cold": "the same from a model's text",
    "cold-why": "as cold, with conflicts",
    "structure": "as once, but a circuit's structure is found and compiled beforehand, which counts, too",
    "all": "all minimum-cardinality diagnoses, each as a row",
    "factored": "all minimum-cardinality diagnoses, factored, with their exact count",
    "subset": "all subset-minimal diagnoses up to --max-size, in order of size",
    "explained": "all minimum-cardinality diagnoses with result objects, conflicts and sentences",
    "conflicts": "all minimal conflicts",
    "probable": "the ten most probable subset-minimal diagnoses, in order of probability",
    "rows": "thousands of rows of the same 20 sensors; the time is that of one row",
    "check": "consistency checks, no two of the same healthy set, after 1000 diagnoses on the same engine",
}

CIRCUIT_MODES = {name: MODES[name] for name in (*ONE, "all", "factored", "subset")}
ROBOT_MODES = {
    name: MODES[name]
    for name in ("explained", "first", "all", "subset", "conflicts", "probable", "rows", "check")
}

RC2 = tuple(RC2_OPTIONS)
"""Those that are held against the engine where one diagnosis is asked for."""


CHECKS = 200
"""Calls of `consistent` in one measurement: one takes some microseconds. No two ask the same set."""

AGED_BY = 1000
"""Diagnoses that the engine has behind it before it is asked to check."""


PREPARED = ("first", "why")
"""Modes of engines that know of many questions to come: what is built for these is not counted."""

PROBABLE = 10
"""Diagnoses in mode "probable"."""


def options_for(mode: str, wish: Wish) -> Options:
    """Return what an engine is asked in a mode."""
    if mode == "probable":
        return Options(limit=PROBABLE, timeout_s=wish.timeout_s, order="probability", conflicts=False)
    return Options(
        minimal="subset" if mode == "subset" else "cardinality",
        max_size=wish.max_size if mode == "subset" else None,
        limit=1 if mode in (*ONE, "conflicts") else None,
        timeout_s=wish.timeout_s,
        conflicts="all" if mode == "conflicts" else mode in EXPLAINED,
        factored=mode == "factored",
    )


def prepare(contender: str, cnf: HealthCnf, group: Group, wish: Wish) -> Ask:
    """Return what answers questions whose payload is observations: literals in, Answer out.

    Raises:
        OptionRefused: the contender does not know this mode.
    """
    if wish.mode == "check":
        return _prepare_check(contender, cnf, group, wish)
    if contender in BASELINES:
        baseline = BASELINES[contender](cnf)
        if wish.mode not in baseline.modes:
            raise OptionRefused(f"{contender} has no mode {wish.mode!r}")
        return lambda question: _count(baseline, question, wish)
    engine = _engine(contender, cnf)
    options = options_for(wish.mode, wish)
    if wish.mode in PREPARED and isinstance(engine, SatEngine) and group.questions:
        engine.prepare(group.questions[0].payload)

    def ask(question: Question) -> Answer:
        return _counted(engine.diagnose(question.payload, options), wish.mode, cnf)

    return ask


def prepare_cold(contender: str, made: Callable[[], HealthCnf], wish: Wish) -> Ask:
    """Return what answers each question from the beginning, with nothing kept.

    Args:
        made: returns the model; what that takes counts.
    """
    if contender in BASELINES and wish.mode not in BASELINES[contender](made()).modes:
        raise OptionRefused(f"{contender} has no mode {wish.mode!r}")
    options = options_for(wish.mode, wish)

    def ask(question: Question) -> Answer:
        cnf = made()
        if contender in BASELINES:
            return _count(BASELINES[contender](cnf), question, wish)
        engine = _engine(contender, cnf)
        try:
            if wish.mode == "structure" and isinstance(engine, SatEngine):
                engine.prepare(question.payload)
            return _counted(engine.diagnose(question.payload, options), wish.mode, cnf)
        finally:
            engine.close()

    return ask


def _engine(contender: str, cnf: HealthCnf) -> Any:
    name, _, solver = contender.partition(":")
    return make_engine(name, cnf, solver=solver or None)


def _counted(result: DiagnosisResult, mode: str, cnf: HealthCnf) -> Answer:
    sizes = [len(diagnosis.bad) for diagnosis in result.diagnoses]
    least = min(sizes, default=None)
    if mode in ONE:
        bounds = f"{result.size_at_least} to {result.size_at_most}"
        note = "" if result.smallest_proved else f"minimum cardinality {bounds} when time ended"
        return Answer((least,), complete=bool(sizes) and result.smallest_proved, shown=least, note=note)
    if mode == "conflicts":
        sizes = [len(conflict.components) for conflict in result.conflicts]
        count = len(sizes)
        return Answer((count, min(sizes, default=None)), complete=result.conflicts_all, shown=count)
    if mode == "probable":
        # Searched is by priors. Which of equally probable ones are listed is free, and how well they fit what
        # was seen to work, which sorts those that were found, differs: so that their priors are compared.
        weights = [log_odds(cnf.priors[name]) for diagnosis in result.diagnoses for name in diagnosis.bad]
        ended = result.complete or result.stopped_by == "limit"
        return Answer((len(sizes), round(1000 * fsum(weights))), complete=ended, shown=len(sizes))
    count = result.count if result.count is not None else len(sizes)
    all_asked_for = result.complete or result.stopped_by == "size"  # larger ones exist, and were not wanted
    return Answer((count, least), complete=all_asked_for, shown=count)


def _count(baseline: Any, question: Question, wish: Wish) -> Answer:
    deadline = perf_counter() + wish.timeout_s
    count, least = 0, None
    for bad in baseline.diagnoses(question.payload, wish.mode, wish.max_size):
        count += 1
        least = len(bad) if least is None else min(least, len(bad))
        if perf_counter() > deadline:
            return Answer((count, least), complete=False)
    if wish.mode in ONE:
        return Answer((least,), complete=count > 0, shown=least)
    return Answer((count, least), complete=True, shown=count)


def _prepare_check(contender: str, cnf: HealthCnf, group: Group, wish: Wish) -> Ask:
    """Age an engine by diagnoses, then time its check of observations that a healthy system would show."""
    if contender in BASELINES:
        raise OptionRefused(f"{contender} has no mode 'check'")
    engine = _engine(contender, cnf)
    options = options_for("all", wish)
    for index in range(AGED_BY):
        engine.diagnose(group.questions[index % len(group.questions)].payload, options)

    asked = {question.name: list(healthy_sets(question.payload)) for question in group.questions}

    def ask(question: Question) -> Answer:
        consistent = True
        for healthy in asked[question.name]:
            consistent &= engine.consistent(healthy)
        return Answer((int(consistent),), complete=True, shown=None, calls=CHECKS)

    return ask


def healthy_sets(seen: Sequence[Literal]) -> Iterator[list[Literal]]:
    """Yield sets that a healthy system would show, each without two other literals, so that none comes twice.

    They are what was seen, less what clashes: nearly as many literals as a robot reports.
    """
    healthy = [literal for literal in seen if literal.positive]
    pairs = list(islice(combinations(range(len(healthy)), 2), CHECKS)) or [(0, 0)]
    for one, other in islice(cycle(pairs), CHECKS):
        yield [*healthy[:one], *healthy[one + 1 : other], *healthy[other + 1 :]]
