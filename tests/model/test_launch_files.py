"""Launch files: nodes, names, remaps, components; what cannot be told is a question, and nothing is run."""

from __future__ import annotations

from pathlib import Path

import pytest

from robomend.errors import InputError
from robomend.model.launch_files import LaunchedNode, read_launch

ROS1 = """<?xml version="1.0"?>
<launch>
  <arg name="robot" default="r1"/>
  <arg name="with_camera" default="false"/>
  <arg name="port"/>
  <remap from="odom" to="/wheel/odom"/>
  <group ns="$(arg robot)">
    <node pkg="hokuyo_node" type="hokuyo_node" name="laser" respawn="true">
      <remap from="scan" to="front/scan"/>
    </node>
    <node pkg="usb_cam" type="usb_cam_node" name="camera" if="$(arg with_camera)"/>
    <node pkg="joy" type="joy_node" name="joy" unless="$(arg with_camera)"/>
    <node pkg="x" type="y" name="on_port" if="$(arg port)"/>
    <node pkg="nodelet" type="nodelet" name="manager" args="manager"/>
    <node pkg="nodelet" type="nodelet" name="filter" args="load pcl/VoxelGrid manager"/>
  </group>
  <node pkg="tf" type="static_transform_publisher" name="$(anon base)" args="0 0 0 0 0 0 a b 100"/>
  <node pkg="z" type="z" name="$(eval 'a' + 'b')"/>
  <include file="$(find nav)/launch/move_base.launch" ns="nav"><arg name="rate" value="5"/></include>
  <include file="$(find other)/launch/other.launch"/>
</launch>
"""

INCLUDED = """<launch>
  <arg name="rate" default="1"/>
  <node pkg="move_base" type="move_base" name="move_base_$(arg rate)"/>
</launch>
"""


def test_a_launch_file_of_ros_1() -> None:
    def read(name: str) -> str | None:
        return INCLUDED if name == "[nav]/launch/move_base.launch" else None

    found = read_launch(ROS1, "robot.launch", read)
    wheel = ("odom", "/wheel/odom")
    assert {node.name: node for node in found.nodes} == {
        one.name: one
        for one in (
            LaunchedNode("/r1/laser", "hokuyo_node", "hokuyo_node", (wheel, ("scan", "/r1/front/scan"))),
            LaunchedNode("/r1/joy", "joy", "joy_node", (wheel,)),
            LaunchedNode("/r1/on_port", "x", "y", (wheel,), sure=False),
            LaunchedNode("/r1/manager", "nodelet", "nodelet", (wheel,)),
            LaunchedNode("/r1/filter", "nodelet", "pcl/VoxelGrid", (wheel,), "/r1/manager"),
            LaunchedNode("/base", "tf", "static_transform_publisher", (wheel,)),
            LaunchedNode("/nav/move_base_5", "move_base", "move_base", (wheel,)),
        )
    }
    assert found.questions == (
        "robot.launch: what is the node `$(eval 'a' + 'b')` of z called?",
        "robot.launch: what does `$(find other)/launch/other.launch` start, which it includes?",
    )


ROS2 = """
<launch>
  <arg name="ns" default="r2"/>
  <let name="camera" value="front"/>
  <group>
    <push-ros-namespace namespace="$(var ns)"/>
    <node pkg="urg_node" exec="urg_node_driver" name="laser" namespace="sensors">
      <remap from="scan" to="/scan"/>
    </node>
    <node_container pkg="rclcpp_components" exec="component_container" name="cameras" namespace="">
      <composable_node pkg="image_proc" plugin="image_proc::RectifyNode" name="rectify_$(var camera)"/>
    </node_container>
    <load_composable_node target="cameras">
      <composable_node pkg="image_proc" plugin="image_proc::DebayerNode" if="$(env FAST)"/>
    </load_composable_node>
  </group>
  <node pkg="rviz2" exec="rviz2"/>
</launch>
"""

ROS2_YAML = """
launch:
- arg: {name: ns, default: r2}
- let: {name: camera, value: front}
- group:
  - push_ros_namespace: {namespace: $(var ns)}
  - node:
      pkg: urg_node
      exec: urg_node_driver
      name: laser
      namespace: sensors
      remap:
      - {from: scan, to: /scan}
  - node_container:
      pkg: rclcpp_components
      exec: component_container
      name: cameras
      namespace: ''
      composable_node:
      - {pkg: image_proc, plugin: "image_proc::RectifyNode", name: rectify_$(var camera)}
  - load_composable_node:
      target: cameras
      composable_node:
      - {pkg: image_proc, plugin: "image_proc::DebayerNode", if: $(env FAST)}
- node: {pkg: rviz2, exec: rviz2}
"""

ROS2_PYTHON = """
import os
from ament_index_python.packages import get_package_share_directory
from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument, GroupAction
from launch.conditions import IfCondition
from launch.substitutions import EnvironmentVariable, LaunchConfiguration
from launch_ros.actions import ComposableNodeContainer, LoadComposableNodes, Node, PushRosNamespace
from launch_ros.descriptions import ComposableNode

open("/tmp/this-was-run", "w")


def generate_launch_description():
    camera = "front"
    laser = Node(
        package="urg_node",
        executable="urg_node_driver",
        name="laser",
        namespace="sensors",
        remappings=[("scan", "/scan")],
        parameters=[os.path.join(get_package_share_directory("x"), "config", "x.yaml")],
    )
    group = GroupAction(
        actions=[
            PushRosNamespace(LaunchConfiguration("ns")),
            laser,
            ComposableNodeContainer(
                package="rclcpp_components",
                executable="component_container",
                name="cameras",
                namespace="",
                composable_node_descriptions=[
                    ComposableNode(package="image_proc", plugin="image_proc::RectifyNode", name=f"rectify_{camera}")
                ],
            ),
            LoadComposableNodes(
                target_container="cameras",
                condition=IfCondition(EnvironmentVariable("FAST")),
                composable_node_descriptions=[
                    ComposableNode(package="image_proc", plugin="image_proc::DebayerNode"),
                ],
            ),
        ]
    )
    return LaunchDescription(
        [DeclareLaunchArgument("ns", default_value="r2"), group, Node(package="rviz2", executable="rviz2")]
    )
"""  # noqa: E501  # as people write it


@pytest.mark.parametrize(
    ("text", "file"), [(ROS2, "r.xml"), (ROS2_YAML, "r.yaml"), (ROS2_PYTHON, "r.launch.py")]
)
def test_launch_files_of_ros_2_say_the_same_in_each_of_their_forms(text: str, file: str) -> None:
    found = read_launch(text, file)
    assert {node.name: node for node in found.nodes} == {
        one.name: one
        for one in (
            LaunchedNode("/r2/sensors/laser", "urg_node", "urg_node_driver", (("scan", "/scan"),)),
            LaunchedNode("/r2/cameras", "rclcpp_components", "component_container"),
            LaunchedNode("/r2/rectify_front", "image_proc", "image_proc::RectifyNode", (), "/r2/cameras"),
            LaunchedNode(
                "/r2/DebayerNode", "image_proc", "image_proc::DebayerNode", (), "/r2/cameras", sure=False
            ),
            LaunchedNode("/rviz2", "rviz2", "rviz2"),
        )
    }
    assert [one.partition(": ")[2] for one in found.questions] == [
        "is image_proc/image_proc::DebayerNode called DebayerNode? It is not said",
        "is rviz2/rviz2 called rviz2? It is not said",
    ]


def test_python_is_read_and_not_run() -> None:
    mark = Path("/tmp/this-was-run")
    assert not mark.exists()
    read_launch(ROS2_PYTHON, "r.launch.py")
    assert not mark.exists()


def test_what_python_works_out_is_a_question() -> None:
    text = """
from launch import LaunchDescription
from launch_ros.actions import Node

def generate_launch_description():
    nodes = []
    for number in range(4):
        nodes.append(Node(package="p", executable="e", name=f"node{number}"))
    name = open("name").read()
    nodes.append(Node(package="p", executable="e", name=name))
    if len(name) > 3:
        nodes.append(Node(package="p", executable="e", name="long"))
    nodes.append(Node(package="p", executable="e", name="fixed", remappings=[("a", name), ("b", "c")]))
    nodes.append(IncludeLaunchDescription(PythonLaunchDescriptionSource(
        os.path.join(get_package_share_directory("nav2_bringup"), "launch", name, "bringup_launch.py"))))
    return LaunchDescription(nodes)
"""
    found = read_launch(text, "r.launch.py")
    assert found.nodes == (
        LaunchedNode("/long", "p", "e", sure=False),
        LaunchedNode("/fixed", "p", "e", (("b", "/c"),)),
    )
    assert found.questions == (
        "r.launch.py, line 8: what is the node of p/e called, in a loop?",
        "r.launch.py, line 10: what is the node of p/e called?",
        "r.launch.py, line 13: what is a remapped to?",
        "r.launch.py, line 14: what does bringup_launch.py start, which it includes?",
    )


@pytest.mark.parametrize(
    "text",
    [
        "", "<robot/>", "<launch>", "name: x\n", "launch: [\n", "print('x')\n",
        "from launch import LaunchDescription\n(", "<!DOCTYPE x [<!ENTITY a 'b'>]><launch>&a;</launch>",
    ],
)  # fmt: skip
def test_what_is_no_launch_file_is_refused(text: str) -> None:
    with pytest.raises(InputError):
        read_launch(text, "x")


def test_files_that_include_themselves_come_to_an_end() -> None:
    node = '<node pkg="p" type="t" name="n"/>'
    text = f'<launch><include file="a.launch"/><include file="b.launch"/>{node}</launch>'
    found = read_launch(text, "a.launch", lambda name: text)
    assert [node.name for node in found.nodes] == ["/n"]
    assert any("include each other too often" in one for one in found.questions)


INCLUDING = """
import os
from ament_index_python.packages import get_package_share_directory
from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument, IncludeLaunchDescription
from launch.launch_description_sources import PythonLaunchDescriptionSource
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node, PushRosNamespace


def generate_launch_description():
    model = os.environ["MODEL"]
    if model == "a":
        lidar = LaunchConfiguration("lidar", default=os.path.join(get_package_share_directory("a"), "launch"))
    else:
        lidar = LaunchConfiguration("lidar", default=os.path.join(get_package_share_directory("b"), "launch"))
    namespace = LaunchConfiguration("namespace", default="r3")
    usual = [("/tf", "tf")]
    full = (namespace, "/", "front")
    return LaunchDescription([
        DeclareLaunchArgument("namespace", default_value=namespace),
        PushRosNamespace(namespace),
        IncludeLaunchDescription(
            PythonLaunchDescriptionSource(
                [os.path.join(get_package_share_directory("up"), "launch", "up.py")]
            ),
            launch_arguments={"called": "state", "namespace": namespace}.items(),
        ),
        IncludeLaunchDescription(PythonLaunchDescriptionSource([lidar, "/lidar.launch.py"])),
        Node(package="base", executable="base", name="base", remappings=usual + [("cmd_vel", "/cmd_nav")]),
    ])
"""

UP = """
from launch import LaunchDescription
def generate_launch_description():
    called = LaunchConfiguration("called")
    return LaunchDescription([Node(package="up", executable="up", name=[called, "_publisher"])])
"""


def test_namespaces_arguments_and_remaps_go_through_a_launch_description_as_robots_have_it() -> None:
    found = read_launch(INCLUDING, "r.py", lambda name: UP if name == "[up]/launch/up.py" else None)
    assert {node.name: node.remaps for node in found.nodes} == {
        "/r3/state_publisher": (),
        "/r3/base": (("/tf", "/r3/tf"), ("cmd_vel", "/cmd_nav")),
    }
    assert found.questions == ("r.py, line 29: what does /lidar.launch.py start, which it includes?",)


def test_a_file_beside_it_is_read_and_a_remap_that_changes_nothing_is_not_said() -> None:
    text = """
from launch import LaunchDescription
here = os.path.dirname(os.path.realpath(__file__))
remaps = [("/tf", "tf"), ("scan", "/front/scan")]
def generate_launch_description():
    return LaunchDescription([
        IncludeLaunchDescription(PythonLaunchDescriptionSource([ThisLaunchFileDir(), "/first.launch.py"])),
        IncludeLaunchDescription(PythonLaunchDescriptionSource(os.path.join(here, "second.launch.py"))),
        Node(package="nav", executable="planner", name="planner", remappings=remaps),
    ])
"""
    beside = 'LaunchDescription([Node(package="a", executable="b", name="{}")])'
    files = {f"./{name}.launch.py": beside.format(name) for name in ("first", "second")}
    found = read_launch(text, "robot.launch.py", files.get)
    assert {node.name: node.said for node in found.nodes} == {
        "/first": "a/b",
        "/second": "a/b",
        "/planner": "nav/planner, scan is /front/scan",
    }
    assert found.questions == ()
