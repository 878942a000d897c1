"""What an agent takes for usual of a topic, and what it does not."""

from __future__ import annotations

import random
from collections.abc import Callable
from pathlib import Path

import pytest

from robomend_client.agent.usual import FILE, Usual, read_usual
from robomend_client.observers import SECOND, Contact, Driver, GeneralObserver, Rate
from robomend_client.ros_graph import UsualRate

Event = Callable[[Driver, int], object]


def heard(
    folder: Path, until_s: int, happens: dict[int, Event] | None = None, silent_s: range = range(0)
) -> UsualRate:
    """Return what is usual of a topic of 10 Hz with jitter, in which at whole seconds something happens."""
    folder.mkdir(exist_ok=True)
    observer = GeneralObserver("scan", Rate(10, 4, window=31))
    usual, jitter = Usual(folder, [observer]), random.Random(1)
    driver = Driver([observer], 0, listeners=(usual,))
    for tick in range(10 * until_s):
        at_ns = tick * SECOND // 10
        if tick % 10 == 0 and (event := (happens or {}).get(tick // 10)):
            usual.changed(event(driver, at_ns) or ())  # type: ignore[arg-type]  # a driver's changes
        late_ns = round(jitter.uniform(0, 0.02) * SECOND)
        if tick // 10 not in silent_s:
            usual.changed(driver.sample("scan", at_ns + late_ns, None, at_ns + late_ns))
    usual.write()
    return read_usual(folder / FILE)["scan"]


def test_of_a_topic_that_is_well_all_but_its_newest_ten_to_twenty_seconds_is_usual(tmp_path: Path) -> None:
    one = heard(tmp_path, 100)
    assert 75 < one.seconds < 92
    assert one.count == pytest.approx(10 * one.seconds, rel=0.02)
    assert 0.1 < one.longest_s <= 0.12
    assert 9.8 < one.slowest_hz < 10 < one.fastest_hz < 10.2


@pytest.mark.parametrize(
    "happens",
    [
        {30: lambda driver, at_ns: driver.lapse(at_ns + SECOND)},
        {30: lambda driver, at_ns: driver.starved(True, at_ns)},
        {30: lambda driver, at_ns: driver.look("scan", Contact.LOST, at_ns)},
        {30: lambda driver, at_ns: driver.restart(at_ns)},
    ],
)
def test_what_nobody_looked_at_is_not_usual_nor_what_came_just_before(
    happens: dict[int, Event], tmp_path: Path
) -> None:
    calm, one = heard(tmp_path / "calm", 100), heard(tmp_path / "not", 100, happens)
    assert calm.seconds - 35 < one.seconds < calm.seconds - 9
    assert one.longest_s <= 0.12


def test_a_silence_is_not_usual(tmp_path: Path) -> None:
    one = heard(tmp_path, 100, silent_s=range(30, 33))
    assert one.seconds < 75
    assert one.longest_s <= 0.12
    assert one.slowest_hz > 9.8


def test_it_goes_on_where_it_was_and_a_file_that_is_none_is_nothing(tmp_path: Path) -> None:
    first = heard(tmp_path, 60)
    assert heard(tmp_path, 60).seconds == pytest.approx(2 * first.seconds)
    for text in ("{", "[]", '{"scan": 3}', '{"scan": {"rate": 3}}'):
        (tmp_path / FILE).write_text(text)
        assert read_usual(tmp_path / FILE) == {}
