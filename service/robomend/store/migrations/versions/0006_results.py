"""What diagnoses say is kept once for all that say the same; what was kept before stays as it is."""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision = "0006"
down_revision = "0005"
branch_labels = None
depends_on = None

NUMBER = sa.BigInteger().with_variant(sa.Integer(), "sqlite")


def upgrade() -> None:
    """Add the table of results, and its numbers to diagnoses and events; quick, however many these are."""
    op.create_table(
        "results",
        sa.Column("number", NUMBER, primary_key=True, autoincrement=True),
        sa.Column("digest", sa.LargeBinary(), nullable=False, unique=True),
        sa.Column("used_day", sa.Integer(), nullable=False),
        sa.Column("data", sa.LargeBinary(), nullable=False),
        sqlite_autoincrement=True,
    )
    op.create_index("ix_results_used_day", "results", ["used_day"])
    op.add_column("diagnoses", sa.Column("common", sa.BigInteger(), nullable=True))
    op.add_column("events", sa.Column("common", sa.BigInteger(), nullable=True))
    op.drop_index("ix_diagnoses_time", "diagnoses")
