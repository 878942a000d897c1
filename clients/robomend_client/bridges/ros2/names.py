"""ROS 2's names on the wire: /scan is `rt/scan`, std_msgs/String is `std_msgs::msg::dds_::String_`.

What begins with `rq/` and `rr/` are requests and replies of services, which the bridge only looks at.
"""

from __future__ import annotations

TOPIC = "rt/"
REQUEST = "rq/"
REQUEST_END = "Request"


def wire_topic(topic: str) -> str:
    return TOPIC + topic.strip("/")


def ros_topic(wire: str) -> str | None:
    """Return a topic's name in ROS; None of what is no topic of ROS."""
    return "/" + wire[len(TOPIC) :] if wire.startswith(TOPIC) else None


def ros_service(wire: str) -> str | None:
    """Return the name of the service whose requests these are."""
    if wire.startswith(REQUEST) and wire.endswith(REQUEST_END):
        return "/" + wire[len(REQUEST) : -len(REQUEST_END)]
    return None


def wire_type(kind: str) -> str:
    """`std_msgs/String` on the wire."""
    package, _, name = kind.rpartition("/")
    return f"{package}::msg::dds_::{name}_"


def ros_type(wire: str) -> str:
    """Return a type's name in ROS: std_msgs/String; what is none is returned as it is."""
    package, _, rest = wire.partition("::")
    room, _, name = rest.partition("::dds_::")
    if not name.endswith("_"):
        return wire
    return f"{package}/{name[:-1]}" if room == "msg" else f"{package}/{room}/{name[:-1]}"
