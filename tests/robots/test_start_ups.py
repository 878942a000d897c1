"""How long a start may take, by the earlier ones that were seen."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from math import inf
from types import SimpleNamespace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from robomend.entry import Entry
from robomend.model.components import ComponentModel, Hardware, Node
from robomend.robots import start_ups
from robomend.robots.declared import Delays
from robomend.robots.start_ups import (
    BOOTS_NS,
    LATEST,
    LEAST_NS,
    OFTEN_BOOTED,
    SLACK_NS,
    StartUps,
)
from robomend.store.records import StoredStart
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
    looked: dict[Atom, int] = field(default_factory=dict)
    fell: dict[Atom, int] = field(default_factory=dict)

    def fell_ns(self, atom: Atom) -> int | None:
        return self.fell.get(atom)

    def value(self, atom: Atom) -> bool | None:
        return self.values.get(atom)

    def reported(self, atom: Atom) -> bool:
        return atom in self.values

    def seen_off(self, atom: Atom) -> bool:
        return atom in self.rose

    def rose_ns(self, atom: Atom) -> int | None:
        return self.rose.get(atom)

    def looked_ns(self, atom: Atom) -> int:
        return self.looked.get(atom, 0)

    def delays(self, atom: Atom) -> Delays:
        return Delays(S, S // 2)


@pytest.fixture(autouse=True)
def clock(monkeypatch: pytest.MonkeyPatch) -> SimpleNamespace:
    """The service's clock stands at 1,000 s."""
    here = SimpleNamespace(time_ns=1000 * S)
    monkeypatch.setattr(start_ups, "CLOCK", SimpleNamespace(now_ns=lambda: here.time_ns))
    monkeypatch.setattr(start_ups, "monotonic", lambda: HEARD["at_s"])
    return here


HEARD = {"at_s": 0.0}
"""When the latest was heard of, by a clock that does not jump."""


def heard(
    found: StartUps,
    *entries: Entry,
    seen: Seen | None = None,
    parts: ComponentModel = PARTS,
    late_s: float = 0,
) -> None:
    """Let it hear of these, as they happen or so much later."""
    for entry in entries:
        HEARD["at_s"] = entry.time_ns / S + late_s
        found.hear([entry], parts, seen or Seen())


def news(literal: Literal, at_s: float) -> Entry:
    return Entry(literal, "agent", round(at_s * S), None, round(at_s * S))


def started(found: StartUps, node: Atom, topic: Atom, at_s: float, took_s: float) -> None:
    """A node is seen to stop and to begin, and its topic is heard some time later."""
    heard(found, news(Literal(topic, False), at_s - 1), news(Literal(node, False), at_s - 1))
    heard(found, news(Literal(node), at_s))
    heard(found, news(Literal(topic), at_s + took_s))


def left_s(
    found: StartUps, seen: Seen, *missing: Atom, since_s: float = 1000.0, sent_s: float = inf
) -> float:
    answered_ns = round(since_s * S)
    sent_ns = answered_ns if sent_s == inf else round(sent_s * S)
    return found.may_take_s([Literal(atom) for atom in missing], sent_ns, answered_ns, PARTS, seen)


def test_a_start_may_take_twice_the_longest_of_the_latest_and_half_a_second_more_in_any_case() -> None:
    found = StartUps()
    assert found.may_take_ns("scan") is None
    started(found, DRIVER, SCAN, 100, 0.2)
    assert found.may_take_ns("scan") == round(0.2 * S) + LEAST_NS
    started(found, DRIVER, SCAN, 200, 3)
    assert found.may_take_ns("scan") == 2 * 3 * S
    for number in range(LATEST):
        started(found, DRIVER, SCAN, 300 + number * 10, 1)
    assert found.may_take_ns("scan") == 2 * 1 * S
    assert found.may_take_ns("echoes") is None


def test_a_start_that_a_planted_fault_held_up_until_it_was_undone_teaches_nothing() -> None:
    found = StartUps()
    started(found, DRIVER, SCAN, 100, 0.8)
    heard(
        found, news(Literal(SCAN, False), 120), news(Literal(DRIVER, False), 121), news(Literal(DRIVER), 122)
    )
    found.disturbed()
    heard(found, news(Literal(SCAN), 180))
    assert found.may_take_ns("scan") == round(2 * 0.8 * S)
    started(found, DRIVER, SCAN, 200, 2)  # of the next one it is learned again
    assert found.may_take_ns("scan") == 2 * 2 * S


def test_a_start_is_in_vain_after_twice_the_longest_and_its_observers_time() -> None:
    found = StartUps()
    assert left_s(found, Seen(), SCAN) == inf
    started(found, DRIVER, SCAN, 100, 0.8)
    assert left_s(found, Seen(), SCAN) == pytest.approx(1.6 + 0.5 + SLACK_NS / S)
    assert left_s(found, Seen(), SCAN, ECHOES, since_s=997) == pytest.approx(1.6 + 0.5 + SLACK_NS / S - 3)
    assert left_s(found, Seen(), ECHOES, DRIVER) == inf


def test_what_the_act_has_started_has_its_time_from_when_it_began() -> None:
    found = StartUps()
    started(found, DRIVER, SCAN, 100, 0.8)
    seen = Seen(rose={DRIVER: round(998.5 * S)})
    waits_s = 1.6 + 0.5 + SLACK_NS / S
    assert left_s(found, seen, SCAN, sent_s=998) == pytest.approx(waits_s - 1.5)
    assert left_s(found, seen, SCAN, sent_s=999) == pytest.approx(waits_s)  # it ran before
    started(found, MAPPING, MAP, 200, 2)
    both = Seen({**seen.values, SCAN: True}, {MAPPING: 995 * S, SCAN: 990 * S})
    assert left_s(found, both, MAP, sent_s=994) == pytest.approx(4 + 0.5 + SLACK_NS / S - 5)
    both.rose[SCAN] = round(999.5 * S)
    assert left_s(found, both, MAP, sent_s=994) == pytest.approx(4 + 0.5 + SLACK_NS / S - 0.5)


def test_what_needs_an_input_has_its_time_from_when_that_is_there() -> None:
    found = StartUps()
    started(found, MAPPING, MAP, 100, 2)
    seen = Seen()
    assert left_s(found, seen, MAP) == inf
    seen.values[SCAN] = True
    seen.rose[SCAN] = 1003 * S
    assert left_s(found, seen, MAP) == pytest.approx(3 + 4 + 0.5 + SLACK_NS / S)


def booted(scan_s: float, map_s: float, *, told_last: bool = False) -> StartUps:
    """Mapping was seen to begin at 100 s, with its input and its topic after that."""
    found, seen = StartUps(), Seen()
    heard(found, news(Literal(MAPPING, False), 90), news(Literal(MAPPING), 100), seen=seen)
    if not told_last:
        seen.rose[SCAN] = round((100 + scan_s) * S)
        heard(found, news(Literal(SCAN), 100 + scan_s), seen=seen)
    heard(found, news(Literal(MAP), 100 + map_s), seen=seen)
    if told_last:
        seen.rose[SCAN] = round((100 + scan_s) * S)
        heard(found, news(Literal(SCAN), 100 + scan_s), seen=seen)
    return found


@pytest.mark.parametrize("told_last", [False, True])
def test_to_what_an_input_held_up_only_the_time_after_the_input_is_added_again(told_last: bool) -> None:
    assert booted(1, 3, told_last=told_last).unwritten() == {"map": (StoredStart(3 * S, 2 * S, True),)}
    assert booted(1, 3, told_last=told_last).may_take_ns("map") == 5 * S
    assert booted(3.9, 4, told_last=told_last).may_take_ns("map") == 5 * S  # a quarter at least
    assert booted(-1, 3, told_last=told_last).unwritten() == {"map": (StoredStart(3 * S, 3 * S, False),)}
    assert booted(-1, 3, told_last=told_last).may_take_ns("map") == 6 * S


def test_a_start_after_one_that_was_given_up_has_twice_its_time(clock: SimpleNamespace) -> None:
    """Nobody knows that the one before was mute, and not only slow: the second is not given up too soon."""
    found = StartUps()
    started(found, DRIVER, SCAN, 100, 0.8)
    silent = Seen(rose={DRIVER: 200 * S})
    heard(found, news(Literal(DRIVER, False), 190), news(Literal(DRIVER), 200), seen=silent)
    heard(found, news(Literal(DRIVER, False), 203), news(Literal(DRIVER), 204), seen=silent)
    assert left_s(found, silent, SCAN) == pytest.approx(3.2 + 0.5 + SLACK_NS / S)
    heard(found, news(Literal(DRIVER, False), 205), news(Literal(DRIVER), 206), seen=silent)  # not its time
    assert left_s(found, silent, SCAN) == pytest.approx(3.2 + 0.5 + SLACK_NS / S)
    heard(found, news(Literal(SCAN), 208), seen=silent)
    assert found.may_take_ns("scan") == 4 * S  # it was seen what it takes


seconds = st.floats(0, 8).map(lambda given: round(given, 2))
CHECK_S, SILENCE_S = 0.05, 0.35


@given(
    begins_s=seconds,
    works_s=seconds,
    boots=st.lists(st.floats(-5, 20), min_size=1, max_size=3),
    restarted=st.booleans(),
    input_s=st.one_of(st.just(-5.0), st.floats(0, 10)),
    slower=st.floats(0.3, 1.2),
)
def test_no_start_is_called_in_vain_that_takes_at_most_a_fifth_longer(
    begins_s: float, works_s: float, boots: list[float], restarted: bool, input_s: float, slower: float
) -> None:
    """A node that begins for a while, and works for a while once its input is there; then both come again,
    or the input alone. Its observer looks all the time, and needs its settling time to say that it is well.
    """
    found, at_s = StartUps(), 100.0
    for scan_s in boots:
        seen = Seen(rose={SCAN: round((at_s + scan_s) * S)})
        heard(found, news(Literal(MAPPING, False), at_s - 1), news(Literal(MAPPING), at_s), seen=seen)
        heard(found, news(Literal(MAP), at_s + max(begins_s, scan_s) + works_s), seen=seen)
        at_s += 100
    input_s = input_s if restarted else max(0.0, input_s)
    begun_s = slower * begins_s if restarted else -400.0
    speaks_s = max(begun_s, input_s) + slower * works_s
    seen = Seen(rose={SCAN: round((1000 + input_s) * S), MAPPING: (1000 if restarted else 600) * S})
    seen.values[SCAN] = True
    settling_s = seen.delays(MAP).settling_ns / S
    clock = pytest.MonkeyPatch()
    for part in range(20):
        now_s = 1000 + max(0.0, input_s) + part / 20 * (speaks_s + settling_s - max(0.0, input_s))
        silent_s = now_s if now_s < 1000 + speaks_s else 1000 + speaks_s
        seen.looked[MAP] = round((silent_s + CHECK_S) * S)  # silence less than a check ago
        with clock.context() as patch:
            patch.setattr(start_ups, "CLOCK", SimpleNamespace(now_ns=lambda at_s=now_s: round(at_s * S)))
            assert left_s(found, seen, MAP) > 0
    # A mute one is known in the end, also by who is not heard again before.
    with clock.context() as patch:
        patch.setattr(start_ups, "CLOCK", SimpleNamespace(now_ns=lambda: 1100 * S))
        assert left_s(found, seen, MAP) < 0


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


# --- longer than is configured

SLOW = replace(
    PARTS,
    hardware={**PARTS.hardware, "lidar": replace(PARTS.hardware["lidar"], boot_s=60.0)},
    nodes={**PARTS.nodes, "mapping": replace(PARTS.nodes["mapping"], start_s=20.0)},
)


def due_s(found: StartUps, seen: Seen, *missing: Atom, parts: ComponentModel = PARTS) -> float:
    return found.due_s([Literal(atom) for atom in missing], 5.0, parts, seen)


def test_the_driver_of_a_device_of_known_boot_is_started_soon_after_it_and_later_where_that_was_in_vain() -> (
    None
):
    found = StartUps()
    found.publishers(SLOW)
    seen = Seen(rose={MAPPING: 1000 * S, DRIVER: 1000 * S, ON: 990 * S})
    assert found.drivable_ns("driver", SLOW, seen) == 990 * S + 60 * S * 9 // 8
    found.acted(Action("b", "start_node", ("driver",), 1.0), 1000 * S, 1000 * S)
    assert found.drivable_ns("driver", SLOW, seen) == (990 + 90) * S
    assert found.booting("driver", SLOW, seen) == ("lidar",)
    seen.values[ON] = False  # it has no power: nothing boots
    assert found.drivable_ns("driver", SLOW, seen) == 0


def test_who_still_sees_nothing_when_it_was_due_is_not_waited_for_until_it_would_have_judged(
    clock: SimpleNamespace,
) -> None:
    found = StartUps()
    seen = Seen(rose={DRIVER: 1000 * S})
    seen.delays = lambda atom: Delays(S, 20 * S)  # type: ignore[method-assign]  # a rate takes it long
    started(found, DRIVER, SCAN, 100, 4)
    assert due_s(found, seen, SCAN) == pytest.approx(6 + 20 + SLACK_NS / S)
    clock.time_ns = seen.looked[SCAN] = round(1006.9 * S)
    assert due_s(found, seen, SCAN) > 19
    clock.time_ns = seen.looked[SCAN] = 1007 * S  # silence is seen within a second
    assert due_s(found, seen, SCAN) <= 0
    seen.values[SCAN] = None  # type: ignore[assignment]  # something comes, and is being judged
    assert due_s(found, seen, SCAN) > 19


# --- at a boot


def test_a_node_that_began_by_itself_and_was_never_heard_has_as_long_as_a_boot_takes() -> None:
    node, found = PARTS.nodes["driver"], StartUps()
    assert found.at_boot_ns(node, 990 * S, PARTS, Seen()) == 0  # nobody saw it begin
    seen = Seen(rose={DRIVER: 990 * S})
    assert found.at_boot_ns(node, 990 * S, PARTS, seen) == BOOTS_NS
    seen.fell[SCAN] = 980 * S
    assert found.at_boot_ns(node, 990 * S, PARTS, seen) == 0  # it has only been started again
    seen.fell[SCAN] = 900 * S
    assert found.at_boot_ns(node, 990 * S, PARTS, seen) == BOOTS_NS


def test_what_is_known_of_boots_and_starts_is_what_they_have_at_a_boot() -> None:
    rail, lidar = PARTS.hardware["rail"], PARTS.hardware["lidar"]
    seen = Seen(rose={DRIVER: 990 * S, MAPPING: 990 * S})
    parts = replace(PARTS, hardware={"rail": replace(rail, boot_s=0.0), "lidar": replace(lidar, boot_s=40.0)})
    node = replace(PARTS.nodes["driver"], start_s=2.0)
    assert StartUps().at_boot_ns(node, 990 * S, parts, seen) == (60 + 3) * S
    assert StartUps().at_boot_ns(node, 990 * S, PARTS, seen) == BOOTS_NS  # of its device nothing is
    alone = replace(PARTS.nodes["mapping"], start_s=2.0)
    assert StartUps().at_boot_ns(alone, 990 * S, PARTS, seen) == 3 * S


def test_the_driver_of_a_device_of_unknown_boot_is_started_at_once_and_then_after_ever_longer() -> None:
    found, seen = StartUps(), Seen()
    found.acted(Action("a", "power_up", ("lidar",), 1.0), 999 * S, 999 * S)
    assert found.drivable_ns("driver", PARTS, seen) <= 1000 * S
    found.acted(Action("b", "start_node", ("driver",), 1.0), 1000 * S, 1000 * S)
    assert found.drivable_ns("driver", PARTS, seen) == 1000 * S + BOOTS_NS // OFTEN_BOOTED
    found.recall({"scan": [StoredStart(4 * S, 4 * S, True, True)]}, PARTS)  # it was seen with its power
    assert found.drivable_ns("driver", PARTS, seen) == 1000 * S + 6 * S
    found.recall({}, PARTS)
    found.acted(Action("b", "start_node", ("driver",), 1.0), 1000 * S, 1000 * S)
    assert found.drivable_ns("driver", PARTS, seen) == 1000 * S + BOOTS_NS
    assert found.booting("driver", PARTS, seen) == ("lidar",)
    assert found.all_booted_ns(PARTS, seen) == 1000 * S + BOOTS_NS
    found.acted(Action("c", "power_up", ("lidar",), 1.0), 1000 * S, 1000 * S)
    assert found.drivable_ns("driver", PARTS, seen) <= 1000 * S


@pytest.mark.parametrize("jump_s", [-3600, -30, 0, 30, 3600])
def test_a_clock_that_jumps_in_the_middle_of_a_boot_teaches_nothing_and_holds_nobody_up(
    jump_s: int, clock: SimpleNamespace
) -> None:
    found, seen = StartUps(), Seen(rose={ON: 999 * S})
    heard(
        found, news(Literal(SCAN, False), 999), news(Literal(DRIVER, False), 999), news(Literal(DRIVER), 1000)
    )
    heard(
        found, news(Literal(SCAN), 1004 + jump_s), late_s=-jump_s
    )  # 4 s later by a clock that does not jump
    assert found.may_take_ns("scan") == (8 * S if jump_s == 0 else None)
    clock.time_ns += max(0, jump_s) * S  # the service's own does not go back
    wait_s = (found.drivable_ns("driver", SLOW, seen) - clock.time_ns) / S
    assert wait_s <= 60 * 9 / 8
