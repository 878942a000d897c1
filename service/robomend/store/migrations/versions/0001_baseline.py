"""The baseline: a database is made from schema.py at once, and only an older one is migrated."""

from __future__ import annotations

revision = "0001"
down_revision = None
branch_labels = None
depends_on = None


def upgrade() -> None:
    """Nothing to do."""
