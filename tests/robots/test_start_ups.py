"""How long a start may take, by the earlier ones that were seen."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from math import inf
from types import SimpleNamespace

import pytest

from robomend.entry import Entry
from robomend.model.components import ComponentModel, Hardware, Node
from robomend.robots import start_ups
from robomend.robots.declared import Delays
from robomend.robots.start_ups import LATEST, LEAST_NS, SLACK_NS, TIMES, StartUps
from robomend_client.actions import Action
from robomend_client.literals import Atom, Literal

S = 10**9
PARTS = ComponentModel(
    "small",
    {"rail": Hardware("rail", channel=1), "lidar": Hardware("lidar", channel=3, fed_by=("rail",))},
    {
        "driver": Node("driver", drives=("lidar",), publishes={"scan": (), "echoes": ()}),
        "mapping": Node("mapping", publishes={"map": ("scan",)}),
    },
    {},
)
DRIVER, MAPPING = Atom("running", ("driver",)), Atom("running", ("mapping",))
SCAN, ECHOES, MAP = Atom("ok", ("scan",)), Atom("ok", ("echoes",)), Atom("ok", ("map",))
ON, RAIL = Atom("on", ("lidar",)), Atom("on", ("rail",))


@dataclass
class Seen:
    """What is observed after an act: by default that all runs, and that nothing is heard."""

    values: dict[Atom, bool] = field(
        default_factory=lambda: {DRIVER: True, MAPPING: True, SCAN: False, ECHOES: False, MAP: False}
    )
    rose: dict[Atom, int] = field(default_factory=dict)

    def value(self, atom: Atom) -> bool | None:
        return self.values.get(atom)

    def reported(self, atom: Atom) -> bool:
        return atom in self.values

    def seen_off(self, atom: Atom) -> bool:
        return atom in self.rose

    def rose_ns(self, atom: Atom) -> int | None:
        return self.rose.get(atom)

    def delays(self, atom: Atom) -> Delays:
        return Delays(S, S // 2)


@pytest.fixture(autouse=True)
def clock(monkeypatch: pytest.MonkeyPatch) -> SimpleNamespace:
    """The service's clock stands at 1,000 s."""
    here = SimpleNamespace(time_ns=1000 * S)
    monkeypatch.setattr(start_ups, "CLOCK", SimpleNamespace(now_ns=lambda: here.time_ns))
    return here


def news(literal: Literal, at_s: float) -> Entry:
    return Entry(literal, "agent", round(at_s * S), None, round(at_s * S))


def started(found: StartUps, node: Atom, topic: Atom, at_s: float, took_s: float) -> None:
    """A node is seen to stop and to begin, and its topic is heard some time later."""
    found.hear([news(Literal(topic, False), at_s - 1), news(Literal(node, False), at_s - 1)], PARTS)
    found.hear([news(Literal(node), at_s)], PARTS)
    found.hear([news(Literal(topic), at_s + took_s)], PARTS)


def left_s(found: StartUps, seen: Seen, *missing: Atom, since_s: float = 1000.0) -> float:
    return found.may_take_s([Literal(atom) for atom in missing], round(since_s * S), PARTS, seen)


def test_a_start_may_take_twice_the_longest_of_the_latest_and_a_second_in_any_case() -> None:
    found = StartUps()
    assert found.may_take_ns("scan") is None
    started(found, DRIVER, SCAN, 100, 0.2)
    assert found.may_take_ns("scan") == LEAST_NS
    started(found, DRIVER, SCAN, 200, 3)
    assert found.may_take_ns("scan") == TIMES * 3 * S
    for number in range(LATEST):
        started(found, DRIVER, SCAN, 300 + number * 10, 1)
    assert found.may_take_ns("scan") == TIMES * 1 * S
    assert found.may_take_ns("echoes") is None


def test_what_was_not_seen_to_begin_or_took_a_minute_was_no_start() -> None:
    found = StartUps()
    found.hear([news(Literal(DRIVER), 100), news(Literal(SCAN), 101)], PARTS)  # it ran when first heard of
    assert found.may_take_ns("scan") is None
    started(found, DRIVER, SCAN, 200, 61)
    assert found.may_take_ns("scan") is None
    started(found, DRIVER, SCAN, 300, -0.5)  # heard before it began: of the one before
    assert found.may_take_ns("scan") is None
    found.hear([news(Literal(DRIVER, False), 400), news(Literal(SCAN), 401)], PARTS)  # nor when it is gone
    assert found.may_take_ns("scan") is None


def test_a_topic_that_was_heard_already_and_comes_back_is_no_start() -> None:
    found = StartUps()
    started(found, DRIVER, SCAN, 100, 0.8)
    found.hear([news(Literal(SCAN, False), 120), news(Literal(SCAN), 130)], PARTS)
    assert found.may_take_ns("scan") == round(TIMES * 0.8 * S)
    # The verdict of the one before stood until the new one was good: that is not news, and it falls later.
    found.hear([news(Literal(DRIVER, False), 200), news(Literal(DRIVER), 201)], PARTS)
    silent = Entry(Literal(SCAN, False), "agent", 220 * S, None, 220 * S, onset_ns=219 * S)
    found.hear([silent, news(Literal(SCAN), 230)], PARTS)
    assert found.may_take_ns("scan") == round(TIMES * 0.8 * S)


def test_silence_whose_last_sample_was_of_the_one_before_does_not_end_a_start() -> None:
    found = StartUps()
    found.hear([news(Literal(DRIVER, False), 99), news(Literal(DRIVER), 100)], PARTS)
    silent = Entry(Literal(SCAN, False), "agent", 101 * S, None, 101 * S, onset_ns=round(98.9 * S))
    found.hear([silent, news(Literal(SCAN), 104)], PARTS)
    assert found.may_take_ns("scan") == TIMES * 4 * S


def test_what_is_to_be_written_is_told_once_and_what_was_read_is_known() -> None:
    found = StartUps()
    assert found.unwritten() == {}
    started(found, DRIVER, SCAN, 100, 2)
    started(found, DRIVER, SCAN, 200, 3)
    assert found.unwritten() == {"scan": (2 * S, 3 * S)}
    assert found.unwritten() == {}
    other = StartUps()
    other.recall({"scan": (2 * S, 3 * S)}, PARTS)
    assert other.may_take_ns("scan") == TIMES * 3 * S
    assert other.unwritten() == {}


def test_of_topics_that_the_model_has_not_any_more_nothing_is_kept() -> None:
    found = StartUps()
    found.recall({"scan": (S,), "gone": (S,)}, PARTS)
    assert found.may_take_ns("gone") is None
    assert found.unwritten() == {"gone": ()}
    found.publishers(replace(PARTS, nodes={"mapping": PARTS.nodes["mapping"]}))
    assert found.unwritten() == {"scan": ()}


def test_a_start_is_in_vain_after_twice_the_longest_and_its_observers_time() -> None:
    found = StartUps()
    assert left_s(found, Seen(), SCAN) == inf
    started(found, DRIVER, SCAN, 100, 0.8)
    assert left_s(found, Seen(), SCAN) == pytest.approx(1.6 + 0.5 + SLACK_NS / S)
    assert left_s(found, Seen(), SCAN, ECHOES, since_s=997) == pytest.approx(1.6 + 0.5 + SLACK_NS / S - 3)
    assert left_s(found, Seen(), ECHOES, DRIVER) == inf


def test_before_its_observer_has_said_how_it_is_after_the_act_nothing_is_in_vain() -> None:
    found = StartUps()
    started(found, DRIVER, SCAN, 100, 0.8)
    seen = Seen()
    del seen.values[SCAN]
    assert left_s(found, seen, SCAN, since_s=900) == inf
    seen = Seen()
    seen.values[DRIVER] = False  # something else went wrong
    assert left_s(found, seen, SCAN, since_s=900) == inf


def test_what_needs_an_input_has_its_time_from_when_that_is_there() -> None:
    found = StartUps()
    started(found, MAPPING, MAP, 100, 2)
    seen = Seen()
    assert left_s(found, seen, MAP) == inf
    seen.values[SCAN] = True
    seen.rose[SCAN] = 1003 * S
    assert left_s(found, seen, MAP) == pytest.approx(3 + 4 + 0.5 + SLACK_NS / S)


@pytest.mark.parametrize("device", [ON, RAIL])
def test_of_a_device_that_got_its_power_lately_nobody_knows_how_long_it_takes(device: Atom) -> None:
    found = StartUps()
    started(found, DRIVER, SCAN, 100, 0.8)
    seen = Seen()
    seen.rose[device] = 990 * S
    assert left_s(found, seen, SCAN) == inf
    seen.rose[device] = 900 * S
    assert left_s(found, seen, SCAN) < inf


@pytest.mark.parametrize("device", ["lidar", "rail"])
def test_a_device_that_a_repair_switched_is_waited_for_also_where_nobody_tells_of_its_power(
    device: str,
) -> None:
    found, node = StartUps(), PARTS.nodes["driver"]
    started(found, DRIVER, SCAN, 100, 0.8)
    started(found, DRIVER, ECHOES, 200, 0.8)
    started(found, MAPPING, MAP, 300, 0.8)
    found.acted(Action("r:0", "start_node", ("driver",), 1.0), 999 * S, 1005 * S)
    assert found.after_our_start_ns(node, 1000 * S, PARTS, Seen()) is not None
    found.acted(Action("r:1", "power_up", (device,), 1.0), 999 * S, 1005 * S)
    assert left_s(found, Seen(), SCAN) == inf
    assert found.after_our_start_ns(node, 1000 * S, PARTS, Seen()) is None
    mapped = Seen()
    mapped.values[SCAN] = True
    assert left_s(found, mapped, MAP) < inf  # it hangs on no device


def test_after_an_act_of_the_users_own_one_waits_as_configured(clock: SimpleNamespace) -> None:
    found = StartUps()
    started(found, DRIVER, SCAN, 100, 0.8)
    found.acted(Action("r:0", "reset_usb", ("usb1",), 1.0), 999 * S, 1005 * S)
    assert left_s(found, Seen(), SCAN) == inf
    clock.time_ns = 1005 * S
    assert left_s(found, Seen(), SCAN, since_s=1005) < inf


def test_how_long_a_node_may_be_silent_is_known_of_those_that_a_repair_started() -> None:
    found, node = StartUps(), PARTS.nodes["driver"]
    started(found, DRIVER, SCAN, 100, 0.8)
    started(found, DRIVER, ECHOES, 200, 2)
    assert (
        found.after_our_start_ns(node, 1000 * S, PARTS, Seen()) is None
    )  # a boot may take longer than a restart
    found.acted(Action("r:0", "start_node", ("driver",), 1.0), 999 * S, 1005 * S)
    assert found.after_our_start_ns(node, 1000 * S, PARTS, Seen()) == round(4.5 * S)
    assert found.after_our_start_ns(node, 998 * S, PARTS, Seen()) is None
    other = StartUps()
    started(other, DRIVER, SCAN, 100, 0.8)
    other.acted(Action("r:0", "start_node", ("driver",), 1.0), 999 * S, 1005 * S)
    assert other.after_our_start_ns(node, 1000 * S, PARTS, Seen()) is None  # echoes may take longer
