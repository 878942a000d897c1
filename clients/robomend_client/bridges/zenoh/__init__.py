"""The bridge to robots with ROS 2 over zenoh (rmw_zenoh): a part of the agent, loaded when its file has a
section `zenoh:`.

It speaks zenoh through the wheel eclipse-zenoh, and needs no ROS. Messages are those of ROS 2 over DDS, so
all that reads and writes them is in ros2/.

    session.py     the wheel, and our configuration   keys.py       ROS's names in keys (pure)
    graph.py       who is there (pure)                liveness.py   which nodes run
    topics.py      a topic that comes in, or goes out node.py       our own node
    feed.py        the section `zenoh:`
"""
