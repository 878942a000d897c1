"""The ROS 2 bridge: a part of the agent, loaded when its file has a section `ros2:`.

It speaks DDS through the wheel cyclonedds, and needs no ROS. It listens, and publishes; it never sends a
request to a service: DDS vendors do not agree on those.

    dds.py         the wheel, and our configuration   cdr.py          the little that we read and write
    names.py       ROS's names on the wire            discovered.py   all that is known (pure)
    node.py        our own node, and its topics       stamps.py       when a sample was made
    messages.py    messages by their definitions      formats.py      the messages that go out
    liveness.py    who runs                           graph.py        the graph, for a first model
    base.py        what observers get; the bridge over zenoh derives from it, too
    feed.py        the section `ros2:`
"""
