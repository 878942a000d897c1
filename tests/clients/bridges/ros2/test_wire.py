"""What the bridge reads and writes itself, against rosbags' reading and writing of the same types."""

from __future__ import annotations

from contextlib import suppress
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from rosbags.typesys import Stores, get_typestore

from robomend_client.bridges.ros2 import cdr, formats
from robomend_client.bridges.ros2.cdr import BadCdr, Entities, NodeEntities
from robomend_client.bridges.ros2.names import ros_service, ros_topic, ros_type, wire_topic, wire_type

INFO = "rmw_dds_common/msg/ParticipantEntitiesInfo"
KEY = bytes(range(16))
RELEASES = ((Stores.ROS2_HUMBLE, 24), (Stores.ROS2_JAZZY, 16))

names = st.text(st.characters(codec="utf-8", exclude_characters="\0/"), min_size=1, max_size=20)
keys = st.lists(st.binary(min_size=16, max_size=16), max_size=3).map(tuple)
nodes = st.builds(NodeEntities, st.tuples(names, names).map("/".join).map("/{}".format), keys, keys)
whole = st.builds(
    Entities,
    st.binary(min_size=16, max_size=16),
    st.lists(nodes, max_size=3).map(tuple),
    st.sampled_from([16, 24]),
)


@given(whole)
def test_a_participants_nodes_come_back_as_they_were_told(said: Entities) -> None:
    found = cdr.decode(cdr.encode(said))
    assert (found.participant, found.nodes) == (said.participant, said.nodes)


@pytest.mark.parametrize(("release", "size"), RELEASES)
def test_rosbags_reads_the_same_out_of_our_message(release: Stores, size: int) -> None:
    store = get_typestore(release)
    told = NodeEntities("/sensors/laser", (KEY,), (KEY[::-1], KEY))
    message: Any = store.deserialize_cdr(cdr.encode(Entities(KEY, (told,), size)), INFO)
    (node,) = message.node_entities_info_seq
    assert bytes(message.gid.data)[:16] == KEY
    assert (node.node_namespace, node.node_name) == ("/sensors", "laser")
    assert [bytes(gid.data)[:16] for gid in node.writer_gid_seq] == [KEY[::-1], KEY]


@pytest.mark.parametrize(("release", "size"), RELEASES)
@pytest.mark.parametrize("little", [True, False])
def test_we_read_what_rosbags_writes(release: Stores, size: int, little: bool) -> None:
    store = get_typestore(release)
    types: Any = store.types
    gid = types["rmw_dds_common/msg/Gid"](data=np.frombuffer(KEY.ljust(size, b"\0"), np.uint8))
    node = types["rmw_dds_common/msg/NodeEntitiesInfo"](
        node_namespace="/", node_name="laser", reader_gid_seq=[], writer_gid_seq=[gid]
    )
    message = types[INFO](gid=gid, node_entities_info_seq=[node])
    body = store.serialize_cdr(message, INFO, little_endian=little)
    assert cdr.decode(bytes(body)) == Entities(KEY, (NodeEntities("/laser", (), (KEY,)),), size)


@given(st.binary(max_size=200))
def test_garbage_is_refused_and_nothing_else_happens(data: bytes) -> None:
    for head in (b"", b"\0\1\0\0"):
        with suppress(BadCdr):
            cdr.decode(head + data)


def result(*bad: str) -> dict[str, Any]:
    one = {"bad": list(bad), "good": ["mapper"], "text": "laser is broken"}
    return {"diagnoses": [one], "complete": True, "conflicts": [{"components": ["laser"], "text": "silent"}]}


def test_diagnostics_are_what_rosbags_reads_as_such() -> None:
    store = get_typestore(Stores.ROS2_JAZZY)
    body = formats.diagnostics(result("laser"), "", 1_500_000_000)
    message: Any = store.deserialize_cdr(body, "diagnostic_msgs/msg/DiagnosticArray")
    assert (message.header.stamp.sec, message.header.stamp.nanosec) == (1, 500_000_000)
    laser, mapper = message.status
    assert (laser.name, laser.level, laser.hardware_id) == ("robomend: laser", 2, "laser")
    values = {pair.key: pair.value for pair in laser.values}
    assert values == {"in diagnoses": "1 of 1", "diagnosis 1": "laser is broken", "because 1": "silent"}
    assert (mapper.name, mapper.level, mapper.values) == ("robomend: mapper", 0, [])


def test_names_on_the_wire_and_back() -> None:
    assert ros_topic(wire_topic("/robot1/scan")) == "/robot1/scan"
    assert ros_type(wire_type("std_msgs/String")) == "std_msgs/String"
    assert ros_type("example::srv::dds_::Add_Request_") == "example/srv/Add_Request"
    assert ros_type("Shape") == "Shape"
    assert ros_topic("rq/laser/get_parametersRequest") is None
    assert ros_service("rq/laser/get_parametersRequest") == "/laser/get_parameters"
    assert ros_service("rr/laser/get_parametersReply") is None
