"""Event streams cut from bytes: split anywhere, the events are the same."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from robomend_client.rest.errors import NotTheService
from robomend_client.rest.sse import LONGEST_EVENT, EventDecoder, ServerSentEvent

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
