"""What is drafted can be read, whatever the names on the robot are."""

from __future__ import annotations

from pathlib import Path

import pytest
import yaml

from robomend.model.from_graph import Entries, observers_lines, upwards
from robomend_batch.learn.draft import LearnedSigns, outwards
from robomend_batch.learn.ranges import RangeFound, StatusFound
from robomend_batch.learn.tails import Bound
from robomend_batch.learn.update import proposed
from robomend_batch.observing import load_observers
from robomend_client.literals import fails, holds
from robomend_client.observers import SECOND, Driver


@pytest.mark.parametrize("name", ["camera [0]: *", 'a "quoted" one', "back\\slash", "Grüße: x"])
def test_a_status_is_observed_by_its_name_and_no_other(name: str, tmp_path: Path) -> None:
    edge = Bound(60.0, 40.0, 50.0, 50.0, 100)
    found = RangeFound("CPU 1: temp", None, edge, 30.0, 50.0)
    status = StatusFound(name, ("/camera",), "warn", {0: 100}, 1.0, 5.0, (found,), ())
    signs = LearnedSigns({}, frozenset())
    signs.status(status, "diagnostics")
    limit, own = sorted(signs.blamed, key=len, reverse=True)
    assert set(signs.blamed.values()) == {"camera"}
    file = tmp_path / "observers.yaml"
    file.write_text("\n".join(observers_lines(Entries({}, signs.observers, signs.evidence))))
    (spec,) = load_observers(file).specs
    for shown, expected in ((name, True), ("camera 0: x", False)):
        driver = Driver([spec.make()], 0)
        said = [
            change.value
            for second in range(1, 8)
            for change in driver.sample(
                "diagnostics",
                second * SECOND,
                [{"name": shown, "level": 0, "values": {"CPU 1: temp": "61.5 C"}}],
            )
        ]
        assert (holds("ok", own) in said, fails("ok", limit) in said) == (expected, expected)


def test_a_rounded_bound_is_no_tighter() -> None:
    for value in (0.123456, 1.0001, 7.00049, 1234.5, 99.96, 1e-3):
        assert value <= float(upwards(value)) <= 1.01 * value
        assert value <= float(outwards(value, 1)) <= 1.001 * value
        assert -1.001 * value <= float(outwards(-value, -1)) <= -value


@pytest.mark.parametrize(
    ("text", "topic", "observer"),
    [
        ("topics:\n  odom: {from: ros1, rate_hz: 40}\n", "ros1", "ros1"),
        ("rate: {from: ros2}\ntopics:\n  odom: {rate_hz: 40}\n", None, "ros2"),  # rate says it of topics
        ("topics:\n  odom: {from: ros1}\n  arm: {from: zenoh}\n", None, None),
        ("topics:\n  odom: {from: ros1}\n  arm: {}\n", None, None),
        ("topics:\n  odom: {rate_hz: 40}\n", None, None),
        ("name: x\n", None, None),
    ],
)
def test_what_joins_a_file_is_fed_as_its_topics_are(
    text: str, topic: str | None, observer: str | None, tmp_path: Path
) -> None:
    file = tmp_path / "agent.yaml"
    file.write_text(text)
    entries = Entries(
        topics={"scan": {"rate_hz": "10"}},
        observers={"hot": {"kind": "property", "source": '"t:data"', "high": "60"}},
        evidence={"scan": [], "hot": []},
    )
    added = [line[1:] for line in proposed(file, entries).splitlines() if line.startswith("+  ")]
    joined = yaml.safe_load("\n".join(added))
    assert joined["scan"].get("from") == topic
    assert joined["hot"].get("from") == observer
