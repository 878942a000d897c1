"""How long starts took, of each topic."""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision = "0008"
down_revision = "0007"
branch_labels = None
depends_on = None

TEXT = sa.Text().with_variant(sa.Text(collation="C"), "postgresql")


def upgrade() -> None:
    """Add the table of starts."""
    op.create_table(
        "start_ups",
        sa.Column("robot", TEXT, nullable=False),
        sa.Column("topic", TEXT, nullable=False),
        sa.Column("took", TEXT, nullable=False),
        sa.PrimaryKeyConstraint("robot", "topic"),
        sqlite_with_rowid=False,
    )
