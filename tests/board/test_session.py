"""The table of states is the specification: every pair of state and message is tried."""

from __future__ import annotations

import itertools
import re
from pathlib import Path

import pytest

from robomend.board.codec import (
    MESSAGES,
    Acknowledge,
    Broadcast,
    ChannelLimits,
    ChannelReading,
    Code,
    Measurements,
    Message,
    Request,
    Specification,
    SwitchChannel,
    encode,
)
from robomend.board.session import TRANSITIONS, Answered, Command, Event, Refusal, Session, State
from robomend.errors import LocalProtocolError, RemoteProtocolError

SPECIFICATION = Specification((ChannelLimits(10.0, 24.0),) * 8)
MEASUREMENTS = Measurements((ChannelReading(True, 1.5, 24.0),) * 8)
OK = Acknowledge(Code.OK)
REFUSED = Acknowledge(Code.CHANNEL_FAULTY)

COMMANDS: tuple[Command, ...] = (Broadcast(5), Request(), SwitchChannel(7, 1))
REPLIES: tuple[Message, ...] = (SPECIFICATION, MEASUREMENTS, OK, REFUSED)


def receive(session: Session, *messages: Message) -> list[Event]:
    return list(session.receive(b"".join(map(encode, messages))))


def in_state(state: State) -> Session:
    session = Session()
    if state is State.OPENING:
        return session
    receive(session, SPECIFICATION)
    if state is State.COMMANDED:
        session.send(SwitchChannel(7, 1))
    if state in (State.REQUESTED, State.REPLYING):
        session.send(Request())
    if state is State.REPLYING:
        receive(session, OK)
    assert session.state is state
    return session


LIVE = [state for state in State if state is not State.BROKEN]


@pytest.mark.parametrize(("state", "command"), list(itertools.product(LIVE, COMMANDS)))
def test_a_command_is_sent_exactly_where_the_table_has_a_row(state: State, command: Command) -> None:
    session = in_state(state)
    expected = TRANSITIONS.get((state, type(command)))
    if expected is None:
        with pytest.raises(LocalProtocolError):
            session.send(command)
        assert session.state is state
    else:
        assert session.send(command) == encode(command)
        assert session.state is expected
        assert session.outstanding == command


@pytest.mark.parametrize(("state", "message"), list(itertools.product(LIVE, (*REPLIES, *COMMANDS))))
def test_a_message_is_taken_exactly_where_the_table_has_a_row(state: State, message: Message) -> None:
    session = in_state(state)
    symbol = Refusal if message == REFUSED else type(message)
    ours = message in COMMANDS  # a board that sends commands has no row, whatever the state
    expected = None if ours else TRANSITIONS.get((state, symbol))
    if expected is None:
        with pytest.raises(RemoteProtocolError):
            receive(session, message)
        assert session.state is State.BROKEN
    else:
        receive(session, message)
        assert session.state is expected


def test_measurements_of_another_number_of_channels_break_the_protocol() -> None:
    session = in_state(State.READY)
    with pytest.raises(RemoteProtocolError, match="10 channels, not 8"):
        receive(session, Measurements((ChannelReading(False, 0.0, 0.0),) * 10))


def test_a_board_without_channels_breaks_the_protocol() -> None:
    with pytest.raises(RemoteProtocolError, match="no channel"):
        receive(Session(), Specification(()))


def test_an_acknowledge_answers_the_outstanding_command_amid_a_broadcast() -> None:
    session = in_state(State.COMMANDED)
    assert receive(session, MEASUREMENTS, REFUSED, MEASUREMENTS) == [
        MEASUREMENTS,
        Answered(SwitchChannel(7, 1), Code.CHANNEL_FAULTY),
        MEASUREMENTS,
    ]
    assert session.outstanding is None


def test_a_command_that_does_not_fit_the_wire_leaves_the_session_as_it_was() -> None:
    session = in_state(State.READY)
    with pytest.raises(LocalProtocolError):
        session.send(Broadcast(1000))
    assert session.state is State.READY
    assert session.outstanding is None


def test_the_manual_draws_the_table_row_by_row() -> None:
    manual = (Path(__file__).parents[2] / "docs" / "board.md").read_text(encoding="utf-8")
    drawn = re.findall(r"^    (\w+) --> (\w+) : (\w+)$", manual, re.MULTILINE)
    rows = [(state, after, symbol.__name__) for (state, symbol), after in TRANSITIONS.items()]
    assert sorted(drawn) == sorted(rows)


def test_the_manual_names_every_message_and_code() -> None:
    manual = (Path(__file__).parents[2] / "docs" / "board.md").read_text(encoding="utf-8")
    for message in MESSAGES.values():
        assert f"| {message.command} | `{message.__name__}`" in manual
    for code in Code:
        assert f"| {int(code)} | `{code.name}` |" in manual
