"""What diagnostics say of a healthy device."""

from __future__ import annotations

import numpy as np

from robomend_batch.learn.gathering import Status
from robomend_batch.learn.ranges import StatusFound, learn_range, learn_status
from robomend_batch.learn.stretches import Stretch
from robomend_client.observers import SECOND

STRETCH = Stretch(0, 0, 3600 * SECOND, False)


def status(levels: dict[int, int] | None = None, **numbers: object) -> Status:
    found = Status()
    for level, count in (levels or {0: 600}).items():
        for _ in range(count):
            found.levels.add(0, found.levels.count * SECOND, float(level))
    for key, values in numbers.items():
        for second, value in enumerate(np.asarray(values).tolist()):
            found.numbers[key].add(0, second * SECOND, value)
    return found


def learn(given: Status) -> StatusFound:
    found = learn_status("motor: state", given, [STRETCH], 0.2, 0.01)
    assert isinstance(found, StatusFound), found
    return found


def test_one_reading_that_is_off_does_not_widen_the_range_without_bounds() -> None:
    warm = np.random.default_rng(1).normal(40, 1, 600)
    warm[300] = 60
    (found,) = learn(status(temperature=warm)).ranges
    assert 60 < found.high.value < 80


def test_a_number_of_a_topic_that_drifts_has_no_range_and_a_device_that_warms_up_has() -> None:
    way = np.linspace(0, 100, 600) + np.random.default_rng(1).normal(0, 1, 600)
    given = status(way=way)
    told = learn_range("way", given.numbers["way"], [STRETCH], 0.2, 0.01, telemetry=True)
    assert told == "it drifts: no range"
    (found,) = learn(given).ranges
    assert found.high.value > 125


def test_what_counts_or_stands_has_no_range() -> None:
    found = learn(status(uptime=np.arange(600), port=np.full(600, 80)))
    assert found.ranges == ()
    assert found.left_out == ("port: always 80", "uptime: it counts: no range")


def test_a_number_that_is_never_negative_is_judged_from_above_only() -> None:
    load = np.random.default_rng(1).exponential(0.1, 600)
    (found,) = learn(status(load=load)).ranges
    assert found.low is None


def test_what_was_held_back_is_not_learned_from() -> None:
    given = status({0: 590, 2: 10})
    found = learn_status("m", given, [Stretch(0, 0, 580 * SECOND, False)], 0.2, 0.01)
    assert isinstance(found, StatusFound)
    assert found.levels == {0: 580}


def test_warnings_in_healthy_logs_are_no_fault_and_errors_are_no_health() -> None:
    assert learn(status()).bad_from == "warn"
    assert learn(status({0: 590, 1: 10})).bad_from == "error"
    assert learn_status("m", status({0: 590, 2: 10}), [STRETCH], 0.2, 0.01) == (
        "10 errors in logs that should be healthy"
    )
    assert learn_status("m", status({3: 600}), [STRETCH], 0.2, 0.01) == "it is stale all the time"
