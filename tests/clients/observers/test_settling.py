"""After a reset: bad data never look good first, nor good ones bad; and either verdict comes in the time that
its observer declares, and not before the other one could have come.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from pathlib import Path

import pytest
from tests.clients.observers.test_kinds import EVERY_KIND, specs

from robomend_client.observers import Change, Driver, Publishers, ns
from robomend_client.observers.kinds import KINDS, ObserverSpec

Sample = tuple[float, str, object]
Stream = Callable[[float], Iterator[Sample]]
"""From a time on, for ever: when, source, value."""


def each(
    hz: float, source: str, value: Callable[[float], object] = lambda t: None, late_s: float = 0
) -> Stream:
    def samples(from_s: float) -> Iterator[Sample]:
        k = 0
        while True:
            at_s = from_s + (k + 0.3) / hz + late_s
            yield at_s, source, value(at_s)
            k += 1

    return samples


def together(*streams: Stream) -> Stream:
    def samples(from_s: float) -> Iterator[Sample]:
        running = [stream(from_s) for stream in streams]
        heads = [next(one) for one in running]
        while True:
            first = min(range(len(heads)), key=lambda n: heads[n][0])
            yield heads[first]
            heads[first] = next(running[first])

    return samples


def nothing(from_s: float) -> Iterator[Sample]:
    k = 0
    while True:  # of another source: time passes
        yield from_s + 0.1 * k, "", None
        k += 1


def status(level: int, hot: str = "20") -> Callable[[float], object]:
    return lambda t: {"name": "hokuyo: connection", "level": level, "values": {"temperature": hot}}


def current(amperes: float) -> Callable[[float], object]:
    return lambda t: [{"on": True, "current_a": amperes}] * 8


def off(t: float) -> object:
    return [{"on": False, "current_a": 0.0}] * 8


def other_status(level: int) -> Stream:
    value = {"name": "hokuyo: laser", "level": level, "values": {}}
    return each(1, "diagnostics", lambda t: value, late_s=0.6)


ask, answer = each(2, "scan"), each(2, "map", late_s=0.05)
CASES: dict[str, tuple[str, Stream, Mapping[str, Stream]]] = {
    "scan": (
        "ok(scan)",
        each(20, "scan"),
        {
            "silent": nothing,
            "a little too slow": each(17, "scan"),
            "slow": each(9, "scan"),
            "nearly silent": each(3, "scan"),
            "a little too fast": each(23, "scan"),
            "two publishers": together(each(20, "scan"), each(20, "scan", late_s=0.003)),
        },
    ),
    "hokuyo_node": (
        "running(hokuyo_node)",
        each(10, "processes", lambda t: ["hokuyo_node"]),
        {"gone": each(10, "processes", lambda t: [])},
    ),
    "hokuyo": (
        "ok(hokuyo)",
        together(each(1, "diagnostics", status(0)), other_status(0)),
        {
            "error": together(each(1, "diagnostics", status(2)), other_status(0)),
            "the other one": together(each(1, "diagnostics", status(0)), other_status(2)),
        },
    ),
    "hokuyo: rule": (
        "ok(temperature)",
        each(1, "diagnostics", status(0)),
        {"hot": each(1, "diagnostics", status(0, "80"))},
    ),
    "map_triggered": (
        "ok(map_triggered)",
        together(ask, answer),
        {"no answer": ask, "late": together(ask, each(2, "map", late_s=0.3))},
    ),
    "yaw": (
        "const(yaw)",
        each(10, "odom:yaw", lambda t: 1.0),
        {"rising": each(10, "odom:yaw", lambda t: t), "falling": each(10, "odom:yaw", lambda t: -t)},
    ),
    "matched(a,b)": (
        "matched(a,b)",
        together(each(10, "odom:a", lambda t: t), each(10, "imu:b", lambda t: 2 * t)),
        {"still": together(each(10, "odom:a", lambda t: t), each(10, "imu:b", lambda t: 3.0))},
    ),
    "board": ("ok(current,jaguar)", each(5, "board", current(3)), {"weak": each(5, "board", current(1))}),
    "board: on": ("on(jaguar)", each(5, "board", current(3)), {"off": each(5, "board", off)}),
    "ok(CPU,laser)": (
        "ok(CPU,laser)",
        each(1, "processes:CPU(laser)", lambda t: 0.2),
        {"busy": each(1, "processes:CPU(laser)", lambda t: 0.95)},
    ),
}
STATUS = "dock/_action/status:status_list[-64:]"


def goal(status: int) -> Callable[[float], object]:
    return lambda t: [{"goal_info": {"goal_id": {"uuid": [int(10 * t) % 256] * 16}}, "status": status}]


def line(level: int) -> Callable[[float], object]:
    return lambda t: {"level": level, "name": "camera", "msg": f"at {t:.1f}"}


def moved(start: str, goal: str) -> Callable[[float], object]:
    return lambda t: {"start_state.label": start, "goal_state.label": goal}


def every_other(t: float) -> object:
    return ["laser"] if int(10 * t) % 2 else []


MOVES = "camera/transition_event:start_state.label,goal_state.label"
CASES |= {
    "ok(goals,dock)": (
        "ok(goals,dock)",
        each(1, STATUS, goal(4)),
        {"aborted": each(1, STATUS, goal(6))},
    ),
    "ok(log,camera)": (
        "ok(log,camera)",
        each(1, "rosout:level,name,msg", line(20)),
        {
            "ERROR": each(1, "rosout:level,name,msg", line(40)),
            "ERROR of ROS 1": each(1, "rosout:level,name,msg", line(8)),
        },
    ),
    "ok(lifecycle,camera)": (
        "ok(lifecycle,camera)",
        each(2, MOVES, moved("activating", "active")),
        {"deactivated": each(2, MOVES, moved("active", "deactivating"))},
    ),
    "ok(moves,imu)": (
        "ok(moves,imu)",
        each(10, "imu:z", lambda t: t),
        {"frozen": each(10, "imu:z", lambda t: 0.42)},
    ),
    "ok(publishers,odom)": (
        "ok(publishers,odom)",
        each(1, "odom", lambda t: Publishers(("/odom_a",))),
        {
            "two": each(1, "odom", lambda t: Publishers(("/odom_a", "/odom_b"))),
            "none": each(1, "odom", lambda t: Publishers(())),
        },
    ),
    "ok(qos,scan)": (
        "ok(qos,scan)",
        each(1, "mismatches", lambda t: {}),
        {"does not fit": each(1, "mismatches", lambda t: {"scan": "a publishes best effort, …"})},
    ),
    "ok(restarts,laser)": (
        "ok(restarts,laser)",
        each(10, "processes", lambda t: ["laser"]),
        {"crashes": each(10, "processes", every_other)},
    ),
}
EACH = [(name, bad) for name, (_, _, bads) in CASES.items() for bad in bads]


def first_after_reset(
    spec: ObserverSpec, atom_text: str, before: Stream, after: Stream, reset_s: float
) -> Change:
    """Return the first verdict after a reset, of data that are other from then on."""
    driver = Driver([spec.make()], 0)
    (atom,) = (atom for atom in driver.atoms if str(atom) == atom_text)
    found: list[Change] = []
    for stream, from_s, to_s in ((before, 0.0, reset_s), (after, reset_s, reset_s + 60)):
        if from_s:
            found += driver.advance(ns(from_s))
            found += driver.settle(1, [atom])
        for at_s, source, value in stream(from_s):
            if at_s >= to_s or any(one.settled == 1 and one.value is not None for one in found):
                break
            found += driver.sample(source, ns(at_s), value, ns(at_s))
            found += driver.advance(ns(at_s))
    return next(one for one in found if one.settled == 1 and one.value is not None)


@pytest.fixture
def known(tmp_path: Path) -> dict[str, ObserverSpec]:
    return {spec.name: spec for spec in specs(tmp_path, EVERY_KIND)}


def test_every_kind_is_walked(known: dict[str, ObserverSpec]) -> None:
    walked = {name.partition(": ")[0] for name in CASES}
    # Stamps of the first seconds of all are of no clock: see test_freshness.py.
    assert {spec.kind for name, spec in known.items() if name in walked} == {*KINDS.names()} - {"age"}


@pytest.mark.parametrize("reset_s", [20.0, 20.17, 20.73])
@pytest.mark.parametrize(("name", "bad"), EACH, ids=[f"{name}, {bad}" for name, bad in EACH])
def test_the_first_verdict_after_a_reset_is_right_and_in_time(
    known: dict[str, ObserverSpec], name: str, bad: str, reset_s: float
) -> None:
    atom, good, bads = CASES[name]
    spec = known[name.partition(": ")[0]]
    settling_s = spec.make().settling_s
    turned = first_after_reset(spec, atom, good, bads[bad], reset_s)
    mended = first_after_reset(spec, atom, bads[bad], good, reset_s)
    assert str(turned.value) == f"not {atom}"
    assert str(mended.value) == atom
    for change in (turned, mended):
        assert (change.time_ns - ns(reset_s)) / 1e9 <= settling_s + 0.02
        assert change.since_ns is not None
        assert change.since_ns >= ns(reset_s)


@pytest.mark.parametrize("name", CASES)
def test_a_good_verdict_waits_until_a_bad_one_could_have_come(
    known: dict[str, ObserverSpec], name: str
) -> None:
    atom, good, bads = CASES[name]
    spec = known[name.partition(": ")[0]]
    some = next(iter(bads.values()))
    good_ns = first_after_reset(spec, atom, some, good, 20.0).time_ns
    bad_ns = min(first_after_reset(spec, atom, good, bad, 20.0).time_ns for bad in bads.values())
    waited_ns = min(ns(next(bad(20.0))[0] - 20.0) for bad in bads.values())  # for something to judge
    assert good_ns >= bad_ns - waited_ns - ns(0.02)
