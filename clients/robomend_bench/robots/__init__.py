"""The robot's side by itself and under a real service: `robomend-bench robots`.

live.py     a real agent and service: from a SIGKILL or the last message to the service; memory
ros.py      the same on a real robot with ROS 1 or ROS 2, where there is one
power.py    the paper's robot with nodes of a real ROS: power-up and shut-down
command.py  the command; observers over streams in memory: samples a second, silence, false alarms
"""
