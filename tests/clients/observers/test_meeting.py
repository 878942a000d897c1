"""Who publishes a topic, and who does not meet whom."""

from __future__ import annotations

import pytest
from tests.clients.observers.driving import values

from robomend_client.observers import Change, Driver, Publishers, ns
from robomend_client.observers.meeting import PublishersObserver, Publishing, suggested
from robomend_client.readings import Symptom

BAD, GOOD = "not ok(publishers,odom)", "ok(publishers,odom)"


def told(driver: Driver, at_s: float, *nodes: str) -> list[Change]:
    changes = [*driver.advance(ns(at_s)), *driver.sample("odom", ns(at_s), Publishers(nodes), ns(at_s))]
    return [*changes, *driver.advance(ns(at_s + 1.1))]


@pytest.mark.parametrize(
    ("nodes", "reading", "symptom"),
    [
        ((), "nobody publishes it", Symptom.SILENT),
        (("/a", "/b"), "2 publishers: /a, /b, at most 1", Symptom.PUBLISHERS),
        (("/c",), "published by /c, should be a, b", Symptom.PUBLISHERS),
    ],
)
def test_none_more_or_another_is_a_fault_and_says_who(
    nodes: tuple[str, ...], reading: str, symptom: Symptom
) -> None:
    driver = Driver([PublishersObserver("ok(publishers,odom)", nodes=["a", "b"])], 0)
    assert values(told(driver, 1, "/a", "/a")) == [GOOD]
    (bad,) = told(driver, 5, *nodes)
    assert str(bad.value) == BAD
    assert bad.reading is not None
    assert (str(bad.reading), bad.reading.symptom) == (reading, symptom)
    assert values(told(driver, 9, "/b")) == [GOOD]


def test_what_passes_within_a_second_is_none_and_a_late_start_neither() -> None:
    driver = Driver([PublishersObserver("ok(publishers,odom)")], 0)
    assert told(driver, 0) == []
    assert values(told(driver, 20, "/a")) == [GOOD]
    assert driver.sample("odom", ns(30), Publishers(()), ns(30)) == []
    assert driver.sample("odom", ns(30.9), Publishers(("/a",)), ns(30.9)) == []
    assert driver.advance(ns(60)) == []
    late = Driver([PublishersObserver("ok(publishers,odom)", expected=Publishing(first_s=5))], 0)
    assert told(late, 1) == []
    assert values(late.advance(ns(5.1))) == [BAD]


def test_a_topic_with_one_publisher_suggests_who_should_publish_it() -> None:
    assert suggested("/odom", ["/a"]) == {"ok(publishers,odom)": {"kind": "publishers", "topic": "odom"}}
    assert suggested("/tf", ["/a", "/b"], dds=True) == {"ok(qos,tf)": {"kind": "qos", "topic": "tf"}}
