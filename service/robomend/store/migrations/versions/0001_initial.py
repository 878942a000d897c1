"""The first schema."""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision = "0001"
down_revision = None
branch_labels = None
depends_on = None

NUMBER = sa.BigInteger().with_variant(sa.Integer(), "sqlite")
TEXT = sa.Text().with_variant(sa.Text(collation="C"), "postgresql")


def upgrade() -> None:
    """Create everything, and the counters that give ids."""
    op.create_table(
        "agent_actions",
        sa.Column("number", NUMBER, autoincrement=True, nullable=False),
        sa.Column("id", TEXT, nullable=False),
        sa.Column("robot", TEXT, nullable=False),
        sa.Column("host", TEXT, nullable=True),
        sa.Column("name", TEXT, nullable=False),
        sa.Column("parameters", TEXT, nullable=False),
        sa.Column("timeout_s", sa.Float(), nullable=False),
        sa.Column("queued_ns", sa.BigInteger(), nullable=False),
        sa.Column("expires_ns", sa.BigInteger(), nullable=False),
        sa.Column("taken_by", TEXT, nullable=True),
        sa.Column("taken_ns", sa.BigInteger(), nullable=True),
        sa.Column("answered", sa.Boolean(), nullable=False),
        sa.Column("code", sa.BigInteger(), nullable=True),
        sa.Column("message", TEXT, nullable=False),
        sa.Column("settled_ns", sa.BigInteger(), nullable=True),
        sa.PrimaryKeyConstraint("number"),
        sa.UniqueConstraint("id"),
        sqlite_autoincrement=True,
    )
    op.create_index(
        "ix_agent_actions_waiting",
        "agent_actions",
        ["robot"],
        unique=False,
        postgresql_where=sa.text("settled_ns IS NULL"),
        sqlite_where=sa.text("settled_ns IS NULL"),
    )
    op.create_table(
        "api_keys",
        sa.Column("number", NUMBER, autoincrement=True, nullable=False),
        sa.Column("id", TEXT, nullable=False),
        sa.Column("name", TEXT, nullable=False),
        sa.Column("hash", TEXT, nullable=False),
        sa.Column("role", TEXT, nullable=False),
        sa.Column("robot", TEXT, nullable=True),
        sa.Column("created_ns", sa.BigInteger(), nullable=False),
        sa.Column("by", TEXT, nullable=False),
        sa.Column("revoked_ns", sa.BigInteger(), nullable=True),
        sa.PrimaryKeyConstraint("number"),
        sa.UniqueConstraint("hash"),
        sa.UniqueConstraint("id"),
        sqlite_autoincrement=True,
    )
    op.create_table(
        "assertions",
        sa.Column("robot", TEXT, nullable=False),
        sa.Column("name", TEXT, nullable=False),
        sa.Column("sentence", TEXT, nullable=False),
        sa.Column("source", TEXT, nullable=False),
        sa.Column("time_ns", sa.BigInteger(), nullable=False),
        sa.Column("expires_ns", sa.BigInteger(), nullable=True),
        sa.PrimaryKeyConstraint("robot", "name"),
        sqlite_with_rowid=False,
    )
    op.create_table(
        "attempts",
        sa.Column("number", NUMBER, autoincrement=True, nullable=False),
        sa.Column("robot", TEXT, nullable=False),
        sa.Column("component", TEXT, nullable=False),
        sa.Column("repair", TEXT, nullable=False),
        sa.Column("time_ns", sa.BigInteger(), nullable=False),
        sa.PrimaryKeyConstraint("number"),
        sqlite_autoincrement=True,
    )
    op.create_index("ix_attempts_robot", "attempts", ["robot", "time_ns"], unique=False)
    op.create_table(
        "audit",
        sa.Column("id", NUMBER, autoincrement=False, nullable=False),
        sa.Column("time_ns", sa.BigInteger(), nullable=False),
        sa.Column("actor", TEXT, nullable=False),
        sa.Column("action", TEXT, nullable=False),
        sa.Column("subject", TEXT, nullable=False),
        sa.Column("robot", TEXT, nullable=True),
        sa.Column("reason", TEXT, nullable=False),
        sa.Column("before", TEXT, nullable=True),
        sa.Column("after", TEXT, nullable=True),
        sa.PrimaryKeyConstraint("id"),
    )
    op.create_index("ix_audit_robot", "audit", ["robot", "id"], unique=False)
    op.create_table(
        "counters",
        sa.Column("name", TEXT, nullable=False),
        sa.Column("value", sa.BigInteger(), nullable=False),
        sa.PrimaryKeyConstraint("name"),
    )
    op.create_table(
        "diagnoses",
        sa.Column("number", NUMBER, autoincrement=True, nullable=False),
        sa.Column("robot", TEXT, nullable=False),
        sa.Column("revision", sa.BigInteger(), nullable=False),
        sa.Column("model_version", TEXT, nullable=False),
        sa.Column("time_ns", sa.BigInteger(), nullable=False),
        sa.Column("result", TEXT, nullable=False),
        sa.PrimaryKeyConstraint("number"),
        sqlite_autoincrement=True,
    )
    op.create_index("ix_diagnoses_robot", "diagnoses", ["robot", "number"], unique=False)
    op.create_index("ix_diagnoses_time", "diagnoses", ["time_ns"], unique=False)
    op.create_table(
        "events",
        sa.Column("id", NUMBER, autoincrement=False, nullable=False),
        sa.Column("time_ns", sa.BigInteger(), nullable=False),
        sa.Column("kind", TEXT, nullable=False),
        sa.Column("robot", TEXT, nullable=True),
        sa.Column("data", TEXT, nullable=False),
        sa.PrimaryKeyConstraint("id"),
    )
    op.create_index("ix_events_robot", "events", ["robot", "id"], unique=False)
    op.create_table(
        "idempotency",
        sa.Column("scope", TEXT, nullable=False),
        sa.Column("key", TEXT, nullable=False),
        sa.Column("request", TEXT, nullable=False),
        sa.Column("response", TEXT, nullable=False),
        sa.Column("expires_ns", sa.BigInteger(), nullable=False),
        sa.PrimaryKeyConstraint("scope", "key"),
    )
    op.create_index("ix_idempotency_expires", "idempotency", ["expires_ns"], unique=False)
    op.create_table(
        "instances",
        sa.Column("id", TEXT, nullable=False),
        sa.Column("host", TEXT, nullable=False),
        sa.Column("pid", sa.Integer(), nullable=False),
        sa.Column("started_ns", sa.BigInteger(), nullable=False),
        sa.Column("heartbeat_ns", sa.BigInteger(), nullable=False),
        sa.PrimaryKeyConstraint("id"),
    )
    op.create_table(
        "journal",
        sa.Column("number", NUMBER, autoincrement=True, nullable=False),
        sa.Column("id", TEXT, nullable=False),
        sa.Column("repair", TEXT, nullable=False),
        sa.Column("step", sa.Integer(), nullable=False),
        sa.Column("robot", TEXT, nullable=False),
        sa.Column("name", TEXT, nullable=False),
        sa.Column("parameters", TEXT, nullable=False),
        sa.Column("timeout_s", sa.Float(), nullable=False),
        sa.Column("fence", sa.BigInteger(), nullable=False),
        sa.Column("intended_ns", sa.BigInteger(), nullable=False),
        sa.Column("code", sa.BigInteger(), nullable=True),
        sa.Column("message", TEXT, nullable=False),
        sa.Column("settled_ns", sa.BigInteger(), nullable=True),
        sa.PrimaryKeyConstraint("number"),
        sa.UniqueConstraint("id"),
        sqlite_autoincrement=True,
    )
    op.create_index(op.f("ix_journal_repair"), "journal", ["repair"], unique=False)
    op.create_index(
        "ix_journal_unsettled",
        "journal",
        ["robot"],
        unique=False,
        postgresql_where=sa.text("settled_ns IS NULL"),
        sqlite_where=sa.text("settled_ns IS NULL"),
    )
    op.create_table(
        "model_versions",
        sa.Column("name", TEXT, nullable=False),
        sa.Column("number", sa.Integer(), autoincrement=False, nullable=False),
        sa.Column("version", TEXT, nullable=False),
        sa.Column("format", TEXT, nullable=False),
        sa.Column("source", TEXT, nullable=False),
        sa.Column("created_ns", sa.BigInteger(), nullable=False),
        sa.Column("by", TEXT, nullable=False),
        sa.PrimaryKeyConstraint("name", "number"),
    )
    op.create_table(
        "models",
        sa.Column("name", TEXT, nullable=False),
        sa.Column("current", sa.Integer(), nullable=False),
        sa.PrimaryKeyConstraint("name"),
    )
    op.create_table(
        "obs",
        sa.Column("robot", TEXT, nullable=False),
        sa.Column("atom", TEXT, nullable=False),
        sa.Column("positive", sa.Boolean(), nullable=False),
        sa.Column("source", TEXT, nullable=False),
        sa.Column("time_ns", sa.BigInteger(), nullable=False),
        sa.Column("expires_ns", sa.BigInteger(), nullable=True),
        sa.PrimaryKeyConstraint("robot", "atom"),
        sqlite_with_rowid=False,
    )
    op.create_table(
        "observations",
        sa.Column("number", NUMBER, autoincrement=True, nullable=False),
        sa.Column("robot", TEXT, nullable=False),
        sa.Column("revision", sa.BigInteger(), nullable=False),
        sa.Column("time_ns", sa.BigInteger(), nullable=False),
        sa.Column("data", TEXT, nullable=False),
        sa.PrimaryKeyConstraint("number"),
        sa.UniqueConstraint("robot", "revision", name="uq_observations_robot_revision"),
        sqlite_autoincrement=True,
    )
    op.create_table(
        "quarantine",
        sa.Column("robot", TEXT, nullable=False),
        sa.Column("component", TEXT, nullable=False),
        sa.Column("reason", TEXT, nullable=False),
        sa.Column("failures", sa.Integer(), nullable=False),
        sa.Column("since_ns", sa.BigInteger(), nullable=False),
        sa.Column("until_ns", sa.BigInteger(), nullable=True),
        sa.PrimaryKeyConstraint("robot", "component"),
    )
    op.create_table(
        "repair_requests",
        sa.Column("number", NUMBER, autoincrement=True, nullable=False),
        sa.Column("repair", TEXT, nullable=False),
        sa.Column("robot", TEXT, nullable=False),
        sa.Column("what", TEXT, nullable=False),
        sa.Column("by", TEXT, nullable=False),
        sa.Column("reason", TEXT, nullable=False),
        sa.Column("time_ns", sa.BigInteger(), nullable=False),
        sa.Column("done", sa.Boolean(), nullable=False),
        sa.PrimaryKeyConstraint("number"),
        sqlite_autoincrement=True,
    )
    op.create_index(
        "ix_repair_requests_open",
        "repair_requests",
        ["robot"],
        unique=False,
        postgresql_where=sa.text("NOT done"),
        sqlite_where=sa.text("NOT done"),
    )
    op.create_index(op.f("ix_repair_requests_repair"), "repair_requests", ["repair"], unique=False)
    op.create_table(
        "repair_steps",
        sa.Column("repair", TEXT, nullable=False),
        sa.Column("step", sa.Integer(), autoincrement=False, nullable=False),
        sa.Column("state", TEXT, nullable=False),
        sa.Column("data", TEXT, nullable=False),
        sa.Column("updated_ns", sa.BigInteger(), nullable=False),
        sa.PrimaryKeyConstraint("repair", "step"),
    )
    op.create_table(
        "repairs",
        sa.Column("number", NUMBER, autoincrement=True, nullable=False),
        sa.Column("id", TEXT, nullable=False),
        sa.Column("robot", TEXT, nullable=False),
        sa.Column("state", TEXT, nullable=False),
        sa.Column("open", sa.Boolean(), nullable=False),
        sa.Column("data", TEXT, nullable=False),
        sa.Column("created_ns", sa.BigInteger(), nullable=False),
        sa.Column("updated_ns", sa.BigInteger(), nullable=False),
        sa.PrimaryKeyConstraint("number"),
        sa.UniqueConstraint("id"),
        sqlite_autoincrement=True,
    )
    op.create_index(
        "ix_repairs_open",
        "repairs",
        ["robot"],
        unique=False,
        postgresql_where=sa.text("open"),
        sqlite_where=sa.text("open"),
    )
    op.create_index("ix_repairs_robot", "repairs", ["robot", "number"], unique=False)
    op.create_table(
        "robot_state",
        sa.Column("robot", TEXT, nullable=False),
        sa.Column("revision", sa.BigInteger(), nullable=False),
        sa.Column("fence", sa.BigInteger(), nullable=False),
        sa.Column("owner", TEXT, nullable=True),
        sa.PrimaryKeyConstraint("robot"),
    )
    op.create_index(op.f("ix_robot_state_owner"), "robot_state", ["owner"], unique=False)
    op.create_table(
        "robots",
        sa.Column("id", TEXT, nullable=False),
        sa.Column("config", TEXT, nullable=False),
        sa.Column("etag", TEXT, nullable=False),
        sa.Column("model", TEXT, nullable=True),
        sa.Column("created_ns", sa.BigInteger(), nullable=False),
        sa.Column("updated_ns", sa.BigInteger(), nullable=False),
        sa.PrimaryKeyConstraint("id"),
    )
    op.create_index(op.f("ix_robots_model"), "robots", ["model"], unique=False)
    op.create_table(
        "settings",
        sa.Column("name", TEXT, nullable=False),
        sa.Column("value", TEXT, nullable=False),
        sa.PrimaryKeyConstraint("name"),
    )
    op.create_table(
        "tried",
        sa.Column("number", NUMBER, autoincrement=True, nullable=False),
        sa.Column("robot", TEXT, nullable=False),
        sa.Column("bad", TEXT, nullable=False),
        sa.Column("actions", TEXT, nullable=False),
        sa.Column("helped", sa.Boolean(), nullable=False),
        sa.Column("effect_seen", sa.Boolean(), nullable=False),
        sa.Column("repair", TEXT, nullable=True),
        sa.Column("time_ns", sa.BigInteger(), nullable=False),
        sa.Column("data", TEXT, nullable=False),
        sa.PrimaryKeyConstraint("number"),
        sqlite_autoincrement=True,
    )
    op.create_index("ix_tried_robot", "tried", ["robot", "number"], unique=False)
    counters = sa.table("counters", sa.column("name", sa.Text), sa.column("value", sa.BigInteger))
    op.bulk_insert(counters, [{"name": "event", "value": 0}, {"name": "audit", "value": 0}])
