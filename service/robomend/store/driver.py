"""The driver's own connection, behind one of SQLAlchemy's, for what is done in every group.

SQLAlchemy takes several times as long for a statement, a BEGIN or a COMMIT as SQLite does. Errors are those
that it would have raised, so that whoever handles them need not know.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import AbstractContextManager, contextmanager, nullcontext
from typing import Any

from sqlalchemy import Connection, exc

_ONE_BY_ONE = nullcontext()


class DriverConnection:
    """See the module. `connection` is in a transaction of SQLAlchemy's, which knows of no end of it."""

    __slots__ = ("connection", "error", "itself", "kind")

    def __init__(self, connection: Connection) -> None:
        self.connection = connection
        self.kind = connection.dialect.name
        self.itself: Any = connection.connection.driver_connection
        self.error: type[Exception] = connection.dialect.loaded_dbapi.Error

    def execute(self, text: str, values: Any = ()) -> Any:
        """Execute a statement; return the driver's cursor."""
        try:
            return self.itself.execute(text, values)
        except self.error as error:
            raise self.translation(error) from error

    def commit(self) -> None:
        """Commit what was executed since the last time."""
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
        """Return a context in which PostgreSQL is sent statements without waiting for each one's answer.

        What one of them raises may come with a later one, or at the end.
        """
        return _ONE_BY_ONE if self.kind == "sqlite" else self._pipeline()

    @contextmanager
    def _pipeline(self) -> Iterator[None]:
        try:
            with self.itself.pipeline():
                yield
        except self.error as error:
            raise self.translation(error) from error

    def select_in(self, texts: dict[str, str], keys: Sequence[Any]) -> list[tuple[Any, ...]]:
        """Return the rows of a query with `IN ({keys})` or, on PostgreSQL, `= ANY(%s)`."""
        text = texts[self.kind]
        if self.kind == "sqlite":
            cursor = self.execute(text.format(keys=",".join("?" * len(keys))), keys)
        else:
            cursor = self.execute(text, (list(keys),))
        found: list[tuple[Any, ...]] = cursor.fetchall()
        return found

    def translation(self, error: Any) -> exc.DBAPIError:
        """Return SQLAlchemy's error for one of the driver's; `connection` knows then whether it is lost."""
        dialect = self.connection.dialect
        lost = dialect.is_disconnect(error, self.itself, None)
        raised = exc.DBAPIError.instance(
            None, None, error, dialect.loaded_dbapi.Error, connection_invalidated=lost, dialect=dialect
        )
        if lost:
            self.connection.invalidate(error)
        assert isinstance(raised, exc.DBAPIError)
        return raised
