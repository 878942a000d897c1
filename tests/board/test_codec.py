"""The layout is witnessed by golden frames of the board's protocol, never by our own encoder."""

from __future__ import annotations

import itertools
import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from robomend.board.codec import (
    HEADER,
    MAX_BODY,
    MAX_BUFFER,
    MESSAGES,
    Acknowledge,
    Broadcast,
    ChannelLimits,
    ChannelReading,
    Code,
    Decoder,
    Measurements,
    Message,
    Request,
    Specification,
    SwitchChannel,
    Unreadable,
    encode,
)
from robomend.errors import LocalProtocolError, RemoteProtocolError

TEN_AMPERES = "00 00 20 41 00 00 C0 41"  # 10 A, 24 V
ON = "01 00 00 C0 3F 00 00 C0 41"  # on at 1.5 A, 24 V
OFF = "00 00 00 00 00 00 00 00 00"

GOLDEN: list[tuple[str, Message]] = [
    (f"02 00 41 00 08 {TEN_AMPERES * 8}", Specification((ChannelLimits(10.0, 24.0),) * 8)),
    (f"02 00 51 00 0A {TEN_AMPERES * 10}", Specification((ChannelLimits(10.0, 24.0),) * 10)),
    ("02 01 01 00 C8", Broadcast(200)),
    (
        f"02 02 49 00 08 {ON} {OFF * 7}",
        Measurements((ChannelReading(True, 1.5, 24.0), *(ChannelReading(False, 0.0, 0.0),) * 7)),
    ),
    (f"02 02 5B 00 0A {ON * 10}", Measurements((ChannelReading(True, 1.5, 24.0),) * 10)),
    ("02 03 00 00", Request()),
    ("02 04 02 00 03 01", SwitchChannel(3, 1)),
    ("02 05 01 00 00", Acknowledge(Code.OK)),
]


def decode(data: bytes, decoder: Decoder | None = None) -> list[Message | Unreadable]:
    decoder = decoder or Decoder()
    decoder.receive(data)
    messages = []
    while (message := decoder.next_message()) is not None:
        messages.append(message)
    return messages


amounts = st.none() | st.floats(0, 1e6, width=32)
bytes_u8 = st.integers(0, 255)
messages = st.one_of(
    st.builds(Specification, st.lists(st.builds(ChannelLimits, amounts, amounts), max_size=12).map(tuple)),
    st.builds(Broadcast, bytes_u8),
    st.builds(
        Measurements,
        st.lists(st.builds(ChannelReading, st.booleans(), amounts, amounts), max_size=12).map(tuple),
    ),
    st.just(Request()),
    st.builds(SwitchChannel, bytes_u8, st.sampled_from([0, 1])),
    st.builds(Acknowledge, bytes_u8),
)


@pytest.mark.parametrize(("frame", "message"), GOLDEN)
def test_golden_frames_are_written(frame: str, message: Message) -> None:
    assert encode(message) == bytes.fromhex(frame)


@pytest.mark.parametrize(("frame", "message"), GOLDEN)
def test_golden_frames_are_read(frame: str, message: Message) -> None:
    assert decode(bytes.fromhex(frame)) == [message]


def test_every_message_has_a_golden_frame() -> None:
    assert {type(message) for _, message in GOLDEN} == set(MESSAGES.values())


@pytest.mark.parametrize("size", range(1, 24))
def test_a_stream_may_be_split_at_every_size(size: int) -> None:
    stream = b"".join(bytes.fromhex(frame) for frame, _ in GOLDEN)
    decoder = Decoder()
    found = [m for at in range(0, len(stream), size) for m in decode(stream[at : at + size], decoder)]
    assert found == [message for _, message in GOLDEN]
    assert decoder.buffered == 0


@given(st.lists(messages, max_size=8), st.lists(st.integers(0, 400), max_size=8))
def test_what_is_encoded_is_decoded_however_it_is_split(sent: list[Message], cuts: list[int]) -> None:
    stream = b"".join(map(encode, sent))
    places = sorted({0, len(stream), *(cut for cut in cuts if cut < len(stream))})
    decoder = Decoder()
    found = []
    for start, end in itertools.pairwise(places):
        found += decode(stream[start:end], decoder)
    assert found == sent


@given(st.binary(max_size=600))
def test_garbage_gives_messages_or_a_remote_protocol_error_and_nothing_else(data: bytes) -> None:
    decoder = Decoder()
    try:
        decode(data, decoder)
    except RemoteProtocolError:
        return
    assert decoder.buffered < HEADER.size + MAX_BODY


def test_a_wrong_delimiter_is_refused_at_its_first_byte() -> None:
    with pytest.raises(RemoteProtocolError, match="0x47"):
        decode(b"G")


def test_a_length_beyond_every_message_is_refused_with_the_header() -> None:
    with pytest.raises(RemoteProtocolError, match="65535"):
        decode(bytes.fromhex("02 02 FF FF"))
    with pytest.raises(RemoteProtocolError, match="2297 bytes; no message exceeds 2296"):
        decode(bytes.fromhex("02 02 F9 08"))


@pytest.mark.parametrize(
    ("frame", "code"),
    [
        ("02 63 00 00", Code.UNKNOWN_COMMAND),
        ("02 01 00 00", Code.BAD_VALUE),
        ("02 01 02 00 05 05", Code.BAD_VALUE),
        ("02 04 01 00 03", Code.BAD_VALUE),
        ("02 05 00 00", Code.BAD_VALUE),
        (f"02 00 11 00 01 {TEN_AMPERES * 2}", Code.BAD_VALUE),
        (f"02 02 0A 00 02 {ON}", Code.BAD_VALUE),
        ("02 02 0A 00 01 02 00 00 C0 3F 00 00 C0 41", Code.BAD_VALUE),
    ],
)
def test_a_frame_of_the_wrong_shape_is_unreadable_with_the_code_to_answer(frame: str, code: Code) -> None:
    [found] = decode(bytes.fromhex(frame))
    assert isinstance(found, Unreadable)
    assert found.code == code


@pytest.mark.parametrize("number", ["00 00 C0 7F", "00 00 80 7F", "00 00 80 FF"])  # NaN, +inf, -inf
def test_a_number_that_is_none_is_unknown_and_spoils_nothing_else(number: str) -> None:
    assert decode(bytes.fromhex(f"02 02 13 00 02 01 {number} 00 00 C0 41 {OFF}")) == [
        Measurements((ChannelReading(True, None, 24.0), ChannelReading(False, 0.0, 0.0)))
    ]


def test_switching_keeps_a_strange_state_so_that_the_board_can_refuse_it() -> None:
    assert decode(bytes.fromhex("02 04 02 00 03 07")) == [SwitchChannel(3, 7)]


@pytest.mark.parametrize(
    "message",
    [
        Broadcast(256),
        SwitchChannel(3, 2),
        SwitchChannel(300, 1),
        Acknowledge(999),
        Measurements((ChannelReading(True, math.nan, 24.0),)),
        Measurements((ChannelReading(True, 1e39, 24.0),)),
        Measurements((ChannelReading(True, 1.0, 24.0),) * 256),
        Specification((ChannelLimits(math.inf, 24.0),)),
    ],
)
def test_a_field_that_does_not_fit_is_our_error(message: Message) -> None:
    with pytest.raises(LocalProtocolError):
        encode(message)


def test_the_buffer_is_bounded() -> None:
    decoder = Decoder()
    decoder.receive(bytes(MAX_BUFFER))
    with pytest.raises(LocalProtocolError, match="take the messages out"):
        decoder.receive(b"\x02")
