"""The diagnostic observer: levels, rules, silence."""

from __future__ import annotations

from typing import Any

import pytest

from robomend_client.literals import Atom, Literal, fails, holds
from robomend_client.observers import DiagnosticObserver, Driver, Evidence, Levels, Readings, ns
from robomend_client.observers.diagnostic import ValueRule, number_of

PUBLISHED = Levels(**{k: v for k, v in Levels.PRESETS["published"].items() if k != "lifetime_s"})


def status(level: object, name: str = "hokuyo: connection", **values: Any) -> dict[str, object]:
    return {"name": name, "level": level, "message": "", "values": values}


def observer(levels: Levels | None = None, *rules: str, **readings: Any) -> DiagnosticObserver:
    return DiagnosticObserver("hokuyo", ["hokuyo: *"], rules, levels, Readings(**readings))


def said(o: DiagnosticObserver, *samples: object) -> tuple[Literal, ...]:
    for second, sample in enumerate(samples):
        o.feed("diagnostics", ns(second), sample)
    return o.check(ns(len(samples) - 1))


@pytest.mark.parametrize(
    ("level", "ok"), [(0, True), (1, False), (2, False), (b"\x00", True), (b"\x02", False)]
)
def test_a_warning_is_bad_and_so_is_an_error(level: object, ok: bool) -> None:
    assert said(observer(), status(level)) == (Literal(Atom("ok", ("hokuyo",)), ok),)


def test_a_warning_may_be_ok() -> None:
    assert said(observer(Levels(bad_from="error")), status(1)) == (holds("ok", "hokuyo"),)


def test_names_are_matched_whole() -> None:
    assert said(observer(), status(2, "hokuyo2: connection"), status(2, "my hokuyo: x")) == ()
    assert said(observer(), status(2, "/hokuyo: x")) == (fails("ok", "hokuyo"),)


def test_the_worst_of_the_newest_counts() -> None:
    both = [status(0, "hokuyo: a"), status(2, "hokuyo: b"), status(2, "arm: c")]
    assert said(observer(), both) == (fails("ok", "hokuyo"),)
    assert said(observer(), both, status(0, "hokuyo: a")) == (fails("ok", "hokuyo"),)
    assert said(observer(), both, status(0, "hokuyo: b")) == (holds("ok", "hokuyo"),)


def test_stale_is_unknown_unless_it_was_said_to_be_bad() -> None:
    assert said(observer(), status(0), status(3)) == ()
    assert said(observer(PUBLISHED), status(0), status(3)) == (fails("ok", "hokuyo"),)


def test_silence_is_unknown_unless_it_was_said_to_be_bad() -> None:
    o = observer(lifetime_s=5)
    said(o, status(0))
    assert o.due_ns() == ns(5)
    assert (o.check(ns(4.9)), o.check(ns(5))) == ((holds("ok", "hokuyo"),), ())
    bad = observer(PUBLISHED, lifetime_s=2)
    said(bad, status(0))
    assert bad.check(ns(2)) == (fails("ok", "hokuyo"),)
    assert bad.evidence(Atom("ok", ("hokuyo",)), ns(2.5))[:2] == Evidence(ns(0.5), 0)[:2]


def test_rules_judge_the_values_that_a_status_carries() -> None:
    o = observer(None, "temp_cpu1 < 40.0", "motor: CPU 1 temp <= 60")
    values: dict[str, Any] = {"temp_cpu1": "39.5 °C", "CPU 1 temp": 61}
    assert said(o, status(0, **values)) == (
        holds("ok", "hokuyo"),
        holds("ok", "temp_cpu1"),
        fails("ok", "motor"),
    )
    pairs = {"name": "hokuyo: x", "level": 0, "values": [{"key": "temp_cpu1", "value": "41"}]}
    assert said(o, pairs)[1:] == (fails("ok", "temp_cpu1"), fails("ok", "motor"))


@pytest.mark.parametrize("value", ["hot", "", None, float("nan"), "nan"])
def test_a_value_that_is_no_number_says_nothing(value: object) -> None:
    assert said(observer(None, "temp < 40"), status(0, temp=value)) == (holds("ok", "hokuyo"),)


@pytest.mark.parametrize(
    ("text", "key", "op", "limit"),
    [
        ("t<40", "t", "<", 40),
        ("t >= -1e3", "t", ">=", -1000),
        ("t != 0", "t", "!=", 0),
        ("a b == .5", "a b", "==", 0.5),
    ],
)
def test_rules_are_read(text: str, key: str, op: str, limit: float) -> None:
    rule = ValueRule.parse(text if " b" not in text else f"n: {text}")
    assert (rule.key, rule.op, rule.limit) == (key, op, limit)


@pytest.mark.parametrize(
    "text", ["t", "t < hot", "< 4", "t <", "t < 4; rm", "CPU 1 temp < 4", "t == 0x", "t == OK;"]
)
def test_what_is_no_rule_is_refused(text: str) -> None:
    with pytest.raises(ValueError, match=r"is no (rule|atom)"):
        ValueRule.parse(text)


@pytest.mark.parametrize(
    ("text", "number"),
    [
        ("39.5", 39.5), ("39.5 °C", 39.5), ("39.5°C", 39.5), (" -12V ", -12), ("80 %", 80),
        ("39,5", 39.5), ("39,5 °C", 39.5), ("0x1F", 31), ("-0x10", -16), ("1e3", 1000), (".5", 0.5),
        ("7 of 9", 7),
        ("9.81m/s2", 9.81), ("1,234.5", 1234.5), ("1,234,567", 1234567), ("5.", 5),
        ("1,234", None), ("1.234,5", None), ("1.2.3", None), ("12:30", None), ("2026-11-27", None),
        ("5/10", None), ("192.168.0.1", None), ("0b101", None), ("0x1G", None), ("hot", None), ("", None),
        ("nan", None), ("- 5", None),
    ],
)  # fmt: skip
def test_a_number_is_read_as_people_write_it_or_not_at_all(text: str, number: float | None) -> None:
    assert number_of(text) == number


@pytest.mark.parametrize("order", [1, -1])
@pytest.mark.parametrize("hardware", ["", "arm", "leg"])
def test_of_statuses_of_one_name_the_worst_counts(order: int, hardware: str) -> None:
    """Two devices of one driver: the one that is well does not hide the other."""
    both = [status(0, temp=95), {**status(0, temp=40), "hardware_id": hardware}][::order]
    assert said(observer(None, "temp < 60"), both)[1:] == (fails("ok", "temp"),)
    bad = [status(2), {**status(0), "hardware_id": hardware}][::order]
    assert said(observer(), bad) == (fails("ok", "hokuyo"),)
    assert said(observer(), bad, [status(0), {**status(0), "hardware_id": hardware}]) == (
        holds("ok", "hokuyo"),
    )


def test_of_a_key_that_repeats_the_worst_counts() -> None:
    for values in (["95", "40"], ["40", "95"]):
        sample = {"name": "hokuyo: x", "level": 0, "values": [{"key": "temp", "value": v} for v in values]}
        assert said(observer(None, "temp < 60"), sample)[1:] == (fails("ok", "temp"),)


@pytest.mark.parametrize(
    ("rule", "value", "ok"),
    [
        ("e_stop == FALSE", "False", True), ("e_stop == FALSE", "True", False),
        ("e_stop == false", False, True), ("e_stop == false", True, False),
        ("e_stop != OK", "ok", False), ("e_stop == All good", "all good ", True),
    ],
)  # fmt: skip
def test_a_rule_may_be_about_a_text(rule: str, value: object, ok: bool) -> None:
    assert said(observer(None, rule), status(0, e_stop=value))[1:] == (Literal(Atom("ok", ("e_stop",)), ok),)
    assert len(said(observer(None, rule), status(0, e_stop=None))) == 1


def test_a_rule_on_the_device_itself_counts_beside_its_levels() -> None:
    o = DiagnosticObserver("brake", ["*"], ["brake: Brake state == OK"])
    assert said(o, status(0, **{"Brake state": "OK"})) == (holds("ok", "brake"),)
    assert said(o, status(0, **{"Brake state": "worn"})) == (fails("ok", "brake"),)
    assert said(o, status(2, **{"Brake state": "OK"})) == (fails("ok", "brake"),)


@pytest.mark.parametrize(("level", "ok"), [(0, True), (2, False)])
def test_a_status_that_comes_once_counts_for_its_lifetime(level: int, ok: bool) -> None:
    """As of drivers that report changes only."""
    driver = Driver([observer(None, lifetime_s=60)], 0)
    driver.sample("diagnostics", ns(1), [status(level)], ns(1))
    driver.advance(ns(50))
    assert [one.literal for one in driver.standing()] == [Literal(Atom("ok", ("hokuyo",)), ok)]
    driver.advance(ns(62))
    assert driver.standing() == []


def test_statuses_may_come_on_any_topic() -> None:
    """By its name, or as ROS has it as a field of its messages, beside which each message is counted."""
    o = DiagnosticObserver("hokuyo", ["hokuyo: *"], source="robot1/diagnostics_agg")
    assert o.sources == {"robot1/diagnostics_agg", "robot1/diagnostics_agg:status"}
    o.feed("robot1/diagnostics_agg", 0, None)
    assert o.check(0) == ()
    o.feed("robot1/diagnostics_agg:status", 0, [status(2)])
    assert o.check(0) == (fails("ok", "hokuyo"),)


@pytest.mark.parametrize(
    ("pattern", "name", "matches"),
    [
        ("CPU Usage [robot-c2]", "CPU Usage [robot-c2]", True),
        ("CPU Usage [robot-c2]", "CPU Usage r", False),
        ("CPU [[]*]", "CPU [robot-c2]", True), ("a [*]", "a *", True), ("a [*]", "a b", False),
        ("m?", "m1", True), ("m?", "m12", False), ("a.c", "abc", False), ("", "", True), ("*", "", True),
    ],
)  # fmt: skip
def test_names_are_meant_as_they_are_written(pattern: str, name: str, matches: bool) -> None:
    o = DiagnosticObserver("d", [pattern])
    assert bool(said(o, status(2, name))) == matches


def test_an_onset_is_the_last_good_status() -> None:
    o = observer()
    assert said(o, status(0), status(0), status(2), status(2)) == (fails("ok", "hokuyo"),)
    assert o.evidence(Atom("ok", ("hokuyo",)), ns(3))[:2] == Evidence(ns(3), ns(1))[:2]


def test_other_samples_are_refused() -> None:
    with pytest.raises(TypeError, match="a diagnostic status or a list"):
        observer().feed("diagnostics", 0, "fine")
    with pytest.raises(KeyError):
        observer().feed("diagnostics", 0, {"level": 0})


def test_each_verdict_turns_unknown_by_itself_when_nothing_speaks_of_it_any_more() -> None:
    hot = observer(None, "temperature < 40", lifetime_s=2)
    driver = Driver([hot], 0)
    driver.sample("diagnostics", ns(0), status(0, temperature="20"), ns(0))
    driver.sample("diagnostics", ns(1), status(0), ns(1))  # it does not say how hot it is any more
    changes = driver.advance(ns(10))
    assert [(change.time_ns, str(change.atom), change.value) for change in changes] == [
        (ns(2), "ok(temperature)", None),
        (ns(3), "ok(hokuyo)", None),
    ]
    assert driver.standing() == []
