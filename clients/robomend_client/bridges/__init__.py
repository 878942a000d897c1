"""Bridges to what robots run already, as parts of the agent: each is a feed (agent/feeds.py) that is loaded
only when the agent's file has its section.

ros1/          ROS 1: the master's XML-RPC and TCPROS, spoken on asyncio
ros2/          ROS 2: DDS, through the wheel cyclonedds
medkit/        ros2_medkit: a gateway's faults, and its restart
zenoh/         ROS 2 over zenoh: through the wheel eclipse-zenoh

What they have in common:

base.py        a bridge to ROS in general        processes.py   who has a connection open here
names.py       the model's names and ROS's       problems.py    what is wrong outside, told once
opened.py      messages of a known definition    listening.py   others' /observations
unpacking.py   a field by itself                 telling.py     what the robot is told
fields.py      fields of whole messages
"""
