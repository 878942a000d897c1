"""Keys, tokens and attachments as values, by the examples of rmw_zenoh's own documentation."""

from __future__ import annotations

import struct
from contextlib import suppress
from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st
from rosbags.typesys import Stores, get_typestore

from robomend_client.bridges.zenoh.keys import (
    CLIENT,
    KINDS,
    NODE,
    PUBLISHER,
    SERVER,
    SOMEBODY,
    SUBSCRIBER,
    Attachment,
    BadKey,
    Graph,
    LivelinessToken,
    attach,
    gid,
    message_key,
    parse_token,
    read_attachment,
    token_key,
    type_of,
)
from robomend_client.bridges.zenoh.node import HASHES, _of

STRING = "std_msgs::msg::dds_::String_"
HASH = "RIHS01_df668c740482bbd48fb39d76a70dfd4bd59db1288021743503259e948f6b1a18"
LISTENER = "@ros2_lv/2/aac3178e146ba6f1fc6e6a4085e77f21/0/0/NN/%/%/listener"
TALKER = (
    f"@ros2_lv/2/8b20917502ee955ac4476e0266340d5c/0/10/MP/%/%/talker/%chatter/{STRING}/{HASH}/::,7:,:,:,,"
)


def test_the_examples_of_the_documentation_are_read() -> None:
    session = "aac3178e146ba6f1fc6e6a4085e77f21"
    assert parse_token(LISTENER) == LivelinessToken(2, session, NODE, "/listener")
    talker = parse_token(TALKER)
    assert (talker.kind, talker.node, talker.topic) == (PUBLISHER, "/talker", "/chatter")
    assert (talker.type, talker.type_hash, talker.latched, talker.entity_id) == (STRING, HASH, False, "10")
    deep = parse_token(
        "@ros2_lv/0/a/1/2/MP/%/%front%left/camera/%robot1%image/T/TypeHashNotSupported/2:1:,1:,:,:,,"
    )
    assert (deep.node, deep.topic, deep.type_hash, deep.latched) == (
        "/front/left/camera",
        "/robot1/image",
        "",
        True,
    )


def test_the_keys_of_messages_are_those_of_the_documentation() -> None:
    assert message_key(0, "/robot1/chatter", STRING, HASH) == f"0/robot1/chatter/{STRING}/{HASH}"
    assert type_of(f"0/robot1/chatter/{STRING}/{HASH}") == (STRING, HASH)
    assert type_of("0/chatter/T/TypeHashNotSupported") == ("T", "")


names = st.from_regex(r"[a-z][a-z0-9_]{0,8}", fullmatch=True)
paths = st.lists(names, min_size=1, max_size=3).map(lambda parts: "/" + "/".join(parts))


@given(st.integers(0, 232), st.sampled_from(KINDS), paths, paths, names, st.sampled_from([HASH, ""]))
def test_a_token_comes_back_as_it_was_written(
    domain: int, kind: str, node: str, topic: str, wire: str, type_hash: str
) -> None:
    token = LivelinessToken(domain, "a1b2", kind, node, node_id="3", entity_id="4")
    if kind != NODE:
        token = replace(token, topic=topic, type=wire, type_hash=type_hash)
    assert parse_token(token_key(token)) == token


@given(st.lists(st.one_of(st.text(max_size=5), st.sampled_from(["@ros2_lv", "0", "NN", "MP", "%", ""]))))
def test_garbage_is_no_token_and_nothing_else_happens(parts: list[str]) -> None:
    with suppress(BadKey):
        parse_token("/".join(parts))
    with suppress(BadKey):
        Graph().add("/".join(parts))


@given(st.binary(max_size=80), st.booleans())
def test_garbage_is_no_attachment_and_nothing_else_happens(data: bytes, named: bool) -> None:
    read_attachment(data + b"source_timestamp" + data if named else data)


def test_what_is_attached_by_each_release_says_the_same() -> None:
    token = bytes(range(16))
    stamps = struct.pack("<qq", 7, 1_700_000_000_000_000_001)
    bare = Attachment(7, 1_700_000_000_000_000_001, token)
    assert read_attachment(attach(bare)) == bare
    assert attach(bare) == stamps + b"\x10" + token
    assert read_attachment(stamps + token) == bare
    parts = (b"\x0fsequence_number", stamps[:8], b"\x10source_timestamp", stamps[8:], b"\x0asource_gid")
    named = read_attachment(b"".join(parts) + b"\x10" + token[::-1])
    assert named is not None
    assert (named.stamp_ns, named.gid) == (bare.stamp_ns, token)
    assert read_attachment(b"") is None
    assert read_attachment(b"x" * 40 + b"y") is None


@pytest.mark.parametrize("kind", HASHES)
def test_the_hashes_that_we_publish_under_are_those_of_every_release(kind: str) -> None:
    package, _, short = kind.partition("/")
    for store in Stores:
        if store.name.startswith("ROS2_"):
            assert get_typestore(store).hash_rihs01(f"{package}/msg/{short}") == HASHES[kind]


# --- the graph ---------------------------------------------------------------------------------------------


def key(kind: str, node: str, topic: str = "", wire: str = STRING, session: str = "a") -> str:
    what = () if kind == NODE else (topic, wire, HASH)
    return token_key(LivelinessToken(0, session, kind, node, *what))


def test_a_graph_has_nodes_topics_and_services_of_others() -> None:
    graph = Graph()
    graph.own = "us"
    for told in (
        *(key(NODE, "/laser"), key(PUBLISHER, "/laser", "/scan"), key(NODE, "/mapper", session="b")),
        *(
            key(SUBSCRIBER, "/mapper", "/scan"),
            key(SERVER, "/mapper", "/save"),
            key(CLIENT, "/laser", "/save"),
        ),
        *(key(NODE, "/robomend", session="us"), key(SUBSCRIBER, "/robomend", "/scan", session="us")),
        key(PUBLISHER, "/mapper", "/dock/_action/status"),
    ):
        graph.add(told)
    found = graph.graph()
    assert found.publishers == {"/scan": {"/laser"}}
    assert found.subscribers == {"/scan": {"/mapper"}}
    assert found.services == {"/save": {"/mapper"}}
    assert found.types == {"/scan": "std_msgs/String"}
    assert graph.sessions() == {"a", "b"}
    assert graph.nodes({"b"}) == {"/laser": True, "/mapper": False, "/robomend": True}
    graph.remove(key(NODE, "/laser"))
    graph.remove(key(NODE, "/laser"))  # it has gone already
    assert graph.nodes()["/laser"] is False


def test_two_nodes_of_one_name_run_while_one_of_them_does() -> None:
    graph = Graph()
    for session in ("a", "b"):
        graph.add(key(NODE, "/laser", session=session))
    graph.remove(key(NODE, "/laser", session="a"))
    assert graph.nodes() == {"/laser": True}


def test_a_message_names_its_publisher_by_the_hash_or_where_there_is_only_one() -> None:
    graph = Graph()
    first, second = key(PUBLISHER, "/laser", "/scan"), key(PUBLISHER, "/camera", "/scan")
    graph.add(first)
    assert graph.publisher(b"", "/scan", STRING) == "/laser"
    graph.add(second)
    assert graph.publisher(b"", "/scan", STRING) == SOMEBODY
    assert graph.publisher(gid(second), "/scan", STRING) == "/camera"
    assert graph.publisher(gid(second)[::-1], "/scan", STRING) == SOMEBODY
    assert [token.node for token in graph.publishers("/scan")] == ["/laser", "/camera"]


@pytest.mark.parametrize("linked", ["b20905ee", "b2095ee", "20905ee"])
def test_a_link_leads_to_the_nodes_of_its_session_however_its_number_is_written(linked: str) -> None:
    padded = linked.zfill(8)
    short = "".join(f"{int(padded[n : n + 2], 16):x}" for n in range(0, 8, 2))
    for session in (linked, padded, short):
        assert list(_of({linked: False, "c0de": True}, session)) == [False]


def test_a_publishers_hash_is_that_of_its_token() -> None:
    """As an independent implementation (pyzeros 0.1.0) has it of the documentation's talker."""
    assert gid(TALKER).hex() == "ac170f31eadcd9ff0cd86d7a17907d1c"
