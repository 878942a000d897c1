"""Drills: planted faults, each with its undo."""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision = "0005"
down_revision = "0004"
branch_labels = None
depends_on = None

TEXT = sa.Text().with_variant(sa.Text(collation="C"), "postgresql")
NUMBER = sa.BigInteger().with_variant(sa.Integer(), "sqlite")
OPEN = sa.text("open")


def upgrade() -> None:
    """Add the table of drills."""
    op.create_table(
        "drills",
        sa.Column("number", NUMBER, primary_key=True, autoincrement=True),
        sa.Column("id", TEXT, nullable=False, unique=True),
        sa.Column("robot", TEXT, nullable=False),
        sa.Column("state", TEXT, nullable=False),
        sa.Column("open", sa.Boolean(), nullable=False),
        sa.Column("watched", sa.Boolean(), nullable=False),
        sa.Column("asked", TEXT, nullable=True),
        sa.Column("data", TEXT, nullable=False),
        sa.Column("created_ns", sa.BigInteger(), nullable=False),
        sa.Column("updated_ns", sa.BigInteger(), nullable=False),
        sqlite_autoincrement=True,
    )
    op.create_index("ix_drills_robot", "drills", ["robot", "number"])
    op.create_index("ix_drills_open", "drills", ["robot"], postgresql_where=OPEN, sqlite_where=OPEN)
