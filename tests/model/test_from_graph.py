"""A first model from a ROS graph: what is in it, and that it is a model."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from robomend.errors import InputError
from robomend.model.from_graph import model_from_graph
from robomend.model.loading import load_text
from robomend_client.ros_graph import RosGraph

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
    services={"/rviz/get_loggers": frozenset({"/rviz"}), "/rosout/get_loggers": frozenset({"/rosout"})},
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
  rviz: {}    # publishes nothing that the model speaks of, listens to map, scan

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
    assert model_from_graph(ROBOT, "tedusar", "the master at http://localhost:11311") == MODEL


def test_what_is_written_is_a_model_that_finds_the_fault() -> None:
    system = load_text(MODEL)
    assert sorted(system.cnf.components) == ["hector_mapping", "hokuyo_node", "robot_state_publisher", "rviz"]
    assert system.name == "tedusar"


def test_rates_that_were_measured_are_in_it() -> None:
    graph = RosGraph({"/scan": frozenset({"/laser"})}, rates_hz={"/scan": 39.96})
    assert "\n  scan: {rate_hz: 40, tolerance_hz: 4}\n" in model_from_graph(graph, "r", "a bag")


def test_a_graph_without_a_node_of_the_robots_own_is_refused() -> None:
    graph = RosGraph({"/rosout": frozenset({"/rosout"})})
    with pytest.raises(InputError, match="nowhere: there is no node of the robot's own, of 1"):
        model_from_graph(graph, "r", "nowhere")


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
    load_text(model_from_graph(graph, "r", kinds))
