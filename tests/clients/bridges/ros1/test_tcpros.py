"""Bytes of TCPROS. The golden ones are from the protocol's own description (wiki.ros.org/ROS/Connection
Header).
"""

from __future__ import annotations

from contextlib import suppress

import pytest
from hypothesis import given
from hypothesis import strategies as st

from robomend_client.bridges.ros1.tcpros import (
    LONGEST_MESSAGE,
    ProtocolError,
    TcprosDecoder,
    decode_header,
    encode_header,
    frame,
)

GOLDEN = (
    b"\x20\x00\x00\x00message_definition=string data\n\n"
    b"\x25\x00\x00\x00callerid=/rostopic_4767_1316912741557"
    b"\x0a\x00\x00\x00latching=1"
    b"\x27\x00\x00\x00md5sum=992ce8a1687cec8c8bd883ec73ca41d1"
    b"\x0e\x00\x00\x00topic=/chatter"
    b"\x14\x00\x00\x00type=std_msgs/String"
)
LENGTH = b"\xb0\x00\x00\x00"


def test_the_header_of_the_protocols_description() -> None:
    fields = decode_header(GOLDEN)
    assert fields["type"] == "std_msgs/String"
    assert fields["md5sum"] == "992ce8a1687cec8c8bd883ec73ca41d1"
    assert fields["message_definition"] == "string data\n\n"
    assert encode_header(fields) == LENGTH + GOLDEN
    assert frame(b"\x05\x00\x00\x00hello") == b"\x09\x00\x00\x00\x05\x00\x00\x00hello"


def stream(*messages: bytes) -> bytes:
    return encode_header({"callerid": "/a", "md5sum": "*"}) + b"".join(map(frame, messages))


@given(messages=st.lists(st.binary(max_size=300), max_size=8), size=st.integers(1, 700), keep=st.booleans())
def test_a_stream_split_anywhere_gives_the_same_messages(
    messages: list[bytes], size: int, keep: bool
) -> None:
    decoder = TcprosDecoder(keep)
    data = stream(*messages)
    found = [m for at in range(0, len(data), size) for m in decoder.receive(data[at : at + size])]
    assert decoder.header == {"callerid": "/a", "md5sum": "*"}
    assert found == [message if keep else b"" for message in messages]


def test_what_nobody_looks_at_is_not_held() -> None:
    decoder = TcprosDecoder(keep=False)
    decoder.receive(stream())
    for _ in range(100):
        assert decoder.receive(frame(bytes(1_000_000))[:500_000]) == []
        assert decoder.receive(bytes(500_004)) == [b""]
        assert len(decoder._buffer) == 0


@given(messages=st.lists(st.binary(max_size=300), min_size=1, max_size=8), size=st.integers(1, 700))
def test_the_longest_message_is_known_as_soon_as_its_length_is(messages: list[bytes], size: int) -> None:
    for keep in (True, False):
        decoder = TcprosDecoder(keep)
        decoder.receive(stream())
        data = b"".join(map(frame, messages))
        for at in range(0, len(data), size):
            decoder.receive(memoryview(data)[at : at + size])
        assert decoder.longest == max(map(len, messages))
        decoder.receive(frame(bytes(1000))[:4])
        assert decoder.longest == 1000


@given(garbage=st.binary(max_size=200))
def test_garbage_is_a_protocol_error_or_waits_for_more(garbage: bytes) -> None:
    for start in (b"", stream()):
        with suppress(ProtocolError):
            TcprosDecoder(keep=True).receive(start + garbage)


@pytest.mark.parametrize(
    ("data", "why"),
    [
        (b"HTTP/1.1 400 Bad Request\r\n\r\n", "a header that is too long: 1347703880 bytes"),
        (frame(frame(b"no equals sign")), "a header field without `=`"),
        (frame(b"\xff\x00\x00\x00ab"), "a header field that is longer than its header: 255 bytes"),
        (frame(b"ab"), "a header that breaks off"),
        (
            stream() + (LONGEST_MESSAGE + 1).to_bytes(4, "little"),
            "message that is too long: 268435457 bytes",
        ),
    ],
)
def test_what_is_wrong_is_said(data: bytes, why: str) -> None:
    with pytest.raises(ProtocolError, match=why):
        TcprosDecoder(keep=True).receive(data)
