"""ros2 launch robomend_ros feeder.launch.py bus:=tcp:127.0.0.1:7411 sources:=scan,odom:pose.x"""

from launch.actions import DeclareLaunchArgument
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node

from launch import LaunchDescription


def generate_launch_description():  # Python 3.8, and ROS's own type
    names = ("bus", "sources", "namespace")
    defaults = ("", "", "/")
    given = [{name: LaunchConfiguration(name)} for name in names]
    return LaunchDescription(
        [
            *(DeclareLaunchArgument(name, default_value=value) for name, value in zip(names, defaults)),
            Node(package="robomend_ros", executable="feeder", name="robomend_feeder", parameters=given),
        ]
    )
