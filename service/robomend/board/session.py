"""The client's half of a conversation with the board, as a table of states. Sans-io: bytes in, events out.

    OPENING ─Specification─► READY ─Broadcast, SwitchChannel─► COMMANDED ─Acknowledge, Refusal─► READY
                               └─Request─► REQUESTED ─Acknowledge─► REPLYING ─Measurements─► READY
                                               └─Refusal─► READY

Measurements of a running broadcast may come in every state but OPENING. What has no row in TRANSITIONS is
refused: a LocalProtocolError if we were about to send it, a RemoteProtocolError if the board did.

Acknowledges carry no id: they match the commands by order alone. A session therefore has one command
outstanding at a time, and one that was given up (time-out, cancelled) spoils the connection: its
acknowledge could still come and would be taken for the next command's. Drop the connection then, and open a
new session.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from enum import StrEnum

from robomend.board.codec import (
    Acknowledge,
    Broadcast,
    Code,
    Decoder,
    Measurements,
    Request,
    Specification,
    SwitchChannel,
    Unreadable,
    encode,
)
from robomend.errors import LocalProtocolError, RemoteProtocolError

Command = Broadcast | Request | SwitchChannel


class State(StrEnum):
    """Where the conversation stands."""

    OPENING = "opening"  # connected; the board owes its specification
    READY = "ready"  # no command is outstanding
    COMMANDED = "commanded"  # the board owes an acknowledge
    REQUESTED = "requested"  # the board owes an acknowledge, then measurements
    REPLYING = "replying"  # the board owes measurements
    BROKEN = "broken"  # the protocol was broken; only dropping the connection helps


class Refusal:
    """The column of the table for an acknowledge whose code is not 0: after it, a request gets no
    measurements.
    """


Symbol = (
    type[Specification]
    | type[Broadcast]
    | type[Measurements]
    | type[Request]
    | type[SwitchChannel]
    | type[Acknowledge]
    | type[Refusal]
)

TRANSITIONS: dict[tuple[State, Symbol], State] = {
    (State.OPENING, Specification): State.READY,
    (State.READY, Measurements): State.READY,
    (State.READY, Broadcast): State.COMMANDED,
    (State.READY, SwitchChannel): State.COMMANDED,
    (State.READY, Request): State.REQUESTED,
    (State.COMMANDED, Measurements): State.COMMANDED,
    (State.COMMANDED, Acknowledge): State.READY,
    (State.COMMANDED, Refusal): State.READY,
    (State.REQUESTED, Measurements): State.REQUESTED,
    (State.REQUESTED, Acknowledge): State.REPLYING,
    (State.REQUESTED, Refusal): State.READY,
    (State.REPLYING, Measurements): State.READY,
}


@dataclass(frozen=True, slots=True)
class Answered:
    """A command is done with: the board's answer to it has arrived whole."""

    command: Command
    code: int

    @property
    def ok(self) -> bool:
        return self.code == Code.OK


Event = Specification | Measurements | Answered


class Session:
    """One connection's conversation, from the specification to the end."""

    def __init__(self) -> None:
        self._decoder = Decoder()
        self.state = State.OPENING
        self.specification: Specification | None = None
        self.outstanding: Command | None = None

    @property
    def channels(self) -> int:
        """The number of channels, as the specification says; 0 before it came."""
        return len(self.specification.channels) if self.specification else 0

    def send(self, command: Command) -> bytes:
        """Return the bytes of a command; LocalProtocolError if it may not be sent now or does not fit."""
        next_state = TRANSITIONS.get((self.state, type(command)))
        if next_state is None:
            raise LocalProtocolError(f"{command} may not be sent in state {self.state}")
        frame = encode(command)
        self.state = next_state
        self.outstanding = command
        return frame

    def receive(self, data: bytes) -> Iterator[Event]:
        """Yield what these bytes complete, in order. Exhaust it before the next call.

        Raises:
            RemoteProtocolError: the board broke the protocol, now or earlier: drop the connection.
        """
        if self.state is State.BROKEN:
            raise RemoteProtocolError("the board broke the protocol earlier on this connection")
        try:
            self._decoder.receive(data)
            while (message := self._decoder.next_message()) is not None:
                if not isinstance(message, Specification | Measurements | Acknowledge):
                    raise RemoteProtocolError(
                        message.reason
                        if isinstance(message, Unreadable)
                        else f"a board does not send {message}"
                    )
                yield from self._step(message)
        except RemoteProtocolError:
            self.state = State.BROKEN
            raise

    def _step(self, message: Specification | Measurements | Acknowledge) -> Iterator[Event]:
        symbol: Symbol = type(message)
        if isinstance(message, Acknowledge) and message.code != Code.OK:
            symbol = Refusal
        before, after = self.state, TRANSITIONS.get((self.state, symbol))
        if after is None:
            raise RemoteProtocolError(f"{message} came in state {self.state}")
        self.state = after
        code = int(Code.OK)
        match message:
            case Specification():
                if not message.channels:
                    raise RemoteProtocolError("the board specifies no channel")
                self.specification = message
                yield message
            case Measurements():
                if len(message.channels) != self.channels:
                    measured = len(message.channels)
                    raise RemoteProtocolError(f"measurements of {measured} channels, not {self.channels}")
                yield message
            case Acknowledge():
                code = message.code
        if after is State.READY and before is not State.READY and self.outstanding is not None:
            command, self.outstanding = self.outstanding, None
            yield Answered(command, code)
