"""The driver's own connection, behind one of SQLAlchemy's, for what is done in every group.

SQLAlchemy takes several times as long for a statement, a BEGIN or a COMMIT as SQLite does. Errors are those
that it would have raised, so that whoever handles them need not know.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import AbstractContextManager, contextmanager, nullcontext, suppress
from typing import Any

from sqlalchemy import Connection, exc

from robomend.store.pipeline import Answer, Pipeline

_ONE_BY_ONE = nullcontext()


class DriverConnection:
    """See the module. `connection` is in a transaction of SQLAlchemy's, which knows of no end of it."""

    __slots__ = ("_connection", "_pipeline", "_together", "error", "itself", "kind")

    def __init__(self, connection: Connection) -> None:
        self._connection = connection
        self.kind = connection.dialect.name
        self.itself: Any = connection.connection.driver_connection
        self.error: type[Exception] = connection.dialect.loaded_dbapi.Error
        self._pipeline = None if self.kind == "sqlite" else Pipeline(self.itself)
        self._together = False

    @property
    def connection(self) -> Connection:
        """SQLAlchemy's, for statements of its own: what was sent before them is done."""
        if self._pipeline is not None and not self._pipeline.empty:
            self._wait()
        return self._connection

    def execute(self, text: str, values: Any = ()) -> Any:
        """Execute a statement; return a cursor."""
        if self._pipeline is not None:
            return self._send(text, [values])[0]
        try:
            return self.itself.execute(text, values)
        except self.error as error:
            raise self.translation(error) from error

    def execute_many(self, text: str, rows: Sequence[Sequence[Any]]) -> None:
        """Execute a statement of PostgreSQL's for each row."""
        self._send(text, rows)

    def _send(self, text: str, rows: Sequence[Sequence[Any]]) -> list[Answer]:
        assert self._pipeline is not None
        if self._together:
            return [self._pipeline.send(text, values) for values in rows]
        with self.together():
            return self._send(text, rows)

    def _wait(self) -> None:
        assert self._pipeline is not None
        try:
            self._pipeline.wait()
        except self.error as error:
            raise self.translation(error) from error

    def commit(self) -> None:
        """Commit what was executed since the last time."""
        if self._pipeline is not None:
            self.execute("COMMIT")
            return
        try:
            self.itself.commit()
        except self.error as error:
            raise self.translation(error) from error

    def rollback(self) -> None:
        """Take it back."""
        try:
            self.itself.rollback()
        except self.error as error:
            raise self.translation(error) from error

    def together(self) -> AbstractContextManager[None]:
        """Return a context in which PostgreSQL is sent statements without waiting for each one's answer,
        which is there at its end.

        What one of them raises may come with a later one, or at the end.
        """
        return _ONE_BY_ONE if self._pipeline is None else self._sending()

    @contextmanager
    def _sending(self) -> Iterator[None]:
        self._together = True
        try:
            yield
        except BaseException as error:
            with suppress(exc.DBAPIError):  # the first of them counts
                self._wait()
            if isinstance(error, self.error):
                raise self.translation(error) from error
            raise
        else:
            self._wait()
        finally:
            self._together = False

    def select_in(self, texts: dict[str, str], keys: Sequence[Any]) -> Any:
        """Return a cursor over a query with `IN ({keys})` or, on PostgreSQL, `= ANY($1)`."""
        text = texts[self.kind]
        if self.kind == "sqlite":
            return self.execute(text.format(keys=",".join("?" * len(keys))), keys)
        return self.execute(text, (list(keys),))

    def translation(self, error: Any) -> exc.DBAPIError:
        """Return SQLAlchemy's error for one of the driver's; `connection` knows then whether it is lost."""
        dialect = self._connection.dialect
        lost = dialect.is_disconnect(error, self.itself, None)
        raised = exc.DBAPIError.instance(
            None, None, error, dialect.loaded_dbapi.Error, connection_invalidated=lost, dialect=dialect
        )
        if lost:
            self._connection.invalidate(error)
        assert isinstance(raised, exc.DBAPIError)
        return raised
