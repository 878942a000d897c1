"""What was measured, beside each kind of verdict: as people are told it, and by which remedies are chosen."""

from __future__ import annotations

import json
from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path

import pytest
from tests.clients.observers.driving import SCAN, beat

from robomend_client.observers import (
    Answers,
    Band,
    BinaryQualitativeObserver,
    Change,
    DiagnosticObserver,
    Driver,
    FunctionObserver,
    GeneralObserver,
    HardwareObserver,
    MultipleObserver,
    NodeObserver,
    Observer,
    PropertyObserver,
    Publishers,
    QualitativeObserver,
    Rate,
    Trend,
    Wiring,
    ns,
)
from robomend_client.observers.base import Listener
from robomend_client.observers.kinds import read_observers
from robomend_client.readings import Reading, Symptom
from robomend_client.yaml_reader import read


def told(driver: Driver) -> dict[str, tuple[str, Symptom | None]]:
    """Return of each literal that stands what was measured."""
    found = {}
    for verdict in driver.standing():
        assert isinstance(verdict.reading, Reading), verdict
        found[str(verdict.literal)] = (str(verdict.reading), verdict.reading.symptom)
    return found


def of(observer: Observer, *samples: tuple[float, str, object], until_s: float = 0) -> dict[str, object]:
    driver = Driver([observer], 0)
    for at_s, source, value in samples:
        driver.sample(source, ns(at_s), value, ns(at_s))
    driver.advance(max(driver.now_ns, ns(until_s)))
    return dict(told(driver))


@pytest.mark.parametrize(
    ("above_hz", "hz", "reading"),
    [
        (2, 50, ("not ok(scan)", ("50 Hz, 10 ± 2", Symptom.FAST))),
        (2, 10, ("ok(scan)", ("10 Hz, 10 ± 2", None))),
        (2, 6, ("not ok(scan)", ("6 Hz, 10 ± 2", Symptom.SLOW))),
        (6, 6, ("not ok(scan)", ("6 Hz, 10 (8 to 16)", Symptom.SLOW))),
    ],
)
def test_a_rate_says_in_which_direction_it_is_wrong(
    above_hz: float, hz: float, reading: tuple[str, tuple[str, Symptom | None]]
) -> None:
    driver = Driver([GeneralObserver("scan", Rate(10, 2, tolerance_above_hz=above_hz))], 0)
    beat(driver, "scan", 0.1, 100, hz)
    assert told(driver) == dict([reading])


def test_a_silence_says_for_how_long_and_goes_on_over_a_reset() -> None:
    driver = Driver([GeneralObserver("scan", Rate(10, 2))], 0)
    beat(driver, "scan", 0.1, 20)  # the last one at 2.0 s
    driver.advance(ns(4.1))
    assert told(driver) == {"not ok(scan)": ("0 of 10 Hz for 2.1 s", Symptom.SILENT)}
    driver.settle(1, [SCAN])
    driver.advance(ns(9))
    assert told(driver) == {"not ok(scan)": ("0 of 10 Hz for 7 s", Symptom.SILENT)}
    beat(driver, "scan", 9.5, 3)  # too few to say how fast it is
    assert told(driver) == {"not ok(scan)": ("0 of 10 Hz for 7.5 s, then heard again", Symptom.SILENT)}


def test_a_second_publisher_is_the_first_suspect_of_a_rate_that_is_too_fast() -> None:
    driver = Driver([GeneralObserver("odom", Rate(10, 2))], 0)
    driver.publishers("odom", ["/odom_a", "/odom_b"], 0)
    beat(driver, "odom", 0.1, 100, 20)
    said = "20 Hz, 10 ± 2; publishers: /odom_a, /odom_b"
    assert told(driver) == {"not ok(odom)": (said, Symptom.PUBLISHERS)}
    driver.publishers("odom", [], driver.now_ns)
    driver.advance(driver.now_ns + ns(1))
    assert list(told(driver).values()) == [("0 of 10 Hz for 1 s, nobody publishes it", Symptom.SILENT)]


def numbers(source: str, *values: float) -> Sequence[tuple[float, str, object]]:
    return [(k / 10, source, value) for k, value in enumerate(values)]


def test_other_kinds_say_what_they_measured() -> None:
    pack = PropertyObserver("pack", "board:voltage(0)", Band(low=22))
    assert of(pack, (0, "board:voltage(0)", 19.1)) == {"not ok(pack)": ("19.1 V, at least 22", Symptom.VALUE)}
    hot = PropertyObserver("hot", "m:t", Band(low=5, high=60, unit="°C"))
    assert of(hot, (0, "m:t", 50.0)) == {"ok(hot)": ("50 °C, 5 to 60", None)}
    mine = FunctionObserver(lambda word: word == "up", "mine", "m:mode")
    assert of(mine, (0, "m:mode", "down")) == {"not ok(mine)": ("down", Symptom.VALUE)}
    status = {"name": "hokuyo: connection", "level": 2, "message": "no data", "values": {"t": "80"}}
    device = DiagnosticObserver("hokuyo", ["hokuyo*"], ["t < 40"])
    assert of(device, (0, "diagnostics", [status])) == {
        "not ok(hokuyo)": ("hokuyo: connection: ERROR no data", Symptom.SELF_REPORT),
        "not ok(t)": ("80, < 40", Symptom.SELF_REPORT),
    }
    answers = MultipleObserver("ok(map)", "scan", "map", Answers(within_s=0.5))
    assert of(answers, (1, "scan", None), until_s=1.7) == {
        "not ok(map)": ("no answer for 0.7 s, at most 0.5", Symptom.SILENT)
    }
    board = HardwareObserver({"motor": Wiring(0, 3.0)})
    weak = [(k / 5, "board", [{"on": True, "current_a": 1.0}]) for k in range(10)]
    assert of(board, *weak) == {
        "on(motor)": ("on", None),
        "not ok(current,motor)": ("1 A, 3 ± 0.75", Symptom.VALUE),
    }


def test_a_value_that_stands_still_is_named_and_one_that_moves_otherwise_is_not() -> None:
    still = QualitativeObserver("yaw", "odom:yaw", Trend(check_s=0))
    assert of(still, *numbers("odom:yaw", *([0.42] * 20)))["const(yaw)"] == (
        "stands still at 0.42",
        Symptom.STILL,
    )
    moving = QualitativeObserver("yaw", "odom:yaw", Trend(check_s=0))
    assert of(moving, *numbers("odom:yaw", *(k / 5 for k in range(20))))["inc(yaw)"] == (
        "2 per s, ± 0.05 is const",
        None,
    )
    match = BinaryQualitativeObserver("matched(a,b)", "odom:a", "imu:b")
    samples = [
        (k / 10, source, value) for k in range(100) for source, value in (("odom:a", k / 10), ("imu:b", 0.42))
    ]
    assert of(match, *samples) == {
        "not matched(a,b)": ("imu:b stands still at 0.42, odom:a does not", Symptom.STILL)
    }


def test_a_node_says_why_it_does_not_run_as_far_as_its_feeder_knows() -> None:
    why = {"why": "exit code 1: cannot open /dev/lidar", "symptom": "ended"}
    table = {"a": why, "b": True, "c": None}
    nodes = NodeObserver(["a", "b", "c", "d"])
    assert of(nodes, (0, "processes", table)) == {
        "not running(a)": ("exit code 1: cannot open /dev/lidar", Symptom.ENDED),
        "running(b)": ("runs", None),
        "not running(d)": ("not there", Symptom.ENDED),
    }


def test_a_reading_that_changes_is_no_news() -> None:
    driver = Driver([PropertyObserver("pack", "b:v", Band(low=22)), GeneralObserver("scan", Rate(10, 2))], 0)
    changes: list[Change] = []
    for k in range(100):
        changes += driver.sample("b:v", ns(k / 10), 19 + k / 1000, ns(k / 10))
    changes += driver.advance(ns(20))
    assert [str(change.value) for change in changes if change.value is not None] == [
        "not ok(pack)",
        "not ok(scan)",
    ]


def _times(source: str, value: object, many: int = 40, hz: float = 10) -> list[tuple[float, str, object]]:
    return [(k / hz, source, value) for k in range(many)]


GOAL = {"goal_info": {"goal_id": {"uuid": [1] * 16}, "stamp": {"sec": 0, "nanosec": 0}}, "status": 6}
T0 = 1_764_000_000
UP_AND_DOWN = ["configuring", "inactive", "activating", "active", "deactivating", "inactive"]

Samples = list[tuple[float, str, object]]

BAD: dict[str, tuple[str, dict[str, object], Samples]] = {
    "general": ("scan", {}, _times("scan", None, 10, 1)),
    "node": ("n", {}, _times("processes", [])),
    "diagnostic": (
        "d",
        {"status": ["d*"]},
        _times("diagnostics", [{"name": "d: x", "level": 2, "message": "no data", "values": {}}]),
    ),
    "multiple": ("a", {"in_topic": "ask", "out_topic": "answer"}, [(0, "ask", None), (3, "else", None)]),
    "qualitative": ("x", {"source": "o:x"}, _times("o:x", 0.42)),
    "binary_qualitative": (
        "matched(x,y)",
        {"first": "o:x", "second": "i:y"},
        [(k / 10, s, k / 10 if s == "o:x" else 0.42) for k in range(100) for s in ("o:x", "i:y")],
    ),
    "hardware": (
        "board",
        {"wiring": {"motor": {"channel": 0, "expected_current_a": 3.0}}},
        _times("board", [{"on": True, "current_a": 1.0}]),
    ),
    "property": ("p", {"source": "b:v", "low": 22, "unit": "V"}, _times("b:v", 19.1)),
    "goals": ("ok(goals,dock)", {}, [(1, "dock/_action/status:status_list[-64:]", [GOAL])]),
    "rosout": (
        "ok(log,camera)",
        {},
        [(1, "rosout:level,name,msg", {"level": 40, "name": "camera", "msg": "no device"})],
    ),
    "lifecycle": (
        "ok(lifecycle,camera)",
        {"source": "s"},
        [
            (k, "s", {"start_state.label": before, "goal_state.label": state})
            for k, (before, state) in enumerate(pairwise(UP_AND_DOWN))
        ],
    ),
    "changing": ("ok(moves,imu)", {"source": "i:z"}, _times("i:z", 0.42, 200)),
    "age": (
        "ok(age,scan)",
        {"source": "s"},
        [(T0 + k / 10, "s", {"sec": T0 - 60, "nanosec": 0}) for k in range(40)],
    ),
    "publishers": ("ok(publishers,odom)", {}, [(0, "odom", Publishers(("/a", "/b"))), (5, "odom", None)]),
    "qos": ("ok(qos,scan)", {}, _times("mismatches", {"scan": "/a offers less than /b asks for"})),
    "restarts": ("ok(restarts,laser)", {}, [(k, "processes", {"laser": k % 2 == 0}) for k in range(12)]),
}
"""Of each kind: the name and the keys of one in an agent's file, and what is bad to it."""


def bad_of(kind: str, folder: Path, listener: Listener | None = None) -> tuple[Path, dict[str, Reading]]:
    """Return an agent's file with an observer of this kind, and what it measured as literals turned bad."""
    name, keys, samples = BAD[kind]
    file = folder / "agent.yaml"
    file.write_text(json.dumps({"observers": {name: {"kind": kind, **keys}}}))
    [spec] = read_observers(read(file), folder)
    listeners = () if listener is None else (listener,)
    driver = Driver([spec.make()], ns(samples[0][0]), listeners=listeners)
    changes: list[Change] = []
    for at_s, source, value in samples:
        if isinstance(value, Publishers):
            changes += driver.publishers(source, value.nodes, ns(at_s))
        else:
            changes += driver.sample(source, ns(at_s), value, ns(at_s))
    changes += driver.advance(ns(samples[-1][0] + 0.05))
    found: dict[str, Reading] = {}
    for change in changes:
        if change.reading is not None and change.reading.symptom is not None:
            found.setdefault(str(change.value), change.reading)
    return file, found
