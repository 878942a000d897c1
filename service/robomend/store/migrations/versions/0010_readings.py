"""What was measured beside an entry of OBS."""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision = "0010"
down_revision = "0009"
branch_labels = None
depends_on = None

TEXT = sa.Text().with_variant(sa.Text(collation="C"), "postgresql")


def upgrade() -> None:
    """Add a column to OBS; nothing was measured before."""
    op.add_column("obs", sa.Column("more", TEXT))
