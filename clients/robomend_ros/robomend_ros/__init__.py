"""A thin node of ROS 2 beside an agent of robomend, in the robot's own Python (3.8 on) and its own ROS.

feeder.py     topics, their fields and the list of nodes to the agent's bus
lifecycle.py  one lifecycle change, for the agent's `actions:`
action.py     one goal of an action server, for the agent's `actions:`
bus.py        the agent's bus: lines of JSON
"""
