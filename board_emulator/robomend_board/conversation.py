"""The board's half of a conversation: commands in, replies out. Sans-io, the mirror of
robomend.board.session.
"""

from __future__ import annotations

from robomend.board.codec import (
    Acknowledge,
    Broadcast,
    Code,
    Decoder,
    Message,
    Request,
    SwitchChannel,
    Unreadable,
)
from robomend_board.board import Board


class Conversation:
    """One client's connection. Each has its own broadcast rate; all share the board."""

    def __init__(self, board: Board) -> None:
        self._board = board
        self._decoder = Decoder()
        self.broadcast_hz = 0

    def greeting(self) -> Message:
        """Return what the board says first."""
        return self._board.specification()

    def receive(self, data: bytes) -> None:
        """Take bytes from the client; then call replies until it returns None."""
        self._decoder.receive(data)

    def replies(self, now_s: float) -> list[Message] | None:
        """Carry out the next command and return what to send; None until more bytes arrive.

        Raises:
            RemoteProtocolError: the bytes are no frame; drop the connection.
        """
        match self._decoder.next_message():
            case None:
                return None
            case Broadcast(frequency_hz):
                self.broadcast_hz = frequency_hz
                return [Acknowledge(Code.OK)]
            case Request():
                return [Acknowledge(Code.OK), self._board.measure(now_s)]
            case SwitchChannel(channel, state):
                return [Acknowledge(self._board.switch(channel, state, now_s))]
            case Unreadable(code=code):
                return [Acknowledge(code)]
            case _:  # a message that only boards send
                return [Acknowledge(Code.UNKNOWN_COMMAND)]
