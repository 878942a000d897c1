"""Recordings that were published as CSV files become bags: examples/csv_to_bag.py."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path
from typing import Any

from rosbags.rosbag1 import Reader
from tests.robomend_batch.recordings import ROS1
from tests.robomend_batch.running import batch_run, logs

SCRIPT = Path(__file__).parents[2] / "examples" / "csv_to_bag.py"

JOINTS = """Time,header.seq,header.stamp.secs,header.stamp.nsecs,name,position_0,position_1,effort
1648214153.7890463,7,1648214153,111041449,"['left', 'right']",0.5,-0.25,"(1.0, 2.0)"
1648214153.8090463,8,1648214153,131041449,"['left', 'right']",0.5,,
"""
IMU = """Time,angular_velocity.z,orientation_covariance_0,orientation_covariance_1
1648214153.799,0.125,3.0,4.0
"""


def test_columns_become_the_fields_of_messages_in_the_order_of_their_times(tmp_path: Path) -> None:
    (tmp_path / "joints.csv").write_text(JOINTS)
    (tmp_path / "imu.csv").write_text(IMU)
    topics = ["joints.csv=/joints:sensor_msgs/JointState", "imu.csv=/imu/data:sensor_msgs/Imu"]
    subprocess.run([sys.executable, str(SCRIPT), "run.bag", *topics], cwd=tmp_path, check=True)
    with Reader(tmp_path / "run.bag") as reader:
        found: list[tuple[int, Any]] = [
            (time_ns, ROS1.deserialize_ros1(data, connection.msgtype))
            for connection, time_ns, data in reader.messages()
        ]
    (first_ns, joints), (_, imu), (_, last) = found
    assert first_ns == 1648214153_789046300
    assert (joints.header.seq, joints.header.stamp.nanosec) == (7, 111041449)
    assert (joints.name, list(joints.position), list(joints.effort)) == (
        ["left", "right"],
        [0.5, -0.25],
        [1.0, 2.0],
    )
    assert (imu.angular_velocity.z, imu.orientation.w) == (0.125, 0.0)
    assert list(imu.orientation_covariance) == [3.0, 4.0, *[0.0] * 7]
    assert (list(last.position), list(last.velocity)) == ([0.5], [])


def test_such_a_bag_is_a_log_like_others(tmp_path: Path) -> None:
    rows = [f"{1648214153 + number / 10:.1f},{number}.5\n" for number in range(30)]
    (tmp_path / "imu.csv").write_text("Time,angular_velocity.z\n" + "".join(rows))
    topic = "imu.csv=/imu:sensor_msgs/Imu"
    subprocess.run([sys.executable, str(SCRIPT), "run.bag", topic], cwd=tmp_path, check=True)
    (tmp_path / "model.yaml").write_text("{robomend: 1, name: r, nodes: {imu_node: {publishes: {imu: []}}}}")
    (tmp_path / "agent.yaml").write_text("topics: {imu: {rate_hz: 10, tolerance_hz: 2}}\n")
    given = (tmp_path / "run.bag", "--observers", tmp_path / "agent.yaml")
    assert batch_run(tmp_path / "out", *given, model=tmp_path / "model.yaml") == 0
    assert logs(tmp_path / "out")[0]["span_ns"]["healthy"] > 10**9
