"""What robots say of themselves, in recordings: the same observers, with their words in the report."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

import pytest
from rosbags.rosbag1 import Writer as Writer1
from tests.robomend_batch.recordings import EPOCH_NS, ROS1, Recorder
from tests.robomend_batch.running import batch_run, logs, spans

from robomend.cli.commands import run
from robomend_batch.commands import batch
from robomend_client.observers.base import SECOND

MODEL = """
robomend: 1
name: rover
nodes: {navigator: {publishes: {imu: []}}, camera: {}}
properties: {goals: {}, log: {}, moves: {}, age: {}, lifecycle: {}}
rules:
  - "not ab(navigator) -> ok(goals,navigator)"
  - "not ab(camera) -> ok(log,camera)"
  - "not ab(camera) -> ok(lifecycle,camera)"
  - "not ab(navigator) -> ok(moves,navigator) and ok(age,navigator)"
"""

OBSERVERS = """
observers:
  "ok(goals,navigator)": {kind: goals, action: dock, hold_s: 20%s}
  "ok(log,camera)": {kind: rosout, hold_s: 2}
  "ok(moves,navigator)": {kind: changing, source: "imu:angular_velocity.z", still_s: 3}
  "ok(age,navigator)": {kind: age, topic: imu}
"""

LIFECYCLE = '  "ok(lifecycle,camera)": {kind: lifecycle}\n'


def stamp(at_s: float) -> dict[str, int]:
    return {"sec": EPOCH_NS // SECOND + int(at_s), "nanosec": int(at_s % 1 * 1e9)}


def goals(record: Recorder, told: Iterable[tuple[float, int, str]]) -> None:
    """Goals end at these times: succeeded, aborted, cancelled."""
    for at_s, number, end in told:
        if record.cdr:
            status = {"succeeded": 4, "cancelled": 5, "aborted": 6}[end]
            info = {"goal_id": {"uuid": [number] * 16}, "stamp": stamp(at_s)}
            record(
                at_s, "/dock/_action/status", "action_msgs/msg/GoalStatusArray",
                status_list=[{"goal_info": info, "status": status}],
            )  # fmt: skip
        else:
            status = {"succeeded": 3, "cancelled": 2, "aborted": 4}[end]
            goal = {
                "goal_id": {"id": f"g{number}", "stamp": stamp(at_s)},
                "status": status,
                "text": "no plan",
            }
            record(at_s, "/dock/status", "actionlib_msgs/msg/GoalStatusArray", status_list=[goal])


def drive(record: Recorder, *, faulty: bool) -> None:
    """Half a minute; from 10 s on one thing after the other goes wrong, if that is wanted."""
    for n in range(300):
        at_s = n / 10
        frozen = faulty and 15 <= at_s < 20
        old_s = 7200 if faulty and 22 <= at_s < 24 else 0
        record(
            at_s, "/imu", "sensor_msgs/msg/Imu",
            header={"stamp": stamp(at_s - old_s)},
            angular_velocity={"z": 0.42 if frozen else at_s},
        )  # fmt: skip
        log = "rcl_interfaces/msg/Log" if record.cdr else "rosgraph_msgs/msg/Log"
        info, error = (20, 40) if record.cdr else (2, 8)
        level = error if faulty and n == 120 else info
        record(at_s, "/rosout", log, level=level, name="/camera", msg="cannot open /dev/video0", line=n)
    ends = ((5, 1, "succeeded"), (6, 2, "cancelled"), (10, 3, "aborted" if faulty else "succeeded"))
    goals(record, (*ends, (11.5, 4, "succeeded")))
    if record.cdr:
        at_s = 1
        moves = [("unconfigured", "configuring"), ("configuring", "inactive"), ("activating", "active")]
        for start, goal in [*moves, *([("active", "errorprocessing"), *moves] if faulty else [])]:
            at_s = 26 if start == "active" else 27 if at_s >= 26 else 1
            record(
                at_s, "/camera/transition_event", "lifecycle_msgs/msg/TransitionEvent",
                start_state={"label": start}, goal_state={"label": goal},
            )  # fmt: skip


@pytest.fixture(params=["a.bag", "a.mcap", "a.db3"])
def record(request: pytest.FixtureRequest, tmp_path: Path) -> Recorder:
    return Recorder(tmp_path / request.param)


def diagnosed(record: Recorder) -> Path:
    folder = record.file.parent
    (folder / "rover.yaml").write_text(MODEL)
    preset = "" if record.cdr else ", preset: ros1"
    (folder / "agent.yaml").write_text(OBSERVERS % preset + (LIFECYCLE if record.cdr else ""))
    given = record.write(), "--observers", folder / "agent.yaml"
    out = folder / "out"
    assert batch_run(out, *given, model=folder / "rover.yaml") == 0
    return out


def test_each_kind_of_evidence_is_found_in_a_recording_with_its_words(
    record: Recorder, tmp_path: Path
) -> None:
    drive(record, faulty=True)
    out = diagnosed(record)
    (log,) = logs(out)
    found = {
        one["literal"]: ((one["time_ns"] - EPOCH_NS) / SECOND, one["reading"]) for one in log["readings"]
    }
    why = "" if record.cdr else ": no plan"
    wanted = {
        "not ok(goals,navigator)": (10.0, f"goal aborted{why}"),
        "not ok(log,camera)": (12.0, "ERROR: cannot open /dev/video0"),
        "not ok(moves,navigator)": (18.0, "angular_velocity.z stands still at 0.42 since 16:00:15 UTC"),
        "not ok(age,navigator)": (22.2, "stamp 2 h behind, at most 2 s"),
    }
    if record.cdr:
        wanted["not ok(lifecycle,camera)"] = (26.0, "errorprocessing, not active")
    assert found.keys() == wanted.keys()
    for literal, (at_s, told) in wanted.items():
        assert told in found[literal][1]
        assert abs(found[literal][0] - at_s) < 0.15, literal
    blamed = {name for *_, bad in spans(out) for one in bad or () for name in one}
    assert blamed == {"navigator", "camera"}
    assert run(["report", str(out), "--file", str(tmp_path / "report.html")], batch) == 0
    page = (tmp_path / "report.html").read_text()
    assert "not ok(log,camera): ERROR: cannot open /dev/video0" in page


def test_usual_traffic_in_a_recording_is_no_fault(record: Recorder) -> None:
    drive(record, faulty=False)
    out = diagnosed(record)
    (log,) = logs(out)
    assert log["readings"] == []
    assert "faulty" not in log["intervals"]
    assert log["intervals"]["healthy"] >= 1


MEETING = """
robomend: 1
name: rover
nodes: {base: {publishes: {odom: []}}}
properties: {publishers: {}, qos: {}}
rules: ["not ab(base) -> ok(publishers,odom) and ok(qos,odom)"]
"""


def met(file: Path, *callers: str) -> Path:
    """Write 60 s of odometry by the first of these, and from 45 s on by the last; where there are three, the
    second joins from 20 to 30 s.
    """
    with Writer1(file) as writer:
        made = {
            name: writer.add_connection("/odom", "std_msgs/msg/String", typestore=ROS1, callerid=name or None)
            for name in dict.fromkeys(callers)
        }
        of = [made[name] for name in callers]
        body = ROS1.serialize_ros1(ROS1.types["std_msgs/msg/String"]("x"), "std_msgs/msg/String")
        for n in range(600):
            at_ns = EPOCH_NS + n * SECOND // 10
            writer.write(of[0 if n < 450 else -1], at_ns, body)
            if len(of) > 2 and 200 <= n < 300 and n % 2:
                writer.write(of[1], at_ns + 1, body)
    return file


@pytest.mark.parametrize(
    ("callers", "bad"),
    [
        (("/base", "/ghost", "/base"), (21.1, 40.9)),
        (("/base_12_1700000000000", "/base_77_1700000099999"), None),
        (("/base",), None),
    ],
)
def test_a_bag_of_ros_1_says_who_publishes(
    callers: tuple[str, ...], bad: tuple[float, float] | None, tmp_path: Path
) -> None:
    (tmp_path / "rover.yaml").write_text(MEETING)
    (tmp_path / "agent.yaml").write_text('observers: {"ok(publishers,odom)": {kind: publishers}}\n')
    given = met(tmp_path / "a.bag", *callers), "--observers", tmp_path / "agent.yaml"
    assert batch_run(tmp_path / "out", *given, model=tmp_path / "rover.yaml") == 0
    begin = EPOCH_NS / SECOND
    faulty = [
        (start - begin, end - begin) for start, end, state, _ in spans(tmp_path / "out") if state == "faulty"
    ]
    (log,) = logs(tmp_path / "out")
    if bad is None:
        assert (faulty, log["readings"]) == ([], [])
        assert log["span_ns"]["healthy"] > 55 * SECOND
    else:
        ((start, end),) = faulty
        assert abs(start - bad[0]) < 0.2
        assert abs(end - bad[1]) < 1.5
        assert log["readings"][0]["reading"] == "2 publishers: /base, /ghost, at most 1"


def test_what_no_recording_says_of_the_graph_is_unknown_and_said(tmp_path: Path) -> None:
    (tmp_path / "rover.yaml").write_text(MEETING)
    (tmp_path / "agent.yaml").write_text(
        'observers: {"ok(publishers,odom)": {kind: publishers}, "ok(qos,odom)": {kind: qos}}\n'
        "topics: {odom: {rate_hz: 10, tolerance_hz: 3}}\n"
    )
    record = Recorder(tmp_path / "a.mcap")
    for n in range(100):
        record(n / 10, "/odom", "std_msgs/msg/String", data="x")
    for log in (met(tmp_path / "a.bag", ""), record.write()):
        out = tmp_path / f"out-{log.suffix}"
        given = log, "--observers", tmp_path / "agent.yaml"
        assert batch_run(out, *given, model=tmp_path / "rover.yaml") == 0
        (told,) = logs(out)
        assert {one["place"].removeprefix(f"{log}: "): one["reason"] for one in told["problems"]} == {
            "ok(publishers,odom)": "this recording does not say who publishes it; those of ROS 1 do: "
            "it is unknown",
            "ok(qos,odom)": "no recording has the qualities of service of who listens: it is unknown",
        }
        assert told["state"] == "ok"
