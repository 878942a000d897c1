"""Statements to PostgreSQL that are sent together, with one wait for all of their answers.

    send ── send ── send ──► one write to the socket ──► server ──► the answers, in their order
                                                └── wait ──────────────────────┘

The driver has such a mode too, and goes to the socket for each statement. This is libpq's own, for the few
statements that every group runs: each is prepared once, and values go and come as text.
"""

from __future__ import annotations

import contextlib
import select
from collections.abc import Callable, Sequence
from itertools import count
from typing import Any

Answers = list[tuple[Any, ...]]
_NUMBERS = count(1)  # of names that no connection has twice

BROKEN = 1  # libpq's CONNECTION_BAD
IDLE = 0  # libpq's PQTRANS_IDLE
OK = frozenset({1, 2})  # PGRES_COMMAND_OK, PGRES_TUPLES_OK
SYNC, ABORTED = 10, 11  # PGRES_PIPELINE_SYNC, PGRES_PIPELINE_ABORTED

_READ: dict[int, Callable[[bytes], Any]] = {
    16: b"t".__eq__,
    17: lambda value: bytes.fromhex(value[2:].decode()),
    20: int,
    21: int,
    23: int,
}
"""What a value is, by its type's number; others are texts."""


class Answer:
    """What a statement returns, as a cursor of the driver's does: whoever asks for rows waits for them."""

    __slots__ = ("_rows", "_wait")

    def __init__(self, wait: Callable[[], None]) -> None:
        self._rows: Answers | None = None
        self._wait = wait

    def take(self, result: Any) -> None:
        """Read the rows of a result of libpq's."""
        columns = range(result.nfields)
        reads = [_READ.get(result.ftype(column), bytes.decode) for column in columns]
        self._rows = [
            tuple(
                [
                    None if (value := result.get_value(row, column)) is None else reads[column](value)
                    for column in columns
                ]
            )
            for row in range(result.ntuples)
        ]

    def fetchall(self) -> Answers:
        """Return the rows that are left."""
        if self._rows is None:
            self._wait()
        rows, self._rows = self._rows, []
        return rows or []

    def fetchone(self) -> tuple[Any, ...] | None:
        """Return the first row that is left."""
        rows = self._rows = self.fetchall()
        return rows.pop(0) if rows else None


class Pipeline:
    """See the module. Over a connection (bounded.py) whose driver prepares nothing itself (open_writer)."""

    def __init__(self, connection: Any) -> None:
        self._connection = connection
        self._link = connection.pgconn
        self._names: dict[str, bytes] = {}
        self._sent: list[Answer | str | None] = []  # a text: it is prepared; None: its rows are nobody's
        self._poll = select.poll()

    @property
    def empty(self) -> bool:
        """Whether nothing is under way."""
        return not self._sent

    def send(self, text: str, values: Sequence[Any] = ()) -> Answer:
        """Send a statement, whose values are `$1`, `$2`, … A transaction begins with the first."""
        link = self._link
        if not self._sent:
            begun = link.transaction_status != IDLE
            link.enter_pipeline_mode()
            if not begun:
                self._send("BEGIN", ())
        answer = Answer(self.wait)
        self._send(text, values, answer)
        return answer

    def _send(self, text: str, values: Sequence[Any], answer: Answer | None = None) -> None:
        name = self._names.get(text)
        given = [_given(value) for value in values]
        if name is None:
            name = self._names[text] = b"robomend_%d" % next(_NUMBERS)
            self._link.send_prepare(name, text.encode())
            self._sent.append(text)
        self._link.send_query_prepared(name, given)
        self._sent.append(answer)

    def wait(self) -> None:
        """Wait for all answers. An error of the driver's: the first that came; what was sent behind it was
        not done.
        """
        if not self._sent:
            return
        from psycopg.errors import error_from_result

        sent, self._sent, error = self._sent, [], None
        try:
            self._link.pipeline_sync()
            for answer in [*sent, None]:
                result = self._next()
                if result.status in OK:
                    if isinstance(answer, Answer):
                        answer.take(result)
                else:
                    if isinstance(answer, str):
                        del self._names[answer]  # what was prepared before is there, whatever is rolled back
                    if error is None and result.status not in (SYNC, ABORTED):
                        error = error_from_result(result)
                if result.status != SYNC:
                    self._next(end=True)
            self._link.exit_pipeline_mode()
        except BaseException:
            self._names.clear()
            with contextlib.suppress(Exception):
                self._connection.close()  # nobody knows what is under way on it
            raise
        if error is not None:
            raise error

    def _next(self, *, end: bool = False) -> Any:
        """Return the next result; at the end of a statement's there is none."""
        link = self._link
        unsent = link.flush()
        while unsent or link.is_busy():
            self._poll.register(link.socket, select.POLLIN | select.POLLOUT if unsent else select.POLLIN)
            if not self._poll.poll(self._connection.answer_s * 1000):
                raise self._connection.silent()
            link.consume_input()
            unsent = link.flush()
        result = link.get_result()
        if (result is None) is not end or link.status == BROKEN:
            from psycopg import OperationalError

            said = "" if result is None else result.get_error_message()
            raise OperationalError(said or "the connection was lost in the middle of a group")
        return result


def _given(value: Any) -> bytes | None:
    """Return a value as it is sent."""
    if value is None:
        return None
    if isinstance(value, str):
        return value.encode()
    if isinstance(value, bool):
        return b"t" if value else b"f"
    if isinstance(value, int):
        return b"%d" % value
    if isinstance(value, bytes):
        return b"\\x%s" % value.hex().encode()
    if isinstance(value, list):
        return b"{%s}" % b",".join(map(_item, value))
    raise TypeError(f"no value of a statement: {type(value).__name__}")


def _item(value: str | bytes) -> bytes:
    if isinstance(value, bytes):
        return b'"\\\\x%s"' % value.hex().encode()
    return b'"%s"' % value.replace("\\", "\\\\").replace('"', '\\"').encode()
