"""Evidence of what is observed: since when it is, its onset, and the `settle` that it answers."""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision = "0003"
down_revision = "0002"
branch_labels = None
depends_on = None


def upgrade() -> None:
    """Add three columns to OBS; what was observed before has none of it."""
    for name in ("since_ns", "onset_ns", "settled"):
        op.add_column("obs", sa.Column(name, sa.BigInteger(), nullable=True))
