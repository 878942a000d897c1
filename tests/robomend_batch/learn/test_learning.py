"""`robomend-batch learn`: from healthy drives of a robot that nobody described to diagnoses of others."""

from __future__ import annotations

import random
import re
import struct
from dataclasses import dataclass
from pathlib import Path

import pytest
from mcap.writer import Writer
from rosbags.rosbag1 import Writer as BagWriter
from tests.robomend_batch.recordings import EPOCH_NS, KINDS, ROS1, message, steady, write
from tests.robomend_batch.running import batch_run, intervals, ndjson
from tests.ros2 import robot as ros2_robot

from robomend.cli.commands import run as robomend
from robomend.model.answers import questions_of
from robomend.model.loading import load_model
from robomend_batch.commands import batch
from robomend_batch.learn.learning import learn as learned
from robomend_batch.observing import load_observers
from robomend_bench.batch import drives
from robomend_bench.batch.drives import Planted, Robot, Source
from robomend_bench.batch.learning import Score, rate
from robomend_client.observers.base import SECOND
from robomend_client.ros_graph import RosGraph

MINUTES = 8

ROBOT = Robot(
    "mapper",
    (
        Source("base_node", "odom", 8.0, 0.003, 0, 0.3, True, True, turn=True),
        Source("imu_node", "gyro", 10.0, 0.002, 4, 0.3, False, True, turn=True),
        Source("lidar_node", "scan", 5.0, 0.008, 4, 0.3, False, True),
        Source("mapper", "map", 5.0, 0.0, 0, 0.3, True, True, asks="scan", takes_s=0.02),
    ),
    "lidar_node",
    45.0,
)


def learn(*given: object) -> int:
    return robomend(["learn", *map(str, given)], batch)


@dataclass(frozen=True)
class Draft:
    folder: Path

    @property
    def model(self) -> Path:
        return self.folder / "model.yaml"

    @property
    def observers(self) -> Path:
        return self.folder / "observers.yaml"

    @property
    def text(self) -> str:
        return self.observers.read_text()


@pytest.fixture(scope="module")
def good(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    """Two healthy drives."""
    folder = tmp_path_factory.mktemp("good")
    return [drives.write(folder / f"{seed}.bag", ROBOT, seed, 60 * MINUTES) for seed in (1, 2)]


@pytest.fixture(scope="module")
def draft(good: list[Path], tmp_path_factory: pytest.TempPathFactory) -> Draft:
    folder = tmp_path_factory.mktemp("learned") / "draft"
    assert learn(*good, "-o", folder, "--name", "mapper", "--quiet") == 0
    return Draft(folder)


def test_the_draft_passes_model_check_and_has_who_publishes_and_who_listens(
    draft: Draft, capsys: pytest.CaptureFixture[str]
) -> None:
    assert robomend(["model", "check", str(draft.model)]) == 0
    assert "mapper: component model, 4 components" in capsys.readouterr().out
    text = draft.model.read_text()
    assert re.search(r"map: \[scan\]    # std_msgs/Float64; comes \S+ ms after scan \(intervals alike", text)
    assert "does map rest on scan?" in questions_of(text).others
    assert "  lidar_node:    # listens to nothing: probably a driver; of which device?" in text
    assert set(questions_of(text).drivers) == {"base_node", "imu_node", "lidar_node"}
    assert "related:\n  - [gyro_data, odom_data]" in text


def test_each_observer_stands_beside_its_evidence_and_the_false_alarms_that_were_measured(
    draft: Draft,
) -> None:
    names = {spec.name for spec in load_observers(draft.observers).specs}
    assert names == {
        *("odom", "gyro", "scan", "map"),
        *("map_triggered", "matched(gyro_data,odom_data)", "lidar_node_device"),
        *(f"{topic}_data_range" for topic in ("odom", "gyro", "scan", "map")),
    }
    assert draft.text.count("  # held back: 0 false alarms in 0.0603 h") == len(names)
    assert "# Meant: at most 0.1 false alarms an hour of all 11 observers together." in draft.text
    assert "# Measured over what was held back: 0 false alarms in 0.0603 h." in draft.text
    assert "not judged: serial: always 4711" in draft.text


def test_a_healthy_drive_shows_nothing_and_planted_faults_are_found(draft: Draft, tmp_path: Path) -> None:
    planted = [
        Planted("silent", "base_node", 60, 110),
        Planted("late", "mapper", 180, 230),
        Planted("slow", "lidar_node", 300, 350),
        Planted("hot", "lidar_node", 420, 470),
    ]
    healthy = drives.write(tmp_path / "healthy.bag", ROBOT, 3, 60 * MINUTES)
    faulty = drives.write(tmp_path / "faulty.bag", ROBOT, 4, 540, planted)
    out = tmp_path / "out"
    assert batch_run(out, healthy, faulty, "--observers", draft.observers, model=draft.model) == 0
    told = intervals(out)
    assert [one for one in told if one["log"] == str(healthy) and one["state"] == "faulty"] == []
    score = Score()
    rate(score, [one for one in told if one["log"] == str(faulty)], planted)
    assert score.found == score.planted
    assert score.alone == score.planted
    assert score.stray == 0


def test_a_value_that_stands_still_is_suspected(draft: Draft, tmp_path: Path) -> None:
    planted = [Planted("frozen", "imu_node", 60, 120)]
    log = drives.write(tmp_path / "frozen.bag", ROBOT, 5, 180, planted)
    assert batch_run(tmp_path / "out", log, "--observers", draft.observers, model=draft.model) == 0
    bad = [one["bad"] for one in intervals(tmp_path / "out") if one["state"] == "faulty"]
    assert bad
    assert all(sorted(diagnoses) == [["base_node"], ["imu_node"]] for diagnoses in bad)


def test_a_log_that_was_not_healthy_is_doubted(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    silent = [Planted("silent", "base_node", 210, 235)]  # in a stretch that is held back
    log = drives.write(tmp_path / "bad.bag", ROBOT, 6, 240, silent)
    assert learn(log, "-o", tmp_path / "draft", "--quiet") == 0
    assert "doubtful: odom: 1 false alarm over what was held back" in capsys.readouterr().err
    observers = tmp_path / "draft" / "observers.yaml"
    assert "#   topics: 1 false alarm over what was held back: more than was meant" in observers.read_text()
    assert "#   odom: {rate_hz: " in observers.read_text()
    assert "odom" not in {spec.name for spec in load_observers(observers).specs}
    model = tmp_path / "draft" / "model.yaml"
    assert batch_run(tmp_path / "out", log, "--observers", observers, model=model) == 0
    assert not [one for one in intervals(tmp_path / "out") if one["state"] == "faulty"]


@pytest.mark.parametrize("seconds", [240, 30])
def test_a_draft_calls_nothing_of_its_own_logs_faulty(seconds: int, tmp_path: Path) -> None:
    """Whatever happens in them: pauses, once, at any place."""
    for seed in range(4):
        chance = random.Random(seed)
        at = chance.uniform(0.1, 0.8) * seconds
        planted = [
            Planted(kind, node, at, at + chance.uniform(0.5, 0.15 * seconds))
            for kind, node in (("silent", "base_node"), ("slow", "lidar_node"), ("late", "mapper"))
        ]
        log = drives.write(tmp_path / f"{seed}.bag", ROBOT, seed, seconds, planted)
        draft = Draft(tmp_path / str(seed))
        assert learn(log, "-o", draft.folder, "--quiet") == 0
        out = tmp_path / f"out{seed}"
        assert batch_run(out, log, "--observers", draft.observers, model=draft.model) == 0
        assert not [one for one in intervals(out) if one["state"] == "faulty"]


def test_a_draft_of_a_public_bag_calls_nothing_of_it_faulty(tmp_path: Path) -> None:
    bag = Path(__file__).parents[1] / "data" / "turtlesim-lz4.bag"
    draft = Draft(tmp_path / "draft")
    assert learn(bag, "-o", draft.folder, "--quiet") == 0
    assert batch_run(tmp_path / "out", bag, "--observers", draft.observers, model=draft.model) == 0
    found = intervals(tmp_path / "out")
    assert {one["state"] for one in found} <= {"healthy", "unknown"}
    assert sum(one["end_ns"] - one["start_ns"] for one in found if one["state"] == "healthy") > 15 * SECOND


def test_what_the_other_logs_alone_would_call_false_in_one_is_left_as_a_comment(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """One session of five is silent for longer than the others ever are: so may the next one be."""
    silent = [Planted("silent", "base_node", 45, 47.7)]
    logs = [
        drives.write(tmp_path / f"{number}.bag", ROBOT, number, 60, silent if number == 2 else ())
        for number in range(5)
    ]
    assert learn(*logs, "-o", tmp_path / "draft", "--quiet") == 0
    said = "doubtful: odom: 1 false alarm in logs when learned from the others alone: it is left as a comment"
    assert said in capsys.readouterr().err.splitlines()
    names = {spec.name for spec in load_observers(tmp_path / "draft" / "observers.yaml").specs}
    assert {"scan", "gyro", "map"} <= names
    assert "odom" not in names


def test_a_start_that_one_log_alone_shows_may_be_later_in_another(tmp_path: Path) -> None:
    good, late = (
        write(tmp_path / f"{name}.bag", [*steady("odom", 20, 80), *steady("imu", 20, 80, 0, start_s)])
        for name, start_s in (("good", 0), ("late", 9.2))
    )
    assert learn(good, "-o", tmp_path / "draft", "--quiet") == 0
    model, observers = tmp_path / "draft" / "model.yaml", tmp_path / "draft" / "observers.yaml"
    assert batch_run(tmp_path / "out", late, "--observers", observers, model=model) == 0
    assert [one for one in intervals(tmp_path / "out") if one["state"] == "faulty"] == []


def test_what_was_held_up_before_a_recording_and_comes_at_once_is_no_wrong_rate(tmp_path: Path) -> None:
    good = write(tmp_path / "good.mcap", steady("scan", 10, 120))
    assert learn(good, "-o", tmp_path, "--quiet") == 0
    late = [(max(at_s, 1.9 + at_s / 20), topic, value) for at_s, topic, value in steady("scan", 10, 60)]
    twice = [*steady("scan", 10, 60), *steady("scan", 10, 60, start_s=40)]
    observers, model = tmp_path / "observers.yaml", tmp_path / "model.yaml"
    for name, samples, faults in (("late", late, 0), ("twice", twice, 1)):
        log = write(tmp_path / f"{name}.mcap", samples)
        assert batch_run(tmp_path / name, log, "--observers", observers, model=model) == 0
        assert len([one for one in intervals(tmp_path / name) if one["state"] == "faulty"]) == faults, name


def test_what_an_old_file_says_and_the_logs_contradict_is_said(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    log = drives.write(tmp_path / "good.bag", ROBOT, 1, 60)
    file = tmp_path / "agent.yaml"
    file.write_text(
        "topics:\n  scan: {rate_hz: 50, tolerance_hz: 1}\n  odom: {rate_hz: 8, tolerance_hz: 4}\n"
    )
    assert learn(log, "--update", file, "--quiet") == 0
    said = capsys.readouterr().err
    assert "contradicted: scan: 1 false alarm in logs of a healthy robot" in said
    assert "contradicted: odom" not in said


def test_a_node_whose_name_is_another_at_each_start_is_one(tmp_path: Path) -> None:
    logs = []
    for number, name in enumerate(("teleop_30719_1739203333671", "teleop_4411_1739203999671")):
        robot = Robot("r", (Source(name, "cmd", 10.0, 0.001, 0, 0.3, False, True),), name, 45.0)
        logs.append(drives.write(tmp_path / f"{number}.bag", robot, number, 60))
    assert learn(*logs, "-o", tmp_path / "draft", "--quiet") == 0
    assert "teleop" in load_model(tmp_path / "draft" / "model.yaml").cnf.components
    assert "  cmd: {rate_hz: " in (tmp_path / "draft" / "observers.yaml").read_text()


def test_a_recording_that_names_no_publisher_asks_for_them(tmp_path: Path) -> None:
    log = write(tmp_path / "drive.mcap", [*steady("scan", 10, 120), *steady("odom", 20, 120)])
    assert learn(log, "-o", tmp_path, "--quiet") == 0
    system = load_model(tmp_path / "model.yaml")
    assert sorted(system.cnf.components) == ["publisher_of_odom", "publisher_of_scan"]
    text = (tmp_path / "model.yaml").read_text()
    assert "#   which node publishes odom?\n#   which node publishes scan?\n" in text
    dead = write(tmp_path / "dead.mcap", [*steady("scan", 10, 20), *steady("odom", 20, 60)])
    observers, model = tmp_path / "observers.yaml", tmp_path / "model.yaml"
    assert batch_run(tmp_path / "out", dead, "--observers", observers, model=model) == 0
    faulty = [one["bad"] for one in intervals(tmp_path / "out") if one["state"] == "faulty"]
    assert faulty == [[["publisher_of_scan"]]]


def test_the_running_robot_says_who_publishes_and_who_listens(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    log = write(tmp_path / "drive.mcap", [*steady("scan", 10, 120), *steady("odom", 20, 120)])
    monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    with ros2_robot(tmp_path) as ros:
        ros.node("laser").do("publish", topic="/scan", type="std_msgs/String")
        tracker = ros.node("tracker")
        tracker.do("subscribe", topic="/scan", type="std_msgs/String")
        tracker.do("publish", topic="/odom", type="std_msgs/String")
        ros.node("onlooker").do("subscribe", topic="/scan", type="std_msgs/String")
        assert learn(log, "-o", tmp_path, "--quiet", "--ros2", ros.domain) == 0
    text = (tmp_path / "model.yaml").read_text()
    assert "publisher_of" not in text
    assert "onlooker" not in text
    assert "      odom: [scan]    # nav_msgs/Odometry" in text
    assert sorted(load_model(tmp_path / "model.yaml").cnf.components) == ["laser", "tracker"]


def test_what_the_running_robot_says_of_a_node_is_neither_guessed_from_times_nor_asked(
    good: list[Path],
) -> None:
    """It listens to odometry, and answers scans; a node that is not there now is guessed at, and asked of."""
    mapper, other = (RosGraph({}, {"/odom": frozenset({node})}) for node in ("/mapper", "/other"))
    texts = [learned(list(map(str, good[:1])), live=live).model for live in (mapper, other)]
    assert ["does map rest on scan?" in text for text in texts] == [False, True]
    assert ["map: [odom]" in text for text in texts] == [True, False]
    assert ["map: [scan]" in text for text in texts] == [False, True]


def test_a_robot_that_is_not_there_is_said(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    log = write(tmp_path / "drive.mcap", steady("scan", 10, 20))
    assert learn(log, "-o", tmp_path, "--ros1", "http://127.0.0.1:1/") == 3
    assert "nobody listens at 127.0.0.1:1" in capsys.readouterr().err
    assert learn(log, "-o", tmp_path, "--ros1", "http://127.0.0.1:1/", "--ros2", "0") == 2


DISCOVERY = """Gid gid
NodeEntitiesInfo[] node_entities_info_seq
{0}
MSG: rmw_dds_common/Gid
char[24] data
{0}
MSG: rmw_dds_common/NodeEntitiesInfo
string<=256 node_namespace
string<=256 node_name
Gid[] reader_gid_seq
Gid[] writer_gid_seq
""".format("=" * 80)


def test_nodes_that_a_recorded_discovery_topic_names_are_in_the_question(tmp_path: Path) -> None:
    def text_of(name: str) -> bytes:
        return struct.pack("<I", len(name) + 1) + name.encode() + b"\0"

    def padded(data: bytes) -> bytes:
        return data + bytes(-len(data) % 4)

    told = bytes(24) + struct.pack("<I", 2)
    for space, name in (("/", "laser"), ("/base", "drive")):
        for part in (text_of(space), text_of(name), struct.pack("<II", 0, 0)):
            told = padded(told) + part
    log = tmp_path / "drive.mcap"
    with log.open("wb") as file:
        writer = Writer(file)
        writer.start(profile="ros2", library="test")
        schema = writer.register_schema(
            "rmw_dds_common/msg/ParticipantEntitiesInfo", "ros2msg", DISCOVERY.encode()
        )
        discovery = writer.register_channel("/ros_discovery_info", "cdr", schema)
        schema = writer.register_schema("std_msgs/msg/Float64", "ros2msg", b"float64 data\n")
        scan = writer.register_channel("/scan", "cdr", schema)
        writer.add_message(discovery, EPOCH_NS, b"\0\1\0\0" + told, EPOCH_NS)
        for number in range(1200):
            at_ns = EPOCH_NS + number * SECOND // 10
            writer.add_message(scan, at_ns, b"\0\1\0\0" + bytes(8), at_ns)
        writer.finish()  # type: ignore[no-untyped-call]  # the library's
    assert learn(log, "-o", tmp_path, "--quiet") == 0
    text = (tmp_path / "model.yaml").read_text()
    assert "#   nodes that the recordings name, without their topics: base/drive, laser\n" in text
    assert sorted(load_model(tmp_path / "model.yaml").cnf.components) == ["publisher_of_scan"]


def test_fields_of_ros_2_messages_that_go_together_are_related(tmp_path: Path) -> None:
    def turning(topic: str, seed: int) -> list[tuple[float, str, float]]:
        chance, goals = random.Random(seed), random.Random(1)
        goal = [goals.choice((0.0, 1.0, -1.0)) for _ in range(100)]
        return [(n / 10, topic, goal[n // 30] + chance.gauss(0, 0.01)) for n in range(2400)]

    both = [*turning("odom", 1), *turning("imu", 2)]
    log = write(tmp_path / "drive.mcap", both)
    assert learn(log, "-o", tmp_path / "whole", "--quiet") == 0
    assert "related:" in (tmp_path / "whole" / "model.yaml").read_text()
    text = (tmp_path / "whole" / "observers.yaml").read_text()
    assert 'first: "imu:angular_velocity.z", second: "odom:twist.twist.angular.z"' in text


def test_diagnostics_without_a_publisher_blame_the_node_that_they_name(tmp_path: Path) -> None:
    values = [(float(second), "diagnostics", 40.0 + second % 7) for second in range(120)]
    log = write(tmp_path / "drive.mcap", [*values, *steady("scan", 10, 120)])
    assert learn(log, "-o", tmp_path, "--quiet") == 0
    assert "hokuyo" in load_model(tmp_path / "model.yaml").cnf.components
    hot = [(second, topic, 59.0 if topic == "diagnostics" else value) for second, topic, value in values]
    dead = write(tmp_path / "hot.mcap", [*hot, *steady("scan", 10, 120)])
    observers, model = tmp_path / "observers.yaml", tmp_path / "model.yaml"
    assert batch_run(tmp_path / "out", dead, "--observers", observers, model=model) == 0
    assert [["hokuyo"]] in [one["bad"] for one in intervals(tmp_path / "out")]


def test_a_status_is_put_to_the_node_of_its_namespace_and_tools_are_no_part_of_the_robot(
    tmp_path: Path,
) -> None:
    """Two robots in one recording, on which our own agent and a recorder were."""

    def written(file: Path, hot: str = "") -> Path:
        with BagWriter(file) as bag:
            of = {
                (topic, node): bag.add_connection(topic, kind, typestore=ROS1, callerid=node)
                for robot in ("one", "two")
                for topic, kind, node in (
                    (f"/{robot}/odom", KINDS["odom"], f"/{robot}/base"),
                    (f"/{robot}/diagnostics", KINDS["diagnostics"], f"/{robot}/watcher"),
                )
            }
            own = {"/diagnostics": "/robomend", "/events/write_split": "/rosbag2_recorder"}
            for topic, node in own.items():
                of[topic, node] = bag.add_connection(
                    topic, KINDS["diagnostics"], typestore=ROS1, callerid=node
                )
            for number in range(1200):
                at_ns = EPOCH_NS + number * SECOND // 10
                for (topic, node), connection in of.items():
                    plain = "odom" if topic.endswith("odom") else "diagnostics"
                    hot_now = 90.0 if topic == hot and number > 600 else 40.0 + number % 7
                    made = message(ROS1, plain, 0.0 if plain == "odom" else hot_now, at_ns, "x")
                    for status in getattr(made, "status", ()):
                        status.name = "agent: state" if node == "/robomend" else "base: motor"
                    bag.write(connection, at_ns, ROS1.serialize_ros1(made, KINDS[plain]))
        return file

    assert learn(written(tmp_path / "good.bag"), "-o", tmp_path, "--quiet") == 0
    observers, model = tmp_path / "observers.yaml", tmp_path / "model.yaml"
    components = load_model(model).cnf.components
    assert sorted(components) == ["one/base", "one/watcher", "two/base", "two/watcher"]
    assert "events" not in model.read_text()
    log = written(tmp_path / "hot.bag", "/two/diagnostics")
    assert batch_run(tmp_path / "out", log, "--observers", observers, model=model) == 0
    assert {str(one["bad"]) for one in intervals(tmp_path / "out") if one["state"] == "faulty"} == {
        "[['two/base']]"
    }


def test_a_status_that_comes_twice_in_each_message_is_learned(tmp_path: Path) -> None:
    """Two motors of one name in one message: between them is no time."""
    log = tmp_path / "twice.bag"
    with BagWriter(log) as bag:
        kind = KINDS["diagnostics"]
        of = bag.add_connection("/diagnostics", kind, typestore=ROS1, callerid="/base")
        for number in range(120):
            at_ns = EPOCH_NS + number * SECOND
            made = message(ROS1, "diagnostics", 40.0 + number % 7, at_ns, "x")
            made.status = [*made.status, *made.status]
            bag.write(of, at_ns, ROS1.serialize_ros1(made, kind))
    assert learn(log, "-o", tmp_path, "--quiet") == 0
    assert "interval_s: 1," in (tmp_path / "observers.yaml").read_text()


def test_what_cannot_be_learned_from_is_said(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    literals = ndjson(tmp_path / "literals.ndjson", (0.0, "ok(scan)"))
    assert learn(literals, "-o", tmp_path / "draft") == 2
    assert "ndjson is no recording of messages (bag, mcap, db3)" in capsys.readouterr().err
    good = write(tmp_path / "good.mcap", steady("scan", 10, 120))
    assert learn(literals, good, "-o", tmp_path / "draft") == 2
    assert (tmp_path / "draft" / "model.yaml").exists()


def test_a_draft_that_is_there_is_not_replaced(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "model.yaml").write_text("mine\n")
    good = write(tmp_path / "good.mcap", steady("scan", 10, 60))
    assert learn(good, "-o", tmp_path) == 2
    assert "has a model.yaml already: --overwrite replaces it" in capsys.readouterr().err
    assert (tmp_path / "model.yaml").read_text() == "mine\n"
    assert learn(good, "-o", tmp_path, "--overwrite", "--quiet") == 0
    assert (tmp_path / "model.yaml").read_text() != "mine\n"


AGENT = """\
# our robot
name: mapper

topics:
  # the lidar
  /scan: {rate_hz: 5, tolerance_hz: 0.1, check_s: 0.5}   # by hand
  battery: {rate_hz: 1}

observers:
  cpu: {kind: property, source: "host:CPU", high: 0.9}

# the end
"""


def test_changes_of_a_file_are_a_diff_that_can_be_applied(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    good = [drives.write(tmp_path / "good.bag", ROBOT, 1, 120)]
    file = tmp_path / "agent.yaml"
    file.write_text(AGENT)
    assert learn(*good, "--update", file, "--quiet") == 0
    diff = capsys.readouterr().out
    assert file.read_text() == AGENT
    patched = applied(AGENT, diff)
    for kept in (
        "# our robot\n",
        "  # the lidar\n",
        "  battery: {rate_hz: 1}\n",
        "  cpu: {",
        "\n# the end\n",
    ):
        assert kept in patched
    assert "by hand" not in patched
    file.write_text(patched)
    specs = {spec.name: spec for spec in load_observers(file).specs}
    assert {"scan", "odom", "gyro", "map", "battery", "cpu", "map_triggered"} <= specs.keys()
    assert "check_s: 0.5" in next(line for line in patched.splitlines() if line.startswith("  /scan:"))
    assert learn(*good, "--update", file, "--quiet") == 0
    assert capsys.readouterr().out == ""


@pytest.mark.parametrize(
    ("text", "why"),
    [
        ("robomend: 1\nname: x\n", "is a model: --update takes the file with the observers"),
        ("topics: {scan: {rate_hz: 5}}\n", "topics is to be a block of entries"),
        ("- a\n", "a mapping with `topics:` or `observers:` is needed"),
        ("a: [\n", "bad.yaml"),
    ],
)
def test_a_file_that_cannot_be_changed_is_refused(
    text: str, why: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / "bad.yaml"
    file.write_text(text)
    log = write(tmp_path / "good.mcap", steady("scan", 10, 60))
    assert learn(log, "--update", file) == 2
    assert why in capsys.readouterr().err


def applied(text: str, diff: str) -> str:
    """Apply a unified diff."""
    old, new, at = text.splitlines(keepends=True), [], 0
    for line in diff.splitlines(keepends=True)[2:]:
        if line.startswith("@@"):
            first = max(0, int(line.split()[1].split(",")[0].removeprefix("-")) - 1)
            new += old[at:first]
            at = first
        elif line.startswith("+"):
            new.append(line[1:])
        else:
            assert old[at] == line[1:]
            new += [] if line.startswith("-") else [old[at]]
            at += 1
    return "".join([*new, *old[at:]])
