"""Client and board in memory: one decoder each, no port, no clock."""

from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st

from robomend.board.codec import (
    Acknowledge,
    Broadcast,
    Code,
    Measurements,
    Message,
    Request,
    SwitchChannel,
    encode,
)
from robomend.board.session import Answered, Command, Session, State
from robomend.errors import RemoteProtocolError
from robomend_board.board import Board
from robomend_board.loads import default_rig
from robomend_board.server import Conversation


def replies(conversation: Conversation, data: bytes, now_s: float = 0.0) -> list[Message]:
    conversation.receive(data)
    found: list[Message] = []
    while (messages := conversation.replies(now_s)) is not None:
        found += messages
    return found


def a_board(on: tuple[int, ...] = (2,)) -> Conversation:
    return Conversation(Board(default_rig(10), on))


commands: st.SearchStrategy[Command] = st.one_of(
    st.builds(Broadcast, st.integers(0, 255)),
    st.just(Request()),
    st.builds(SwitchChannel, st.integers(0, 12), st.sampled_from([0, 1])),
)


@given(st.lists(commands, max_size=12), st.integers(1, 40))
def test_a_session_and_a_conversation_understand_each_other_at_any_split(
    sequence: list[Command], size: int
) -> None:
    board, client = a_board(), Session()
    list(client.receive(encode(board.greeting())))
    for now, command in enumerate(sequence):
        stream = b"".join(map(encode, replies(board, client.send(command), float(now))))
        pieces = [stream[at : at + size] for at in range(0, len(stream), size)]
        events = [event for piece in pieces for event in client.receive(piece)]
        assert client.state is State.READY
        answer = events[-1]
        assert isinstance(answer, Answered)
        assert answer.command == command
        beyond = isinstance(command, SwitchChannel) and command.channel >= 10
        assert answer.code == (Code.UNKNOWN_CHANNEL if beyond else Code.OK)
        if isinstance(command, Request):
            assert isinstance(events[0], Measurements)


@given(st.binary(max_size=500), st.integers(1, 100))
def test_garbage_is_answered_or_ends_the_conversation_and_does_nothing_else(data: bytes, size: int) -> None:
    board = a_board()
    try:
        for at in range(0, len(data), size):
            for message in replies(board, data[at : at + size]):
                assert isinstance(message, Acknowledge | Measurements)
    except RemoteProtocolError:
        pass
