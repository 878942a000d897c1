"""One log: what was accepted and what was diagnosed are rows of `events`, not of tables beside it."""

from __future__ import annotations

import hashlib

import sqlalchemy as sa
from alembic import op

revision = "0009"
down_revision = "0008"
branch_labels = None
depends_on = None

NUMBER = sa.BigInteger().with_variant(sa.Integer(), "sqlite")
TEXT = sa.Text().with_variant(sa.Text(collation="C"), "postgresql")

# A batch and its event, a diagnosis and its event were written in one transaction, which gave both its time:
# of one robot and time, the first is of the first.
PLACED = """
    CREATE TEMPORARY TABLE placed AS
    SELECT kept.kind AS kind, kept.number AS number, told.id AS id
    FROM (
        SELECT 'observations' AS kind, number, robot, time_ns,
               row_number() OVER (PARTITION BY robot, time_ns ORDER BY number) AS place FROM observations
        UNION ALL
        SELECT 'diagnosis', number, robot, time_ns,
               row_number() OVER (PARTITION BY robot, time_ns ORDER BY number) FROM diagnoses
    ) AS kept
    LEFT JOIN (
        SELECT id, kind, robot, time_ns,
               row_number() OVER (PARTITION BY kind, robot, time_ns ORDER BY id) AS place FROM events
        WHERE kind IN ('observations', 'diagnosis')
    ) AS told
    ON told.kind = kept.kind AND told.robot = kept.robot AND told.time_ns = kept.time_ns
       AND told.place = kept.place
"""
# Of which the event is gone goes before the log, in the order of time.
BEFORE = """
    CREATE TEMPORARY TABLE before_log AS
    SELECT kind, number, :first - row_number() OVER (ORDER BY time_ns DESC, kind, number DESC) AS id
    FROM (
        SELECT placed.kind, placed.number, observations.time_ns FROM placed
        JOIN observations ON placed.kind = 'observations' AND observations.number = placed.number
        WHERE placed.id IS NULL
        UNION ALL
        SELECT placed.kind, placed.number, diagnoses.time_ns FROM placed
        JOIN diagnoses ON placed.kind = 'diagnosis' AND diagnoses.number = placed.number
        WHERE placed.id IS NULL
    ) AS alone
"""
LOG = (
    """
    INSERT INTO log (id, time_ns, kind, robot, revision, batch, data, common)
    SELECT before_log.id, time_ns, kind, robot, revision, data, NULL, NULL
    FROM before_log JOIN observations ON observations.number = before_log.number AND kind = 'observations'
    """,
    """
    INSERT INTO log (id, time_ns, kind, robot, revision, batch, data, common)
    SELECT before_log.id, time_ns, kind, robot, revision, NULL, result, common
    FROM before_log JOIN diagnoses ON diagnoses.number = before_log.number AND kind = 'diagnosis'
    """,
    """
    INSERT INTO log (id, time_ns, kind, robot, revision, batch, data, common)
    SELECT events.id, events.time_ns, events.kind, events.robot, observations.revision, observations.data,
           events.data, events.common
    FROM events
    LEFT JOIN placed ON placed.id = events.id AND placed.kind = 'observations'
    LEFT JOIN observations ON observations.number = placed.number
    WHERE events.kind <> 'diagnosis'
    """,
    """
    INSERT INTO log (id, time_ns, kind, robot, revision, batch, data, common)
    SELECT events.id, events.time_ns, events.kind, events.robot, diagnoses.revision, NULL,
           coalesce(diagnoses.result, events.data),
           CASE WHEN diagnoses.number IS NULL THEN events.common ELSE diagnoses.common END
    FROM events
    LEFT JOIN placed ON placed.id = events.id AND placed.kind = 'diagnosis'
    LEFT JOIN diagnoses ON diagnoses.number = placed.number
    WHERE events.kind = 'diagnosis'
    """,
)


def _digest(text: str) -> bytes:
    return hashlib.blake2b(text.encode(errors="surrogatepass"), digest_size=16).digest()


def _digest_keys(connection: sa.Connection) -> None:
    """Keep of idempotency keys what tells them apart, in the order in which they expire."""
    op.rename_table("idempotency", "idempotency_before")
    op.drop_index("ix_idempotency_expires", "idempotency_before")
    if connection.dialect.name == "postgresql":
        op.execute("ALTER INDEX idempotency_pkey RENAME TO idempotency_before_pkey")
    made = op.create_table(
        "idempotency",
        sa.Column("number", NUMBER, primary_key=True, autoincrement=True),
        sa.Column("digest", sa.LargeBinary(), nullable=False, unique=True),
        sa.Column("request", sa.LargeBinary(), nullable=False),
        sa.Column("response", TEXT, nullable=False),
        sa.Column("expires_ns", sa.BigInteger(), nullable=False),
    )
    before = sa.text(
        "SELECT scope, key, request, response, expires_ns FROM idempotency_before ORDER BY expires_ns"
    )
    for some in connection.execute(before).partitions(1000):
        rows = [
            {
                "digest": _digest(f"{len(row.scope)} {row.scope}{row.key}"),
                "request": _digest(row.request),
                "response": row.response,
                "expires_ns": row.expires_ns,
            }
            for row in some
        ]
        connection.execute(made.insert(), rows)
    op.drop_table("idempotency_before")


def upgrade() -> None:
    """Move batches and diagnoses into the log; it takes a while, as all of it is written anew."""
    op.add_column("obs", sa.Column("revision", sa.BigInteger(), nullable=False, server_default="0"))
    op.add_column("robot_state", sa.Column("folded", sa.BigInteger(), nullable=False, server_default="0"))
    op.execute("UPDATE robot_state SET folded = revision")
    op.create_table(
        "log",
        sa.Column("id", NUMBER, primary_key=True, autoincrement=False),
        sa.Column("time_ns", sa.BigInteger(), nullable=False),
        sa.Column("kind", TEXT, nullable=False),
        sa.Column("robot", TEXT),
        sa.Column("revision", sa.BigInteger()),
        sa.Column("batch", TEXT),
        sa.Column("data", TEXT),
        sa.Column("common", sa.BigInteger()),
    )
    connection = op.get_bind()
    counted = connection.execute(sa.text("SELECT value FROM counters WHERE name = 'event'")).scalar()
    first = connection.execute(sa.text("SELECT min(id) FROM events")).scalar()
    first = (counted or 0) + 1 if first is None else first
    connection.execute(sa.text(PLACED))
    connection.execute(sa.text(BEFORE), {"first": first})
    for statement in LOG:
        connection.execute(sa.text(statement))
    cut = sa.text("INSERT INTO counters (name, value) VALUES ('events-cut', :cut)")
    connection.execute(cut, {"cut": first - 1})
    _digest_keys(connection)
    for table in ("placed", "before_log", "events", "observations", "diagnoses"):
        op.drop_table(table)
    op.rename_table("log", "events")
    if connection.dialect.name == "postgresql":
        op.execute("ALTER INDEX log_pkey RENAME TO events_pkey")
    op.create_index("ix_events_robot", "events", ["robot", "kind", "id"])
