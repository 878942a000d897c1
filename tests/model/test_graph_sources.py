"""Dumps of a graph, analyzers and launch files as sources of a model, alone and on top of each other."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from robomend.cli.commands import run
from robomend.errors import InputError
from robomend.model.graph_sources import read_analyzers, read_dump
from robomend.model.loading import load_text

ROS1_INFO = """--------------------------------------------------------------------------------
Node [/laser]
Publications:
 * /rosout [rosgraph_msgs/Log]
 * /scan [sensor_msgs/LaserScan]

Subscriptions: None

Services:
 * /laser/get_loggers


contacting node http://robot:41135/ ...
Pid: 4711
Connections:
 * topic: /scan
    * to: /mapper
    * direction: outbound
--------------------------------------------------------------------------------
Node [/mapper]
Publications:
 * /map [nav_msgs/OccupancyGrid]

Subscriptions:
 * /scan [sensor_msgs/LaserScan]

Services: None
"""

ROS2_INFO = """/laser
  Subscribers:

  Publishers:
    /parameter_events: rcl_interfaces/msg/ParameterEvent
    /scan: sensor_msgs/msg/LaserScan
  Service Servers:
    /laser/describe_parameters: rcl_interfaces/srv/DescribeParameters
  Service Clients:
    /other/service: std_srvs/srv/Empty
  Action Servers:

  Action Clients:

/mapper
  Subscribers:
    /scan: sensor_msgs/msg/LaserScan
  Publishers:
    /map: nav_msgs/msg/OccupancyGrid
"""

ROSGRAPH = """Nodes:
  /laser :
    Inbound:
    Outbound:
      /scan
  /mapper :
    Inbound:
      /scan
    Outbound:
      /map
"""

DOT_TOPICS = """digraph graphname {
  n___laser [label="/laser", shape=ellipse, pos="1,2"];
  n___mapper [label="/mapper", shape=ellipse];
  t___scan [label="/scan", shape=box];
  t___map [label="/map", shape=box];
  n___laser -> t___scan [penwidth=1];
  t___scan -> n___mapper;
  n___mapper -> t___map;
}
"""

STATE = [
    [["/scan", ["/laser"]], ["/map", ["/mapper"]]],
    [["/scan", ["/mapper"]]],
    [["/laser/get_loggers", ["/laser"]]],
]

DUMPS = {
    "rosnode info": ROS1_INFO,
    "ros2 node info": ROS2_INFO,
    "rosgraph": ROSGRAPH,
    "rqt_graph": DOT_TOPICS,
    "getSystemState": json.dumps(STATE),
    "getSystemState with its code": json.dumps([1, "current system state", STATE]),
    "JSON": json.dumps(
        {"publishers": {"/scan": ["/laser"], "/map": ["/mapper"]}, "subscribers": {"/scan": ["/mapper"]}}
    ),
}


@pytest.mark.parametrize("name", DUMPS)
def test_a_dump_of_the_graph_is_read_in_whatever_form(name: str) -> None:
    graph = read_dump(DUMPS[name], "dump.txt")
    publishers = {topic: nodes for topic, nodes in graph.publishers.items() if topic in ("/scan", "/map")}
    assert publishers == {"/scan": {"/laser"}, "/map": {"/mapper"}}
    assert graph.subscribers == {"/scan": {"/mapper"}}


def test_what_is_no_dump_is_refused() -> None:
    for text in ("", "hello\n", "[1, 2]", "{}", "digraph {}"):
        with pytest.raises(InputError):
            read_dump(text, "dump.txt")


ANALYZERS = """
analyzers:
  ros__parameters:
    path: Robot
    sensors:
      type: diagnostic_aggregator/AnalyzerGroup
      path: Sensors
      analyzers:
        laser:
          type: diagnostic_aggregator/GenericAnalyzer
          path: Laser
          startswith: [laser]
          num_items: 1
        imu:
          type: diagnostic_aggregator/GenericAnalyzer
          path: IMU
          contains: 'imu'
    power:
      type: diagnostic_aggregator/GenericAnalyzer
      path: Power
      expected: ['battery: state', 'charger']
"""


def test_analyzers_name_statuses_by_group() -> None:
    assert read_analyzers(ANALYZERS, "analyzers.yaml") == {
        "laser*": "Robot/Sensors/Laser",
        "*imu*": "Robot/Sensors/IMU",
        "battery: state": "Robot/Power",
        "charger": "Robot/Power",
    }
    with pytest.raises(InputError, match="no analyzers"):
        read_analyzers("a: 1\n", "x.yaml")


LAUNCH = """<launch>
  <node pkg="urg_node" type="urg_node" name="laser"/>
  <node pkg="gmapping" type="slam_gmapping" name="mapper"><remap from="map" to="/global/map"/></node>
  <node pkg="camera" type="camera" name="camera" if="$(arg camera)"/>
</launch>
"""


def _files(folder: Path) -> dict[str, str]:
    files = {"launch": LAUNCH, "dump": ROS1_INFO, "analyzers": ANALYZERS}
    for name, text in files.items():
        (folder / name).write_text(text)
    return {name: str(folder / name) for name in files}


def test_sources_are_put_on_top_of_each_other(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    files = _files(tmp_path)
    given = [part for name in files for part in (f"--{name}", files[name])]
    assert run(["model", "from-ros", *given]) == 0
    text = capsys.readouterr().out
    system = load_text(text)
    assert system.cnf.components == ("laser", "mapper")
    assert "      map: [scan]    # nav_msgs/OccupancyGrid" in text
    assert "#   camera (camera/camera; it may not be started) is launched and was not there: why?" in text
    assert "  laser2: {}    # laser*" in text
    assert "  - 'not ab(laser) -> ok(laser2)'" in text
    assert "of which node does the status 'charger' speak?" in text


def test_what_a_launch_file_includes_is_looked_for_beside_it(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = tmp_path / "bringup" / "launch"
    folder.mkdir(parents=True)
    (folder / "all.launch").write_text(
        '<launch><include file="$(find bringup)/launch/laser.launch"/>\n'
        '<include file="$(dirname)/up.launch"/></launch>'
    )
    (folder / "laser.launch").write_text('<launch><node pkg="p" type="t" name="laser"/></launch>')
    (folder / "up.launch").write_text('<launch><node pkg="p" type="t" name="up"/></launch>')
    assert run(["model", "from-ros", "--launch", str(folder / "all.launch")]) == 0
    assert load_text(capsys.readouterr().out).cnf.components == ("laser", "up")
