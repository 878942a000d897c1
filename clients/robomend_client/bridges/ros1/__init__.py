"""The ROS 1 bridge: a part of the agent, loaded when its file has a section `ros1:`.

It is a ROS node without ROS: it speaks the master's XML-RPC and TCPROS itself, so that it needs no rospy, no
catkin and no distribution.

    xmlrpc.py         calls between nodes            tcpros.py          bytes of connections (sans-io)
    master.py         the master's calls             node.py            our own node
    subscription.py   a topic that comes in          publication.py     a topic that goes out
    liveness.py       who runs                       bag.py             the graph of a recording
    messages.py       messages by their definitions  formats.py         the messages that go out
    actions.py        actionlib, both ways           asking.py          services and parameters
    feed.py           the section `ros1:`, and what observers get
"""

from robomend_client.bridges.ros1.feed import Ros1

__all__ = ["Ros1"]
