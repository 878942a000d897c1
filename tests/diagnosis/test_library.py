"""The library over fixed sensors says of each row what an engine says of it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from itertools import count
from random import Random

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from tests.diagnosis.systems import ATOMS, model, systems
from tests.examples import examples

from robomend.diagnosis.engines import make_engine
from robomend.diagnosis.library import Library
from robomend.diagnosis.oracle import Deadline, OutOfTime
from robomend.diagnosis.result import DiagnosisResult, Minimal, Options
from robomend.errors import ContradictoryModel, OptionRefused
from robomend.model.cnf import HealthCnf
from robomend.model.loading import load_model, load_text
from robomend.resources import resource
from robomend_bench.odd_models import random_triples
from robomend_client.literals import Atom, Literal, holds

TEDUSAR = load_model(resource("examples", "tedusar.yaml")).cnf
MANIPULATOR = load_model(resource("examples", "mobile_manipulator.yaml")).cnf
PLAIN = Options(conflicts=False, timeout_s=None)

options = st.builds(
    Options,
    minimal=st.sampled_from(["subset", "cardinality"]),
    max_size=st.sampled_from([None, 0, 1, 2]),
    limit=st.sampled_from([None, 1, 2, 100]),
    timeout_s=st.none(),
    conflicts=st.just(False),
)


def by_engine(cnf: HealthCnf, row: list[Literal], asked: Options) -> DiagnosisResult | ContradictoryModel:
    engine = make_engine("sat", cnf)
    try:
        return engine.diagnose(row, asked)
    except ContradictoryModel as contradiction:
        return contradiction
    finally:
        engine.close()


def agree(library: Library, rows: list[list[Literal]], asked: Options) -> None:
    """Ask for all rows at once, and an engine for each."""
    answers = library.diagnose(np.concatenate([library.code(row) for row in rows]))
    assert len(answers) == len(rows)
    for number, row in enumerate(rows):
        found, expected = answers[number], by_engine(library.cnf, row, asked)
        if isinstance(expected, ContradictoryModel) or isinstance(found, ContradictoryModel):
            assert type(found) is type(expected)
            continue
        if asked.limit != 1:  # then it may be known by chance that there is no other
            assert (found.complete, found.stopped_by) == (expected.complete, expected.stopped_by)
            assert found.count == expected.count
        sizes = [[len(diagnosis.bad) for diagnosis in one.diagnoses] for one in (found, expected)]
        assert sizes[0] == sizes[1]
        if expected.complete and found.complete:
            assert found.diagnoses == expected.diagnoses


@st.composite
def rows_of(draw: st.DrawFn, atoms: tuple[Atom, ...]) -> list[list[Literal]]:
    """Draw some rows in which each atom was seen to hold, to fail, or not at all."""
    state = st.sampled_from([True, False, None])
    rows = draw(st.lists(st.tuples(*[state] * len(atoms)), min_size=1, max_size=5))
    return [
        [Literal(atom, seen) for atom, seen in zip(atoms, row, strict=True) if seen is not None]
        for row in rows
    ]


def result(library: Library, *row: Literal) -> DiagnosisResult:
    """Return the answer of one row that does not contradict the model."""
    answer = library.diagnose(library.code(row))[0]
    assert isinstance(answer, DiagnosisResult)
    return answer


def test_a_rows_grounds_are_what_its_minimal_conflicts_rest_on() -> None:
    cnf = load_text(
        "robomend: 1\nhardware: {lidar: {channel: 1}}\n"
        "nodes: {driver: {drives: [lidar], publishes: {scan: []}}, mapping: {publishes: {map: [scan]}}}\n"
    ).cnf
    scan, map_, runs = holds("ok", "scan"), holds("ok", "map"), holds("running", "driver")
    library = Library(cnf, [literal.atom for literal in (scan, map_, runs)], PLAIN)

    def grounds(*row: Literal) -> set[Literal]:
        [code] = library.grounds(library.code(row)).tolist()
        return set(library.literals(code))

    assert grounds(scan, map_, runs) == set()
    assert grounds(-scan, map_, runs) == {-scan}
    assert grounds(-scan, -map_, -runs) == {-runs}  # that the driver is to blame needs nothing else
    assert grounds(scan, -map_, -runs) == {scan, -map_, -runs}
    together = library.grounds(np.concatenate([library.code([scan]), library.code([-scan])]))
    assert [set(library.literals(code)) for code in together.tolist()] == [set(), {-scan}]
    library.close()


@examples(150)
@given(systems(), options, st.data())
def test_random_systems_are_answered_as_by_an_engine(
    drawn: tuple[HealthCnf, object], asked: Options, data: st.DataObject
) -> None:
    cnf, _ = drawn
    library = Library(cnf, cnf.atoms[:ATOMS], asked)
    agree(library, data.draw(rows_of(library.sensors)), asked)
    library.close()


@settings(deadline=None, max_examples=60)
@given(systems(weak=True), st.sampled_from(["subset", "cardinality"]), st.data())
def test_horn_systems_are_answered_without_a_solver(
    drawn: tuple[HealthCnf, object], minimal: Minimal, data: st.DataObject
) -> None:
    cnf, _ = drawn
    horn = [index for index, clause in enumerate(cnf.clauses) if sum(literal > 0 for literal in clause) < 2]
    cnf = replace(
        cnf,
        clauses=tuple(cnf.clauses[index] for index in horn),
        origins=tuple(cnf.origins[index] for index in horn),
    )
    asked = replace(PLAIN, minimal=minimal, limit=None)
    library = Library(cnf, cnf.atoms[:ATOMS], asked)
    assert library.whole
    agree(library, data.draw(rows_of(library.sensors)), asked)


@pytest.mark.parametrize("cnf", [TEDUSAR, MANIPULATOR], ids=["tedusar", "manipulator"])
@settings(deadline=None, max_examples=40)
@given(data=st.data(), asked=options)
def test_robots_are_answered_as_by_an_engine(cnf: HealthCnf, data: st.DataObject, asked: Options) -> None:
    library = Library(cnf, cnf.atoms, asked)
    assert library.whole is not bool(cnf.modes)
    agree(library, data.draw(rows_of(cnf.atoms)), asked)


def test_a_bound_on_time_is_an_answer_and_spoils_no_other() -> None:
    cnf, seen = random_triples(200)
    sensors = tuple(literal.atom for literal in seen)
    library = Library(cnf, sensors, replace(PLAIN, timeout_s=0.01))
    assert library.whole
    found = result(library, *seen)
    assert (found.complete, found.stopped_by) == (False, "time")
    assert result(library, seen[0]).complete


def breaking_off(last: int) -> Callable[[Deadline], None]:
    """Return a clock's `check` whose time is up at the last of so many looks."""
    looks = count(1)

    def check(_: Deadline) -> None:
        if next(looks) == last:
            raise OutOfTime

    return check


def test_a_search_that_is_broken_off_anywhere_spoils_no_row_that_shares_its_part(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """What a broken search would go on with says, asked again, that there is nothing more."""
    chance = Random("triples")
    blamed = [*(chance.sample(range(1, 13), 3) for _ in range(24)), [13, 14]]
    cnf = model(14, [(*(-c for c in one), 14 + i) for i, one in enumerate(blamed, 1)], atoms=len(blamed))
    asked = replace(PLAIN, limit=None)
    part = [Literal(atom, False) for atom in cnf.atoms[:-1]]
    shared = [*part, Literal(cnf.atoms[-1], False)]
    for last in count(1):
        library = Library(cnf, cnf.atoms, asked)
        with monkeypatch.context() as patch:
            patch.setattr(Deadline, "check", breaking_off(last))
            found = result(library, *part)
        agree(library, [shared], asked)
        library.close()
        if found.complete:
            break
        assert found.stopped_by == "time"
    assert last > 3  # it was broken off within the search, too


def test_what_a_library_cannot_do_is_refused() -> None:
    for asked in (
        Options(),
        replace(PLAIN, order="probability"),
        replace(PLAIN, healthy=frozenset(["jaguar"])),
    ):
        with pytest.raises(OptionRefused, match="a library tells no conflicts"):
            Library(TEDUSAR, TEDUSAR.atoms, asked)
    with pytest.raises(OptionRefused, match="named twice"):
        Library(TEDUSAR, TEDUSAR.atoms[:1] * 2, PLAIN)
