"""A first model from a ROS graph, and from what was heard on it: what is in it, and that it is a model."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from robomend.cli.init.described import Described, files_of
from robomend.diagnosis.engines import make_engine
from robomend.errors import InputError
from robomend.model.checking import check
from robomend.model.from_graph import first_model, offered_remedies, rests, steady, tighter
from robomend.model.loading import load_text
from robomend.model.system import System
from robomend_client.agent.executors.base import read_actions
from robomend_client.literals import Literal, fails, holds
from robomend_client.observers.rate import Rate
from robomend_client.ros_graph import (
    Ear,
    Heard,
    HeardStatus,
    HeardTopic,
    RosGraph,
    SteadyTopic,
    UsualRate,
    lasting_name,
)
from robomend_client.yaml_reader import read

ROBOT = RosGraph(
    publishers={
        "/scan": frozenset({"/hokuyo_node"}),
        "/map": frozenset({"/hector_mapping"}),
        "/tf": frozenset({"/hector_mapping", "/robot_state_publisher"}),
        "/rosout": frozenset({"/hokuyo_node", "/hector_mapping", "/rviz"}),
        "/arm/goal": frozenset({"/rviz"}),
        "/bag": frozenset({"/record_1234"}),
    },
    subscribers={
        "/scan": frozenset({"/hector_mapping", "/rviz"}),
        "/imu": frozenset({"/hector_mapping"}),
        "/map": frozenset({"/rviz"}),
    },
    services={
        "/rviz/get_loggers": frozenset({"/rviz"}),
        "/rosout/get_loggers": frozenset({"/rosout"}),
        "/arm/spawner_gripper/get_parameters": frozenset({"/arm/spawner_gripper"}),
    },
    types={"/scan": "sensor_msgs/LaserScan", "/arm/goal": "arm_msgs/MoveActionGoal"},
)

MODEL = """\
# A first model of tedusar, from the master at http://localhost:11311.
# It is a proposal: go through it, then `robomend model check FILE`, then `robomend compile FILE`.
robomend: 1
name: tedusar

# hardware:                   # your devices; `channel:` if a power board switches them
#   lidar: {channel: 3}       # then say which node drives it: drives: [lidar]

nodes:
  hector_mapping:    # all that it publishes rests on all that it listens to: strike out what does not
    publishes:
      map: [scan]
  hokuyo_node:    # listens to nothing: probably a driver; of which device?
    # drives: []
    publishes:
      scan: []    # sensor_msgs/LaserScan
  robot_state_publisher: {}    # publishes nothing that the model speaks of

# topics:                     # the rate of messages, and how far it may stray
#   map: {rate_hz: 10, tolerance_hz: 1}
#   scan: {rate_hz: 10, tolerance_hz: 1}

# Topics of several publishers: the silence of one does not show:
#   tf (hector_mapping, robot_state_publisher)

# Topics of actions: there are messages when somebody acts:
#   arm/goal

# Topics that no node of the robot publishes: tools do, or nobody:
#   bag
#   imu
"""


def test_the_model_of_a_small_robot() -> None:
    assert first_model(Heard(ROBOT, "the master at http://localhost:11311"), "tedusar").text == MODEL


def test_a_graph_without_a_node_of_the_robots_own_is_refused() -> None:
    graph = RosGraph({"/rosout": frozenset({"/rosout"})})
    with pytest.raises(InputError, match=r"nowhere: .* no node of the robot.s own, only tools .*: /rosout"):
        first_model(Heard(graph, "nowhere"), "r")


names = st.text(st.characters(codec="utf-8"), min_size=1, max_size=12)
tables = st.dictionaries(
    names.map(lambda name: "/" + name), st.frozensets(names.map(lambda n: "/" + n), max_size=3), max_size=5
)


@given(publishers=tables, subscribers=tables, kinds=st.text(max_size=9))
def test_odd_names_make_no_odd_yaml(
    publishers: dict[str, frozenset[str]], subscribers: dict[str, frozenset[str]], kinds: str
) -> None:
    publishers = {**publishers, "/scan": frozenset({"/laser"})}
    graph = RosGraph(publishers, subscribers, types=dict.fromkeys(publishers, kinds))
    load_text(first_model(Heard(graph, kinds), "r").text)


# --- what was heard ---------------------------------------------------------------------------------------

SECOND = 10**9


def came(rate_hz: float, seconds: float = 60, first_s: float = 0, latched: bool = False) -> HeardTopic:
    """Return a topic of this rate."""
    count = round(rate_hz * seconds)
    return Ear(round((first_s + n / rate_hz) * SECOND) for n in range(count)).heard(latched)


def heard(topics: dict[str, HeardTopic], nodes: dict[str, tuple[list[str], list[str]]], **more: Any) -> Heard:
    """Return what was heard for a minute; `nodes`: what each publishes and listens to."""
    publishers: dict[str, set[str]] = {}
    subscribers: dict[str, set[str]] = {}
    for node, (outputs, inputs) in nodes.items():
        for topic in outputs:
            publishers.setdefault(topic, set()).add(node)
        for topic in inputs:
            subscribers.setdefault(topic, set()).add(node)
    graph = RosGraph(
        {name: frozenset(found) for name, found in publishers.items()},
        {name: frozenset(found) for name, found in subscribers.items()},
        types=more.pop("types", {}),
    )
    return Heard(graph, "a test", 60.0, 60 * SECOND, topics, **more)


def test_nothing_that_flowed_rests_on_what_did_not() -> None:
    made = first_model(
        heard(
            {"/odom": came(50), "/map": came(1 / 60, latched=True), "/plan": came(5)},
            {
                "/base": (["/odom"], ["/cmd_vel"]),
                "/maps": (["/map"], []),
                "/planner": (["/plan", "/cmd_vel"], ["/odom", "/map"]),
            },
        ),
        "rover",
    )
    parts = load_text(made.text).parts
    assert parts is not None
    assert parts.nodes["base"].publishes == {"odom": ()}
    assert parts.nodes["planner"].publishes == {"plan": ("odom",), "cmd_vel": ()}
    assert parts.topics["cmd_vel"].silent
    assert parts.topics["map"].latched
    assert set(made.watched) == {"odom", "plan"}


def test_the_silence_of_what_was_silent_blames_nobody_and_that_of_another_its_node() -> None:
    made = first_model(heard({"/odom": came(50)}, {"/base": (["/odom", "/dock"], [])}), "rover")
    system = load_text(made.text)
    found = {
        name: make_engine("sat", system.cnf).diagnose([fails("ok", name)]).diagnoses[0].bad
        for name in ("dock", "odom")
    }
    assert found == {"dock": (), "odom": ("base",)}


@pytest.mark.parametrize(
    ("topic", "told"),
    [
        (came(10), 10.0),
        (came(0.5), 0.5),
        (came(10, seconds=0), "silent"),
        (came(3, seconds=1), "3 messages"),
        (came(1e8, seconds=2e-6, first_s=60), "200 messages within 0.00199 ms"),
        (came(10, seconds=30), "300 messages, and then silent for 30.1 s"),
        (Ear([0, 0, 0, 0, 0, 0]).heard(), "its messages come several at once"),
    ],
)
def test_a_rate_is_told_of_what_came_steadily(topic: HeardTopic, told: float | str) -> None:
    found = steady(topic, 60 * SECOND)
    assert (round(found.rate_hz, 2) if isinstance(found, SteadyTopic) else found) == told


@given(rate_hz=st.floats(0.2, 60), gap_s=st.floats(0, 5))
def test_the_bounds_are_those_of_the_plain_rule(rate_hz: float, gap_s: float) -> None:
    before = came(rate_hz, 30)
    topic = Ear([*before.stamps, *(t + round((30 + gap_s) * SECOND) for t in before.stamps)]).heard()
    found = steady(topic, topic.last_ns)
    assert isinstance(found, SteadyTopic)
    assert found.silence_s == pytest.approx(max(2, 10 / topic.rate_hz, 3 * topic.longest_s))
    assert found.tolerance_hz >= 0.4 * topic.rate_hz * 0.999
    Rate(found.rate_hz, found.tolerance_hz, found.window, found.silence_s, settle=found.settle)


@given(
    rate_hz=st.floats(0.2, 60),
    hours=st.floats(0, 100),
    slow=st.floats(0.3, 1),
    fast=st.floats(1, 3),
    longest=st.floats(1, 20),
)
def test_a_long_time_makes_bounds_tighter_never_wider_and_what_was_usual_stays_within(
    rate_hz: float, hours: float, slow: float, fast: float, longest: float
) -> None:
    topic = came(rate_hz, 60)
    found = steady(topic, topic.last_ns)
    assert isinstance(found, SteadyTopic)
    rate = found.rate_hz
    usual = UsualRate(found.window, 1, hours * 3600, longest / rate, slow * rate, fast * rate)
    new = tighter(found, usual)
    if hours < 1:
        assert new == found
    assert new.silence_s <= found.silence_s
    assert new.tolerance_hz <= found.tolerance_hz
    assert new.above_hz <= found.above_hz
    assert new.silence_s >= min(found.silence_s, 3 * usual.longest_s)
    assert new.tolerance_hz >= min(found.tolerance_hz, rate - usual.slowest_hz)
    assert new.above_hz >= min(found.above_hz, usual.fastest_hz - rate)
    Rate(rate, new.tolerance_hz, new.window, new.silence_s, settle=new.settle, pause_s=new.pause_s)


def test_an_output_whose_intervals_are_those_of_an_input_follows_it() -> None:
    jitter = [n * SECOND // 10 + (n * n * 7919) % 30_000_000 for n in range(300)]
    assert rests(Ear(jitter).heard(), Ear([one + 5_000_000 for one in jitter]).heard()) is True


def test_statuses_are_put_to_their_nodes_and_those_that_are_not_ok_are_asked_about() -> None:
    def status(level: int, *by: str) -> HeardStatus:
        return HeardStatus(frozenset({level}), frozenset(by), came(1))

    nodes: dict[str, tuple[list[str], list[str]]] = {
        node: ([f"{node}/out"], []) for node in ("/a/lidar", "/b/lidar", "/monitor")
    }
    statuses = {
        "lidar: scan": status(0, "/b/lidar"),
        "cpu": status(0, "/monitor"),
        "disk": status(1, "/monitor"),
        "odd": status(0, "/elsewhere"),
        "robomend: lidar": status(0, "/elsewhere"),  # of another agent, which tells ROS of its diagnosis
    }
    made = first_model(heard({}, nodes, statuses=statuses), "rover")
    entries = made.entries.observers
    assert {name: keys["status"] for name, keys in entries.items()} == {
        "lidar_scan": '["lidar: scan"]',
        "cpu": '["cpu"]',
    }
    assert "'not ab(b/lidar) -> ok(lidar_scan)'" in made.text
    assert "the status 'disk' said WARN: is that so by design?" in made.asked
    assert "of which node does the status 'odd' speak?" in made.asked
    assert "robomend: lidar" not in " ".join((*made.asked, made.text))
    load_text(made.text)


def test_no_topic_counts_as_silent_before_what_it_rests_on() -> None:
    paused = Ear([*came(20, 30).stamps, *came(20, 28, first_s=32).stamps]).heard()
    nodes = {
        "/base": (["/odom"], list[str]()),
        "/ekf": (["/pose"], ["/odom"]),
        "/plan": (["/path"], ["/pose"]),
    }
    topics = {"/odom": paused, "/pose": came(20), "/path": came(20)}
    watched = first_model(heard(topics, nodes), "rover").watched
    assert watched["odom"].silence_s == pytest.approx(3 * 2.05)
    assert watched["path"].silence_s == watched["pose"].silence_s == watched["odom"].silence_s


def test_what_nodes_say_of_themselves_is_theirs() -> None:
    nodes: dict[str, tuple[list[str], list[str]]] = {
        "/imu": (["/imu/data"], []),
        "/mission": ([], ["/imu/data"]),
        "/noisy": ([], []),
    }
    found = heard(
        {"/imu/data": came(50)},
        {name: parts for name, parts in nodes.items() if name != "/noisy"},
        actions={"/navigate": "/mission", "/elsewhere": "/gone"},
        lifecycle={"/imu": ""},
        errors={"/mission": 1},
        moving={"/imu/data": "linear_acceleration.z"},
        origin={"ros2": {"domain": 7}},
    )
    made = first_model(found, "rover")
    assert {name: keys["kind"] for name, keys in made.entries.observers.items()} == {
        "nodes": "node",
        "navigate_goals": "goals",
        "imu_lifecycle": "lifecycle",
        "imu_log": "rosout",
        "imu_data_values": "changing",
        "imu_data_qos": "qos",
    }
    assert "'not ab(mission) -> ok(navigate_goals)'" in made.text
    assert "'not ab(imu) -> ok(imu_data_values)'" in made.text
    load_text(made.text)
    files_of(Described("rover", heard=found, origin=found.origin))


def test_who_only_has_a_nodelet_loaded_is_no_node_of_the_model() -> None:
    """It ends when its manager does, which is the one that failed."""
    nodes: dict[str, tuple[list[str], list[str]]] = {
        "/camera_manager": (["/image_raw", "/camera_manager/bond"], ["/camera_manager/bond"]),
        "/camera": (["/camera_manager/bond"], ["/camera_manager/bond"]),
        "/bonded": (["/docking/bond"], []),
    }
    found = heard({"/image_raw": came(15)}, nodes, origin={"ros1": {}})
    services = {"/camera_manager/load_nodelet": frozenset({"/camera_manager"})}
    made = first_model(replace(found, graph=replace(found.graph, services=services)), "rover")
    assert made.nodes == ("bonded", "camera_manager")
    assert (
        "# Nodes that only keep nodelets loaded: their manager does the work, and ends them:\n#   camera\n"
        in made.text
    )


def test_where_no_log_was_heard_nobody_is_said_to_log_no_errors() -> None:
    nodes: dict[str, tuple[list[str], list[str]]] = {"/imu": (["/imu/data"], [])}
    found = heard({"/imu/data": came(50)}, nodes, errors=None, origin={"ros1": {}})
    assert first_model(found, "rover").entries.observers.keys() == {"nodes"}


def test_a_publisher_whose_name_nobody_knows_is_asked_for_and_not_watched() -> None:
    nodes: dict[str, tuple[list[str], list[str]]] = {"/imu": (["/imu/data"], []), "/of_scan": (["/scan"], [])}
    found = heard(
        {"/imu/data": came(50), "/scan": came(10)},
        nodes,
        unnamed=frozenset({"/of_scan"}),
        origin={"ros2": {}},
    )
    made = first_model(found, "rover")
    assert made.nodes == ("imu",)
    assert "which node publishes scan?" in made.asked
    assert "which device does of_scan drive, if any?" not in made.asked
    said = made.entries.observers.values()
    assert {keys.get("node", keys.get("nodes")) for keys in said} == {"imu", "[imu]"}
    model = load_text(made.text)
    found_bad = make_engine("sat", model.cnf).diagnose([fails("ok", "scan")]).diagnoses
    assert [set(one.bad) for one in found_bad] == [{"of_scan"}]
    files = files_of(Described("rover", heard=found, origin=found.origin))
    assert "of_scan" not in files["agent.yaml"]
    assert "of_scan" not in files["robot.yaml"]
    assert "of_scan" in first_model(found.within("/"), "rover").text


def test_in_a_namespace_a_publisher_without_a_name_is_where_its_topic_is() -> None:
    unnamed = frozenset({"/of_scan", "/of_map"})
    topics: dict[str, tuple[list[str], list[str]]] = {
        "/of_scan": (["/r1/scan"], []),
        "/of_map": (["/map"], []),
    }
    found = heard({"/r1/scan": came(10), "/map": came(1)}, topics, unnamed=unnamed).within("/r1")
    assert set(found.graph.publishers) == {"/r1/scan"}


def test_what_a_lifecycle_manager_takes_down_is_explained_by_the_one_that_failed() -> None:
    servers = ("/planner", "/controller", "/navigator")
    nodes: dict[str, tuple[list[str], list[str]]] = {name: ([], []) for name in (*servers, "/manager")}
    found = heard({}, nodes, lifecycle=dict.fromkeys(servers, "active"), origin={"ros2": {"domain": 7}})
    clients = {f"{name}/change_state": frozenset({"/manager", "/rviz2"}) for name in servers}
    services = {f"{name}/x": frozenset({name}) for name in nodes}
    model = load_text(
        first_model(replace(found, graph=RosGraph({}, {}, services, clients=clients)), "r").text
    )

    def blamed(*seen: Literal) -> list[tuple[str, ...]]:
        found = make_engine("sat", model.cnf).diagnose(seen).diagnoses
        return sorted(tuple(sorted(one.bad)) for one in found)

    down = [fails("ok", f"{name.strip('/')}_lifecycle") for name in servers]
    assert blamed(fails("running", "planner"), *down) == [("planner",)]
    assert blamed(*down) == [("controller",), ("manager",), ("navigator",), ("planner",)]
    assert blamed(down[0], holds("ok", "controller_lifecycle")) == [("planner",)]
    assert blamed(*down[:2], holds("ok", "navigator_lifecycle")) == [("controller", "planner")]
    assert check(model) == ()


def test_what_no_longer_reaches_its_listeners_is_its_publishers_fault_and_not_theirs() -> None:
    nodes: dict[str, tuple[list[str], list[str]]] = {
        "/base": (["/odom"], []),
        "/ekf": (["/filtered"], ["/odom"]),
        "/recorder": ([], ["/filtered"]),
    }
    topics = {"/odom": came(30), "/filtered": came(30)}
    made = first_model(heard(topics, nodes, origin={"ros2": {"domain": 7}}), "rover")
    system = load_text(made.text)
    seen = [holds("ok", "odom"), fails("ok", "filtered"), fails("ok", "odom_qos")]
    found = make_engine("sat", system.cnf).diagnose(seen).diagnoses
    assert [one.bad for one in found] == [("base",)]
    seen = [holds("ok", "odom"), fails("ok", "filtered"), holds("ok", "odom_qos")]
    found = make_engine("sat", system.cnf).diagnose(seen).diagnoses
    assert [one.bad for one in found] == [("ekf",)]
    assert check(system) == ()


def test_what_may_have_been_broken_is_asked() -> None:
    types = {"/scan": "sensor_msgs/LaserScan", "/goal": "geometry_msgs/PoseStamped"}
    topics = {"/odom": came(10, seconds=20)}
    nodes: dict[str, tuple[list[str], list[str]]] = {"/base": (["/scan", "/goal", "/odom"], [])}
    asked = first_model(heard(topics, nodes, types=types, errors={"/base": 2}), "rover").asked
    assert "scan was silent all the time: is that so by design?" in asked
    assert "odom: 200 messages, and then silent for 40.1 s: is that so by design?" in asked
    assert "base logged 2 errors: was it well?" in asked
    assert not any("goal" in one for one in asked)


def test_who_ended_or_looks_on_or_is_of_ros_itself_is_no_part_of_the_robot() -> None:
    nodes: dict[str, tuple[list[str], list[str]]] = {
        "/base": (["/odom", "/base/transition_event", "/robot_description", "/tf_static"], []),
        "/setup": (["/done"], []),
        "/rviz2": (["/clicked"], ["/odom"]),
        "/rosbag2_recorder": ([], ["/odom"]),
        "/transform_listener_impl_55d0": ([], ["/tf"]),
        "/robomend_attach": ([], ["/odom"]),
        "/foxglove_bridge": ([], ["/odom"]),
    }
    made = first_model(heard({"/odom": came(10)}, nodes, gone=frozenset({"/setup"})), "rover")
    parts = load_text(made.text).parts
    assert parts is not None
    assert {name: list(node.publishes) for name, node in parts.nodes.items()} == {"base": ["odom"]}
    assert "#   setup" in made.text


@pytest.mark.parametrize(
    ("name", "stays"),
    [
        ("/teleop_30719_1739203333671", "/teleop"),
        ("/talker_1739203333671000000", "/talker"),
        ("/static_transform_publisher_aB3dE5fG7h", "/static_transform_publisher"),
        ("/lidar_2", "/lidar_2"),
        ("/camera_640_480", "/camera_640_480"),
    ],
)
def test_a_name_that_is_another_at_each_start_is_one_node(name: str, stays: str) -> None:
    assert lasting_name(name) == stays


def test_remedies_that_nodes_offer_stand_commented_out_and_hold_once_they_do_not() -> None:
    graph = replace(
        ROBOT,
        services={
            "/hector_mapping/change_state": frozenset({"/hector_mapping"}),
            "/hector_mapping/get_state": frozenset({"/hector_mapping"}),
            "/record_1234/change_state": frozenset({"/record_1234"}),
            "/record_1234/get_state": frozenset({"/record_1234"}),
        },
    )
    known = Heard(graph, "domain 0", origin={"ros2": {"domain": 0}})
    texts = files_of(Described("tedusar", heard=known, origin=known.origin))
    model, agent = texts["tedusar.yaml"], texts["agent.yaml"]
    assert load_text(model).parts.remedies == ()  # type: ignore[union-attr]  # it is of components
    begun = model.replace("# remedies:", "remedies:").replace("#  bring_up", "  bring_up")
    (remedy,) = load_text(begun).parts.remedies  # type: ignore[union-attr]  # as above
    assert str(remedy) == "bring_up_hector_mapping(hector_mapping)"
    assert "# actions:" in agent
    assert "#  bring_up_hector_mapping: {kind: lifecycle" in agent


ROVER = """
robomend: 1
name: rover
nodes:
  lidar_driver: {publishes: {scan: []}}
  camera: {publishes: {image: []}}
  imu_driver: {publishes: {imu: []}}
  base_driver: {publishes: {odom: [], battery: []}}
  map_server: {publishes: {map: []}}
  ekf: {publishes: {filtered: [odom, imu]}}
  amcl: {publishes: {pose: [filtered, scan]}}
  planner: {publishes: {plan: [pose]}}
  controller: {publishes: {cmd_raw: [plan]}}
  smoother: {publishes: {cmd_smooth: [cmd_raw]}}
  detector: {publishes: {objects: [image]}}
  mission: {publishes: {state: []}}
topics: {map: {latched: true, silent: true}}
properties: {lidar_driver_scan: {}}
rules: ["not ab(lidar_driver) -> ok(lidar_driver_scan)"]
"""
"""As its builder would write it: the mission goes on without the detector, to which it listens."""

LISTENS = {
    "ekf": ["/odom", "/imu"],
    "amcl": ["/filtered", "/scan", "/map"],
    "planner": ["/pose", "/map"],
    "controller": ["/plan"],
    "smoother": ["/cmd_raw"],
    "detector": ["/image"],
    "mission": ["/objects"],
    "base_driver": ["/cmd_vel"],
}
RATES = {
    "scan": 10,
    "image": 15,
    "imu": 50,
    "odom": 30,
    "battery": 1,
    "filtered": 30,
    "pose": 30,
    "plan": 30,
    "cmd_raw": 30,
    "cmd_smooth": 30,
    "objects": 15,
    "state": 2,
}


def test_what_was_heard_for_a_minute_diagnoses_as_the_model_by_hand() -> None:
    by_hand = load_text(ROVER)
    assert by_hand.parts is not None
    nodes = by_hand.parts.nodes
    topics = {f"/{topic}": came(rate) for topic, rate in RATES.items()}
    topics["/map"] = came(1 / 60, latched=True)
    of_nodes = {
        f"/{name}": ([f"/{topic}" for topic in node.publishes], LISTENS.get(name, []))
        for name, node in nodes.items()
    }
    status = HeardStatus(frozenset({0}), frozenset({"/lidar_driver"}), came(1))
    statuses = {"lidar_driver: scan": status}
    found = heard(topics, of_nodes, origin={"ros2": {"domain": 7}}, statuses=statuses)
    first = first_model(found, "rover")
    draft = load_text(first.text)
    meets = [holds("ok", name) for name, keys in first.entries.observers.items() if keys["kind"] == "qos"]

    def seen(*faults: str) -> list[Literal]:
        """Return what is observed once faults have settled: `kill X`, `mute TOPIC`, `status`."""
        ended = {fault.partition(" ")[2] for fault in faults if fault.startswith("kill")}
        silent = {fault.partition(" ")[2] for fault in faults if fault.startswith("mute")}
        silent |= {topic for name in ended for topic in nodes[name].publishes}
        for _ in nodes:  # as far as any chain goes
            for node in nodes.values():
                silent |= {topic for topic, inputs in node.publishes.items() if silent & set(inputs)}
        found = [fails("running", name) if name in ended else holds("running", name) for name in nodes]
        found += [fails("ok", topic) if topic in silent else holds("ok", topic) for topic in RATES]
        bad_status = "status" in faults or "lidar_driver" in ended
        return [*found, fails("ok", "lidar_driver_scan") if bad_status else holds("ok", "lidar_driver_scan")]

    single = [*(f"kill {name}" for name in nodes), *(f"mute {topic}" for topic in RATES), "status"]
    pairs = list(zip(single, single[7:] + single[:7], strict=True))
    every = [*((one,) for one in single), *pairs][:40]
    assert len(set(every)) == 40

    def told(system: System, *observed: Literal) -> set[frozenset[str]]:
        return {frozenset(one.bad) for one in make_engine("sat", system.cnf).diagnose(observed).diagnoses}

    right = {faults: told(by_hand, *seen(*faults)) for faults in every}
    assert frozenset() not in set().union(*right.values())
    same = [faults for faults in every if told(draft, *seen(*faults), *meets) == right[faults]]
    assert len(same) >= 0.95 * len(every), set(every) - set(same)


# --- remedies that a graph offers

GRAPH = RosGraph(
    services={
        "/front/camera/change_state": frozenset({"/front/camera"}),
        "/front/camera/get_state": frozenset({"/front/camera"}),
        "/other/change_state": frozenset({"/other"}),  # no lifecycle: it tells no state
        "/global_costmap/clear_entirely_global_costmap": frozenset({"/global_costmap"}),
        "/laser/reset": frozenset({"/laser"}),  # nobody knows what that does
    }
)


def test_lifecycles_and_costmaps_are_offered_and_nothing_that_nobody_knows() -> None:
    found = offered_remedies(GRAPH)
    assert [one.node for one in found] == ["/front/camera", "/global_costmap"]
    assert all(line.startswith("#") for one in found for line in (one.model, one.action))
    assert found[0].model == "#  bring_up_front_camera: {mends: front/camera}"


def test_an_offered_action_can_be_read_once_somebody_takes_the_comment_away(tmp_path: Path) -> None:
    lines = [one.action.removeprefix("#") for one in offered_remedies(GRAPH)]
    file = tmp_path / "agent.yaml"
    file.write_text("\n".join(("actions:", *lines, "")))
    specs = read_actions(read(file), tmp_path)
    assert [(one.kind, one.make().parameters) for one in specs] == [
        ("lifecycle", (("front/camera",),)),
        ("ros2_service", (("global_costmap",),)),
    ]
