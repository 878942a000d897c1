"""ros2 launch robomend_ros agent.launch.py file:=/etc/robomend/agent.yaml"""

from launch.actions import DeclareLaunchArgument, ExecuteProcess
from launch.substitutions import LaunchConfiguration

from launch import LaunchDescription


def generate_launch_description():  # Python 3.8, and ROS's own type
    program, file = LaunchConfiguration("program"), LaunchConfiguration("file")
    return LaunchDescription(
        [
            DeclareLaunchArgument("file", description="the agent's file"),
            DeclareLaunchArgument("program", default_value="robomend-agent"),
            # It ends the robot's processes first, which may take their stop_grace_s.
            ExecuteProcess(
                cmd=[program, file],
                name="robomend_agent",
                output="screen",
                respawn=True,
                respawn_delay=1.0,
                sigterm_timeout="15",
            ),
        ]
    )
