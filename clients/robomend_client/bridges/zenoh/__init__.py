"""The bridge to robots with ROS 2 over zenoh (rmw_zenoh): a part of the agent, loaded when its file has a
section `zenoh:`.

It speaks zenoh through the wheel eclipse-zenoh, and needs no ROS. Messages are those of ROS 2 over DDS, so
all that reads and writes them is in ros2/.

    session.py     the wheel, and our configuration   node.py       our own node, its topics, who runs
    keys.py        ROS's names in keys, and who is    feed.py       the section `zenoh:`
                   there by them (pure)
"""
