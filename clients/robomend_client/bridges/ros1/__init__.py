"""The ROS 1 bridge: a part of the agent, loaded when its file has a section `ros1:`.

It is a ROS node without ROS: it speaks the master's XML-RPC and TCPROS itself, so that it needs no rospy, no
catkin and no distribution.

    xmlrpc.py         calls between nodes            tcpros.py          bytes of connections (sans-io)
    master.py         the master's calls             node.py            our own node
    subscription.py   a topic that comes in          publication.py     a topic that goes out
    nodes.py          who runs (pure)                liveness.py        how that is found out
    messages.py       messages by their definitions  formats.py         the messages that go out
    action_topics.py  the words of actionlib         action_server.py   actions that nodes ask for
    action_client.py  the robot's own actions        bag.py             the graph of a recording
    feed.py           the section `ros1:`, and what observers get
"""

from robomend_client.bridges.ros1.feed import Ros1

__all__ = ["Ros1"]
