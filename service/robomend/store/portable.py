"""Everything in one file: export and import as NDJSON, and backups of SQLite while it is in use.

    {"robomend_export": 1, "schema": "1"}
    {"table": "models", "row": {"name": "tedusar", "current": 1}}
    …
    {"end": true, "rows": 4711}

An export is one snapshot, from either kind of database into either kind. The last line tells a whole file
from one that was cut off. Hashes of API keys are in it: keep it as safe as the database. Secrets of
configurations are in it if they are asked for. What means something to running instances only is left out:
who owns which robot, which browsers are signed in, and what people were told; and moments, which are large.
Fencing numbers are in, so that they never go back.
"""

from __future__ import annotations

import json
import os
import re
import sqlite3
from collections.abc import Callable, Iterable, Iterator
from contextlib import closing
from pathlib import Path
from typing import Any

from sqlalchemy import Connection, Table, func, select, text

from robomend.errors import InputError, OptionRefused, StateConflict, StoreError
from robomend.store import events, schema
from robomend.store.database import Database, translated
from robomend.store.encoding import from_json, to_json
from robomend.store.records import Json
from robomend.store.rows import View

FORMAT = 1
_CHUNK = 1000

TABLES: tuple[Table, ...] = (
    schema.counters,
    schema.settings,
    schema.models,
    schema.model_versions,
    schema.robots,
    schema.robot_state,
    schema.obs,
    schema.assertions,
    schema.results,
    schema.repairs,
    schema.repair_requests,
    schema.repair_steps,
    schema.journal,
    schema.drills,
    schema.tried,
    schema.quarantine,
    schema.attempts,
    schema.start_ups,
    schema.agent_actions,
    schema.idempotency,
    schema.api_keys,
    schema.audit,
    schema.events,
)


NAMED = {(table.name, "robot") for table in TABLES} | {
    ("robots", "id"),
    ("robots", "model"),
    ("models", "name"),
    ("model_versions", "name"),
}
NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9._\-]{0,63}\Z")
"""Of robots and models, as they come over HTTP."""

LARGEST = 2**63 - 1
_KINDS = {str: "text", bool: "truth value", int: "number of 64 bits", float: "number", object: "value"}

CONFIGURATIONS = {schema.robots: ("config",), schema.audit: ("before", "after")}
"""Columns with JSON that a robot was configured with."""


def export(database: Database, cover: Callable[[Json], Json] = dict) -> Iterator[str]:
    """Yield the lines of an export, each with its newline. Blocking: for commands.

    Args:
        cover: makes what is exported of a robot's configuration; the store does not know what is secret.
    """
    database.prepare()
    with database.reading() as connection:
        yield _line({"robomend_export": FORMAT, "schema": schema.HEAD})
        count, newest = 0, events.kept(View(connection)).newest
        for table in TABLES:
            query = select(table).order_by(*table.primary_key.columns)
            with connection.execution_options(yield_per=_CHUNK).execute(query) as result:
                for row in result.mappings():
                    values = dict(row)
                    if table is schema.robot_state:
                        values["owner"] = None
                    if table is schema.counters and values["name"] == "event":
                        values["value"] = newest
                    for column in CONFIGURATIONS.get(table, ()):
                        if values[column] is not None:
                            values[column] = to_json(cover(from_json(values[column])))
                    yield _line({"table": table.name, "row": values})
                    count += 1
        yield _line({"end": True, "rows": count})


def load(database: Database, lines: Iterable[str]) -> int:
    """Take an export into an empty database, whole or not at all, and return the number of rows. Blocking.

    Raises:
        StateConflict: the database holds something already.
        InputError: the file is no export, is cut off, or was written with another schema; names the line.
    """
    database.prepare()
    with translated(), closing(database.open_writer()) as connection, connection.begin():
        _check_empty(connection)
        connection.execute(schema.counters.delete())
        count = _load_rows(connection, lines)
        if connection.dialect.name == "postgresql":
            _move_sequences(connection)
    return count


def _check_empty(connection: Connection) -> None:
    for table in TABLES:
        if table is not schema.counters and connection.execute(select(table).limit(1)).first() is not None:
            raise StateConflict(f"the store is not empty ({table.name}); import into a new one")


def _load_rows(connection: Connection, lines: Iterable[str]) -> int:
    tables = {table.name: table for table in TABLES}
    columns = {table.name: frozenset(table.columns.keys()) for table in TABLES}
    waiting: list[dict[str, Any]] = []
    current: Table | None = None
    count = 0

    def put() -> None:
        if waiting and current is not None:
            connection.execute(current.insert(), waiting)
            waiting.clear()

    rows = iter(lines)
    for number, line in enumerate(rows, 1):
        record = _record(line, number)
        if number == 1:
            if record.get("robomend_export") != FORMAT or record.get("schema") != schema.HEAD:
                raise InputError(
                    f"line 1: not an export of format {FORMAT} and schema {schema.HEAD};"
                    " export with the version of robomend that wrote the database, after upgrading it"
                )
        elif record.get("end") is True:
            if record.get("rows") != count:
                raise InputError(f"line {number}: {record.get('rows')} rows were exported, {count} came")
            if any(rest.strip() for rest in rows):
                raise InputError(f"line {number}: more lines follow the end of the export")
            put()
            return count
        else:
            table, row = tables.get(str(record.get("table"))), record.get("row")
            if table is None or not isinstance(row, dict) or row.keys() != columns[table.name]:
                raise InputError(f"line {number}: not a row of a table of schema {schema.HEAD}")
            _check_values(table, row, number)
            if table is not current or len(waiting) >= _CHUNK:
                put()
                current = table
            waiting.append(row)
            count += 1
    raise InputError("the export is cut off: its last line is missing")


def _record(line: str, number: int) -> dict[str, Any]:
    try:
        record = json.loads(line)
    except (ValueError, RecursionError) as error:
        raise InputError(f"line {number}: no JSON: {error}") from error
    if not isinstance(record, dict):
        raise InputError(f"line {number}: not an object")
    return record


def _check_values(table: Table, row: dict[str, Any], number: int) -> None:
    """Refuse what a database cannot hold, or the interface would never have let in."""
    for name, value in row.items():
        kind = table.columns[name].type.python_type
        fits = value is None or kind is object or isinstance(value, (int, float) if kind is float else kind)
        if not fits or (isinstance(value, int) and abs(value) > LARGEST):
            shown = str(value)[:40]
            raise InputError(f"line {number}: {table.name}.{name}: {shown} is no {_KINDS[kind]}")
        if value is not None and (table.name, name) in NAMED and not NAME.match(value):
            raise InputError(f"line {number}: {table.name}.{name}: {value[:80]!r} is no name")


def _move_sequences(connection: Connection) -> None:
    """Rows came with their numbers; the next one must come after them."""
    for table in TABLES:
        column = table.columns.get("number")
        if column is None or column.autoincrement is not True:
            continue
        last = connection.execute(select(func.max(column))).scalar()
        if last is not None:
            moved = text("SELECT setval(pg_get_serial_sequence(:table, 'number'), :last)")
            connection.execute(moved, {"table": table.name, "last": last})


def backup(database: Database, path: Path) -> None:
    """Copy a SQLite database while it is in use, through its online backup: one snapshot, writers go on.

    The copy appears under its name when it is whole and on disk.

    Raises:
        OptionRefused: the database is PostgreSQL, whose own pg_dump does this.
        StateConflict: there is a file of this name.
    """
    if database.path is None:
        raise OptionRefused("back up PostgreSQL with its own tool: pg_dump --format=custom --file=FILE URL")
    if path.exists():
        raise StateConflict(f"{path} exists; name a new file")
    database.prepare()
    partial = path.with_name(f"{path.name}.partial")
    try:
        os.close(os.open(partial, os.O_CREAT | os.O_WRONLY | os.O_TRUNC | os.O_CLOEXEC, 0o600))
        with closing(sqlite3.connect(database.path)) as source, closing(sqlite3.connect(partial)) as copy:
            source.backup(copy)  # all pages in one step: in WAL mode that holds up no writer
            copy.execute("PRAGMA journal_mode=DELETE")  # a single file
        with partial.open("rb") as written:
            os.fsync(written.fileno())
        partial.rename(path)
        directory = os.open(path.parent, os.O_RDONLY | os.O_CLOEXEC)
        try:
            os.fsync(directory)
        finally:
            os.close(directory)
    except (OSError, sqlite3.Error) as error:
        raise StoreError(f"backup to {path}: {error}") from error
    finally:
        partial.unlink(missing_ok=True)


def _line(record: dict[str, Any]) -> str:
    return json.dumps(record, separators=(",", ":")) + "\n"
