"""What to look at next."""

from __future__ import annotations

from collections.abc import Iterable
from math import log2

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from tests.diagnosis.systems import brute_force, model, satisfiable, systems

from robomend.diagnosis import probes
from robomend.diagnosis.probes import Prober, ProbeResult, Value, information
from robomend.diagnosis.result import Diagnosis, DiagnosisResult, StoppedBy
from robomend.errors import OptionRefused
from robomend.model.cnf import Clause, HealthCnf
from robomend_client.literals import Literal, fails

# c1 is the laser, c2 its driver: a1 scan needs both, a2 power needs c1, a3 the driver's pulse needs c2.
LASER = model(2, [(-1, -2, 3), (-1, 4), (-2, 5)], atoms=3)
SCAN, POWER, PULSE = LASER.atoms
SILENT = frozenset({Literal(SCAN, False)})


def answer(
    cnf: HealthCnf, *bad: tuple[str, ...], stopped_by: StoppedBy | None = None, **p: float
) -> DiagnosisResult:
    diagnoses = tuple(Diagnosis(names, p.get("".join(names))) for names in bad)
    return DiagnosisResult(cnf.components, diagnoses, stopped_by is None, stopped_by, (), 0.0)


BOTH = answer(LASER, ("c1",), ("c2",))


def next_probes(cnf: HealthCnf, seen: Iterable[Literal], result: DiagnosisResult) -> ProbeResult:
    prober = Prober(cnf)
    try:
        return prober.probes(seen, result)
    finally:
        prober.close()


def test_the_two_parts_of_a_sensor_are_told_apart_by_what_needs_only_one() -> None:
    found = next_probes(LASER, SILENT, BOTH)
    assert [probe.atom for probe in found.probes] == [POWER, PULSE]
    power = found.probes[0]
    assert power.if_true == (1,)  # if the driver is to blame the laser has power
    assert power.if_false == ()
    assert power.gain_bits == pytest.approx(0.311278)
    assert found.entropy_bits == pytest.approx(1)
    assert found.reason is None
    assert found.complete


def test_when_no_probe_can_discriminate_it_says_so() -> None:
    twins = model(2, [(-1, -2, 3)], atoms=2)  # a2 depends on nothing
    found = next_probes(twins, {fails("ok", "a1")}, answer(twins, ("c1",), ("c2",)))
    assert found.probes == ()
    assert found.reason == "the 2 diagnoses predict the same for everything that can still be observed"


@pytest.mark.parametrize(
    ("result", "reason"),
    [
        (answer(LASER, ()), "nothing is wrong"),
        (answer(LASER, ("c1",)), "there is one diagnosis"),
        (answer(LASER, ("c1",), stopped_by="time"), "stopped by time"),
        (answer(LASER), "there is no diagnosis"),
    ],
)
def test_with_one_diagnosis_or_none_there_is_nothing_to_tell_apart(
    result: DiagnosisResult, reason: str
) -> None:
    found = next_probes(LASER, SILENT, result)
    assert found.probes == ()
    assert reason in (found.reason or "")


@pytest.mark.parametrize("bound", ["MAX_POINTS", "MAX_DIAGNOSES"])
def test_that_more_was_not_considered_is_told(monkeypatch: pytest.MonkeyPatch, bound: str) -> None:
    assert next_probes(LASER, SILENT, BOTH).complete
    monkeypatch.setattr(probes, bound, 1)
    assert not next_probes(LASER, SILENT, BOTH).complete


def test_bounds_are_felt_and_told() -> None:
    prober = Prober(LASER)
    late = prober.probes(SILENT, BOTH, timeout_s=0)
    assert not late.complete
    assert late.probes == ()
    assert "more time" in (late.reason or "")
    with pytest.raises(OptionRefused, match="limit is 0"):
        prober.probes(SILENT, BOTH, limit=0)
    with pytest.raises(OptionRefused, match=r"timeout_s is -1\.0"):
        prober.probes(SILENT, BOTH, timeout_s=-1.0)
    prober.close()


def test_what_follows_only_case_by_case_is_predicted_too() -> None:
    cases: list[Clause] = [(-2, 4, 5), (-2, 4, -5)]  # where c2 is healthy a2 holds, whatever a3 is
    cnf = model(2, [(-1, -2, 3), (-1, -4), *cases], atoms=3)
    seen = frozenset({fails("ok", "a1")})
    (probe,) = (
        one for one in next_probes(cnf, seen, answer(cnf, ("c1",), ("c2",))).probes if "a2" in str(one.atom)
    )
    assert (probe.if_true, probe.if_false) == ((0,), (1,))


@settings(deadline=None)
@given(systems())
def test_predictions_are_what_is_entailed(drawn: tuple[HealthCnf, frozenset[Literal]]) -> None:
    cnf, seen = drawn
    diagnoses = brute_force(cnf, seen)
    if diagnoses is None or len(diagnoses) < 2 or () in diagnoses:
        return
    order = sorted(diagnoses)
    found = next_probes(cnf, seen, answer(cnf, *order))
    by_atom = {probe.atom: probe for probe in found.probes}
    facts = [(number,) for literal in seen if (number := cnf.literal(literal)) is not None]
    observed = {literal.atom for literal in seen}
    for atom, variable in cnf.atom_variable.items():
        values = [entailed(cnf, facts, bad, variable) for bad in order]
        if atom in observed:
            assert atom not in by_atom
        elif len(set(values)) > 1:
            assert by_atom[atom].if_true == tuple(i for i, value in enumerate(values) if value == 1)
            assert by_atom[atom].if_false == tuple(i for i, value in enumerate(values) if value == 0)
        else:
            assert atom not in by_atom


def entailed(cnf: HealthCnf, facts: list[tuple[int]], bad: tuple[str, ...], variable: int) -> Value:
    """Return the value of a variable under a diagnosis, by definition."""
    health = [(-number if name in bad else number,) for name, number in cnf.health.items()]
    can = {
        sign: satisfiable([*cnf.clauses, *facts, *health, (variable if sign else -variable,)], cnf.variables)
        for sign in (False, True)
    }
    if can[True] and can[False]:
        return -1
    return 1 if can[True] else 0


@given(
    st.lists(st.lists(st.sampled_from([-1, 0, 1]), min_size=3, max_size=3), min_size=2, max_size=5),
    st.data(),
)
def test_the_gain_is_the_fall_of_entropy(rows: list[list[Value]], data: st.DataObject) -> None:
    raw = data.draw(st.lists(st.integers(1, 9), min_size=len(rows), max_size=len(rows)))
    weights = [value / sum(raw) for value in raw]
    for point, column in enumerate(zip(*rows, strict=True)):
        after = 0.0
        for outcome in (0, 1):
            joint = [
                w * (0.5 if row[point] == -1 else float(row[point] == outcome))
                for w, row in zip(weights, rows, strict=True)
            ]
            mass = sum(joint)
            after += mass * entropy([share / mass for share in joint]) if mass else 0.0
        assert information(weights, column) == pytest.approx(entropy(weights) - after, abs=1e-9)


def entropy(shares: list[float]) -> float:
    return -sum(share * log2(share) for share in shares if share > 0)
