"""What people are told, until it has arrived."""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision = "0004"
down_revision = "0003"
branch_labels = None
depends_on = None

TEXT = sa.Text().with_variant(sa.Text(collation="C"), "postgresql")
NUMBER = sa.BigInteger().with_variant(sa.Integer(), "sqlite")
DUE = sa.text("due_ns IS NOT NULL")


def upgrade() -> None:
    """Add the table of notifications."""
    op.create_table(
        "notifications",
        sa.Column("number", NUMBER, nullable=False, autoincrement=True),
        sa.Column("recipient", TEXT, nullable=False),
        sa.Column("key", TEXT, nullable=False),
        sa.Column("data", TEXT, nullable=False),
        sa.Column("created_ns", sa.BigInteger(), nullable=False),
        sa.Column("tries", sa.Integer(), nullable=False),
        sa.Column("due_ns", sa.BigInteger(), nullable=True),
        sa.Column("state", TEXT, nullable=False),
        sa.Column("answer", TEXT, nullable=False),
        sa.PrimaryKeyConstraint("number"),
        sqlite_autoincrement=True,
    )
    op.create_index("ix_notifications_key", "notifications", ["key", "recipient"], unique=False)
    op.create_index(
        "ix_notifications_due",
        "notifications",
        ["due_ns"],
        unique=False,
        postgresql_where=DUE,
        sqlite_where=DUE,
    )
