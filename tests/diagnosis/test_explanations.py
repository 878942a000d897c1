"""Conflicts, diagnoses and cleared suspects, told in sentences."""

from __future__ import annotations

from collections.abc import Sequence

from robomend.diagnosis.explanations import (
    clear_suspects,
    conflict_in_words,
    explain_diagnoses,
    what_was_learned,
)
from robomend.diagnosis.result import Conflict, Diagnosis
from robomend.model.cnf import HealthCnf, Rule
from robomend_client.literals import Atom, Literal, fails, holds

HOKUYO, HOKUYO_NODE, MAPPING, SCAN, MAP, ON = range(1, 7)

SCAN_RULE = "not ab(hokuyo) and not ab(hokuyo_node) -> ok(scan)"
MAP_RULE = "not ab(hector_mapping) and ok(scan) -> ok(map)"
POWER_RULE = "not ab(hokuyo) -> on(hokuyo)"

LASER = HealthCnf(
    name="laser",
    components=("hokuyo", "hokuyo_node", "hector_mapping"),
    atoms=(Atom("ok", ("scan",)), Atom("ok", ("map",)), Atom("on", ("hokuyo",))),
    clauses=((-HOKUYO, -HOKUYO_NODE, SCAN), (-MAPPING, -SCAN, MAP), (-HOKUYO, ON)),
    origins=(0, 1, 2),
    rules=(Rule(SCAN_RULE, "scheme 3"), Rule(MAP_RULE, "scheme 4"), Rule(POWER_RULE, "scheme 1")),
    variables=6,
)


def conflict(components: str, *observations: Literal) -> Conflict:
    """Return a conflict whose first observation is the one that was not expected."""
    unmet = observations[0] if observations else None
    return Conflict(tuple(components.split()), observations, (), "", unmet)


def told(components: Sequence[str], observations: Sequence[Literal], rules: Sequence[str]) -> str:
    return conflict_in_words(LASER, tuple(components), tuple(observations), tuple(rules)).text


def test_an_unmet_expectation_names_what_it_rests_on() -> None:
    text = told(["hokuyo", "hokuyo_node"], [fails("ok", "scan")], [SCAN_RULE])
    assert text == (
        "scan should be ok because hokuyo and hokuyo_node are taken to be healthy, but it was seen not ok"
    )


def test_other_observations_are_premises_and_the_conclusion_of_a_rule_is_the_news() -> None:
    text = told(["hector_mapping"], [fails("ok", "map"), holds("ok", "scan")], [MAP_RULE])
    assert text == (
        "map should be ok because hector_mapping is taken to be healthy and scan was seen ok, "
        "but it was seen not ok"
    )


def test_a_chain_of_rules_is_collapsed_to_its_premises() -> None:
    text = told(LASER.components, [fails("ok", "map")], [SCAN_RULE, MAP_RULE])
    assert text == (
        "map should be ok because hokuyo, hokuyo_node and hector_mapping are taken to be healthy, "
        "but it was seen not ok"
    )


def test_power_running_trends_and_pairs_read_naturally() -> None:
    assert told(["hokuyo"], [fails("on", "hokuyo")], [POWER_RULE]).endswith(
        "hokuyo should be on because hokuyo is taken to be healthy, but it was seen off"
    )
    node = [fails("running", "n")]
    assert told(["n"], node, []).endswith("but it was seen not running")
    pair = told(["imu"], [fails("matched", "odom_yaw", "imu_yaw")], [])
    assert pair == (
        "odom_yaw and imu_yaw should match because imu is taken to be healthy, "
        "but they were seen not to match"
    )
    rising = told(["imu"], [holds("inc", "yaw")], [])
    assert rising == (
        "yaw should not be increasing because imu is taken to be healthy, but it was seen increasing"
    )


def test_a_diagnosis_explains_what_the_conflicts_that_it_hits_did_not_expect() -> None:
    conflicts = [conflict("a b", fails("ok", "x")), conflict("b c", fails("ok", "y"))]
    diagnoses = [
        Diagnosis(("b",)),
        Diagnosis(("a", "c")),
        Diagnosis(("b",), modes={"b": "stuck"}),
        Diagnosis(("d",)),
    ]
    assert explain_diagnoses(diagnoses, conflicts) == [
        "b explains not ok(x) and not ok(y)",
        "a explains not ok(x); c explains not ok(y)",
        "b (in mode stuck) explains not ok(x) and not ok(y)",
        "d is needed by a conflict that was not listed",
    ]
    assert explain_diagnoses([Diagnosis(("b",))], [conflict("b")]) == [
        "b resolves a conflict between the rules"
    ]
    (healthy,) = explain_diagnoses([Diagnosis(())], [])
    assert healthy.startswith("nothing is wrong")


def test_a_healthy_suspect_is_cleared_by_what_the_leading_diagnosis_explains() -> None:
    conflicts = [conflict("a b", fails("ok", "x")), conflict("b c", fails("ok", "y")), conflict("b d")]
    cleared = clear_suspects([("b",), ("a", "c", "d")], conflicts)
    assert list(cleared) == ["a", "c", "d"]
    assert cleared["a"] == (
        "b already resolves the only conflict naming it (not ok(x)); 1 of 2 diagnoses blames it instead"
    )
    assert clear_suspects([("b",)], conflicts)["d"] == "b already resolves the only conflict naming it"
    assert clear_suspects([], conflicts) == {}


def test_each_observation_says_what_it_taught() -> None:
    conflicts = [
        conflict("a b", fails("ok", "x")),
        conflict("c", fails("ok", "x"), holds("ok", "y")),
        conflict("", holds("on", "z")),  # between suppositions: it raises no suspicion
    ]
    assert what_was_learned(conflicts) == {
        "not ok(x)": "one of a and b is abnormal and c is abnormal",
        "ok(y)": "c is abnormal",
    }
