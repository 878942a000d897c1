"""Event streams cut from bytes: split anywhere, the events are the same."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from robomend_client.events import Event, Kind
from robomend_client.rest.errors import NotTheService
from robomend_client.rest.sse import LONGEST_EVENT, EventDecoder, ServerSentEvent, read_event

STREAM = (
    "retry: 1500\n: robomend events\n\n"
    'id: 41\nevent: diagnosis\ndata: {"time_ns": 7, "robot": "r", "data": {"revision": 3}}\n\n'
    "event: gap\ndata: {}\n\n"
    ": ping\n\n"
    "id:42\nevent:robot\ndata:first\u2028line\ndata: second line\n\n"
    "id: 43\nevent: stop\ndata: cut o"
)
MESSAGES = [
    ServerSentEvent("41", "diagnosis", '{"time_ns": 7, "robot": "r", "data": {"revision": 3}}'),
    ServerSentEvent("41", "gap", "{}"),
    ServerSentEvent("42", "robot", "first\u2028line\nsecond line"),
]


@pytest.mark.parametrize("end", ["\n", "\r\n", "\r"])
@pytest.mark.parametrize("size", [1, 2, 3, 7, 10_000])
def test_the_events_do_not_depend_on_where_the_bytes_are_split(end: str, size: int) -> None:
    data = STREAM.replace("\n", end).encode()
    decoder, found = EventDecoder(), list[ServerSentEvent]()
    for start in range(0, len(data), size):
        found += decoder.receive(data[start : start + size])
    assert found == MESSAGES
    assert (decoder.last_id, decoder.retry_s) == ("42", 1.5)


def test_a_lost_connection_forgets_the_half_event_and_keeps_the_id() -> None:
    decoder = EventDecoder()
    assert list(decoder.receive(b"id: 5\n\nid: 6\ndata: half an ev")) == []
    decoder.reconnected()
    assert list(decoder.receive(b"data: whole\n\n")) == [ServerSentEvent("5", "message", "whole")]


def test_an_event_without_end_does_not_fill_the_memory() -> None:
    decoder = EventDecoder()
    list(decoder.receive(b"data: " + b"x" * (LONGEST_EVENT - 100)))
    with pytest.raises(NotTheService, match="bytes"):
        list(decoder.receive(b"x" * 200))


@given(st.lists(st.binary(max_size=40), max_size=20))
def test_garbage_gives_messages_or_nothing_but_never_an_accident(chunks: list[bytes]) -> None:
    decoder = EventDecoder()
    for chunk in chunks:
        assert all(isinstance(message, ServerSentEvent) for message in decoder.receive(chunk))


def test_an_event_is_read_with_its_kind() -> None:
    assert read_event(MESSAGES[0]) == Event(41, 7, Kind.DIAGNOSIS, "r", {"revision": 3})


def test_a_kind_of_a_newer_service_is_skipped() -> None:
    assert read_event(ServerSentEvent("1", "teleportation", "{}")) is None


@pytest.mark.parametrize("data", ["", "[]", "{}", '{"time_ns": "x"}', "nonsense"])
def test_data_that_is_no_event_is_said_to_be_none(data: str) -> None:
    with pytest.raises(NotTheService, match="event '1'"):
        read_event(ServerSentEvent("1", "stop", data))
